"""Agreed integral: the payload-space law of an arm, whose integral leaks to the mean of all integrals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control.consensus import mean_received
from coop_pin.control.controller import ArmCommand
from coop_pin.control.law_wrapper import LawWrapper, Parts, Received, WrappedState
from coop_pin.control.laws.payload_space_controller import PayloadSpaceController
from coop_pin.control.measurement import ArmMeasurement, ArmReference


@dataclass(frozen=True, eq=False)
class AgreedIntegral(LawWrapper):
    """Payload-space law of one arm, whose integral leaks to the mean of the integrals of its neighbours.

    ::

        D_i  = (Z_i - Z_i(t_0)) / c_i
        Z_i <- Z_i - lambda T (Z_i - Z_i(t_0) - c_i mean_j D_j)      its own D_i as sent among the D_j

    By equal views all D_i are equal, and nothing leaks. What they differ by, by a view that was lost, a drive
    at its limit or the first ticks of a consensus, is internal force; it decays by 1 - lambda T a tick where
    all hear all, and no slower than by the graph's second eigenvalue elsewhere. Their mean does not leak:
    it still takes any constant load. Distributed-averaging proportional-integral control: Simpson-Porco,
    Doerfler and Bullo, Automatica 49 (2013), with load shares in place of the inverters' ratings.

    Every arm sends D_i, k_0 numbers. The memory is Z(t_0).

    Attributes:
        law: Payload-space law of this arm, with lambda and without a measured wrench.
    """

    law: PayloadSpaceController

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return D_i, zero before ``init``."""
        if state.law is None:
            return {"gained": np.zeros(self.law.arm.rows.size)}
        return {"gained": (state.law.integral.value - state.memory) / self.law.arm.load_share}

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> WrappedState:
        """Return the first integral and the first state of the law; raises as the law."""
        law = self.law.init(measurement, reference)
        return WrappedState(law.integral.value, law)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> ArmCommand:
        """Return the command of the law, which leaks to the mean, and the next state; raises as the law."""
        measurement, goal = self.inner(measurement, reference, state)
        integral = state.law.integral._replace(anchored=goal)
        command = self.law.step(measurement, reference, state.law._replace(integral=integral))
        return replace(command, state=state._replace(law=command.state))

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Array,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Array]:
        """Return the measurement, and Z_i(t_0) + c_i mean_j D_j."""
        mean = mean_received(received["gained"], sent["gained"])
        return measurement, memory + self.law.arm.load_share * mean
