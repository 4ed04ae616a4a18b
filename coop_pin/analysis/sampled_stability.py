"""Whether a control rate can bear the damping that a controller asks for: any law, any arms, at the start of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, frozen
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.controller_factory import build_controller
from coop_pin.description.scenario import Scenario
from coop_pin.simulation import Simulation

BOUND = 2.0
"""Held damping is stable below this: v[k+1] = (1 - value) v[k]."""

_NOTHING = 1e-6
_SHARE_OF_MODE = 0.3


class SampledStability(NamedTuple):
    """How near the held torques come to shaking the cell.

    Attributes:
        value: ``T |lambda|^2 / Re lambda``, the largest of all ways to move; T lambda where lambda is real.
            Below 2 the motion decays.
        rate_hz: the control rate, Hz.
        joints: the joints that move most in that way, as arm/joint.
    """

    value: float
    rate_hz: float
    joints: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether the motion decays from tick to tick."""
        return self.value < BOUND

    def text(self) -> str:
        """Return the finding for people, in one line."""
        if self.ok:
            return f"held damping: {self.value:.3g} of less than {BOUND:g} at {self.rate_hz:g} Hz, most in {', '.join(self.joints)}"
        least = f" above {self.rate_hz * self.value / BOUND:.4g} Hz" if np.isfinite(self.value) else ""
        return (
            f"! held damping is {self.value:.3g}; it must be less than {BOUND:g}: torques held over a tick of {self.rate_hz:g} Hz shake "
            f"{', '.join(self.joints)}. Raise clock.rate_hz{least}, or lower the gains (posture damping included)"
        )


def sampled_stability(scenario: Scenario) -> SampledStability:
    """Return how much damping the controller holds over a tick, at the start of the run and to first order.

    With D = -d(acceleration)/dv through the torques alone, closures kept, the speeds go from tick to tick as
    v[k+1] = (I - T D) v[k]. The mode of an eigenvalue lambda of D decays while ``|1 - T lambda| < 1``, which
    is ``T |lambda|^2 / Re lambda < 2``.

    Args:
        scenario: what would be run. Friction, torque limits and what a law adds up over many ticks play no
            part.

    Raises:
        UnreachablePoseError: an arm cannot hold the payload at the start.
        SingularArmError: an arm is singular there.
    """
    simulation = Simulation(scenario, build_controller(scenario))
    plant, chain = simulation.plant, simulation.chain.chain
    torque = _answers(scenario, simulation)
    rest = np.zeros(len(plant.v))

    def acceleration(v: Array) -> Array:
        return chain.forward_dynamics(plant.q, rest, torque(v)).acceleration

    # Laws are linear in the speeds, but for signs of bounded size: unit speeds both ways leave those out.
    speeds = [chain.project_velocity(plant.q, row) for row in np.eye(len(rest))]
    D = np.column_stack([(acceleration(-v) - acceleration(v)) / 2.0 for v in speeds])
    eigenvalues, modes = np.linalg.eig(D)
    T = scenario.clock.period
    values = np.array([_held(T * entry) for entry in eigenvalues])
    worst = int(np.argmax(values))
    return SampledStability(
        float(values[worst]), scenario.clock.rate_hz, _moving(simulation, np.abs(modes[:, worst]))
    )


def _held(entry: complex) -> float:
    """Return ``|T lambda|^2 / Re(T lambda)``; nothing where there is no damping, infinity where it drives the motion."""
    if abs(entry) < _NOTHING:
        return 0.0
    return abs(entry) ** 2 / entry.real if entry.real > 0.0 else float("inf")


def _answers(scenario: Scenario, simulation: Simulation) -> Callable[[Array], Array]:
    """Return the controller's generalised force at the start as a function of the speeds; internal wrenches are as desired."""
    rows, plant = scenario.cell.task_rows, simulation.plant
    target, squeeze = simulation.motion.at(0.0), simulation.squeeze.at(0.0, scenario.cell.arms)
    twist, acceleration = frozen(rows.select(target.V_WP_d)), frozen(rows.select(target.A_WP_d))
    references = [
        ArmReference(target.X_WP_d, twist, acceleration, frozen(rows.select(wrench))) for wrench in squeeze
    ]

    def measured(v: Array) -> list[ArmMeasurement]:
        found = []
        for sensor, reference, saturated in zip(
            simulation.sensors, references, simulation.saturated, strict=True
        ):
            measurement = sensor.measure(0.0, plant.q, v, None, saturated)
            desired = rows.turn(measurement.payload_pose, reference.internal_wrench)
            found.append(
                measurement._replace(
                    internal_wrench=frozen(desired) if simulation.force_sensor.is_needed else None
                )
            )
        return found

    state = simulation.controller.init(measured(np.zeros(len(plant.v))), references)

    def torque(v: Array) -> Array:
        answer = simulation.controller.step(measured(v), references, state)
        return plant.drives.torque(simulation.actuation.commands(answer.torque))

    return torque


def _moving(simulation: Simulation, mode: Array) -> tuple[str, ...]:
    """Return the joints that move most in a mode, the fastest first."""
    speeds = {
        name: float(speed)
        for place in simulation.chain.tree.arms
        for name, speed in zip(place.angles.names, mode[place.v], strict=True)
    }
    fastest = sorted(speeds, key=lambda name: -speeds[name])
    return tuple(name for name in fastest if speeds[name] >= _SHARE_OF_MODE * speeds[fastest[0]])[:4]
