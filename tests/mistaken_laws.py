"""Laws with the commonest slips of a first law, each by the name of its slip."""

import math
import sys

import numpy as np

import coop_pin as cp


class Law(cp.ArmController):
    def __init__(self, scenario, arm):
        self.drives = len(scenario.cell.arms[arm].posture)

    def init(self, measurement, reference):
        return None


class ReturnsTorques(Law):
    def step(self, measurement, reference, state):
        return np.zeros(self.drives)


class ReturnsTuple(Law):
    def step(self, measurement, reference, state):
        return np.zeros(self.drives), state


class ReturnsNothing(Law):
    def step(self, measurement, reference, state):
        pass


class ReturnsNan(Law):
    def step(self, measurement, reference, state):
        torque = np.zeros(self.drives)
        torque[1] = math.nan if measurement.time > 0.03 else 0.0
        return cp.ArmCommand(torque, state)


class Raises(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(measurement.no_such_field, state)


class Exits(Law):
    def step(self, measurement, reference, state):
        sys.exit(3)


class ComplexTorques(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.zeros(self.drives) + 1j, state)


class TruthValues(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.ones(self.drives, bool), state)


class OneTorque(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.zeros(1), state)


class NoNumbers(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.array(["none"] * self.drives), state)


class WithGradient(Law):
    def step(self, measurement, reference, state):
        return cp.ArmCommand(Tensor(), state)


class Tensor:
    """Tensor that needs a gradient, as of torch."""

    def __array__(self, *_, **__):
        raise RuntimeError(
            "Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead."
        )


class NoInit(cp.ArmController):
    def __init__(self, scenario, arm):
        pass

    def step(self, measurement, reference, state):
        return cp.ArmCommand(np.zeros(3), state)


class NoState(Law):
    def step(self, measurement, reference):
        return cp.ArmCommand(np.zeros(3))


class CellTorques(cp.CellController):
    def __init__(self, scenario):
        self.drives = [len(arm.posture) for arm in scenario.cell.arms.values()]

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        return [np.zeros(drives) for drives in self.drives]


class CellNan(CellTorques):
    def step(self, measurements, references, state):
        return cp.CellCommand([np.full(drives, np.nan) for drives in self.drives], state)
