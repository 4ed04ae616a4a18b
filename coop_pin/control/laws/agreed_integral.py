"""Agreed integral: the payload-space law of an arm, whose integral leaks to the mean of all integrals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control.consensus import mean_heard
from coop_pin.control.controller import ArmCommand
from coop_pin.control.laws.payload_space_controller import PayloadSpaceController, PayloadSpaceState
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.told_law import TellingLaw, heard


class AgreedState(NamedTuple):
    """Memory of an arm whose integral agrees with the others.

    Attributes:
        start: Z(t_0), N and N m, shape (k_0,).
        law: State of the law.
    """

    start: Array
    law: PayloadSpaceState


@dataclass(frozen=True, eq=False)
class AgreedIntegral(TellingLaw):
    """The payload-space law of one arm, whose integral leaks to the mean of those that it hears.

    ::

        D_i  = (Z_i - Z_i(t_0)) / c_i
        Z_i <- Z_i - lambda T (Z_i - Z_i(t_0) - c_i mean_j D_j)      its own D_i as sent among the D_j

    By equal views all D_i are equal, and nothing leaks. What they differ by, by a view that was lost, a drive
    at its limit or the first ticks of a consensus, is internal force; it decays by 1 - lambda T a tick where
    all hear all, and no slower than the graph's second eigenvalue says elsewhere. Their mean does not leak:
    it still takes any constant load. Distributed-averaging proportional-integral control: Simpson-Porco,
    Doerfler and Bullo, Automatica 49 (2013), with load shares in place of the inverters' ratings.

    Every arm says D_i, k_0 numbers.

    Attributes:
        law: Payload-space law of this arm, with lambda and without a measured wrench.
        name: Name of this arm.
    """

    needs: ClassVar[tuple[str, ...]] = ("messages",)

    law: PayloadSpaceController
    name: str

    def said(self, measurement: ArmMeasurement, reference: ArmReference, state: AgreedState | None) -> Array:
        """Return D_i, shape (k_0,)."""
        return np.zeros(self.law.arm.rows.size) if state is None else self._gained(state)

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> AgreedState:
        """Return the first state of the law, and its integral; raises as the law."""
        state = self.law.init(measurement, reference)
        return AgreedState(state.integral, state)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: AgreedState) -> ArmCommand:
        """Return the command of the law, and the next state; raises as the law."""
        goal = self.law.arm.load_share * mean_heard(heard(measurement), self._gained(state))
        law = state.law._replace(anchored=state.start + goal)
        command = self.law.step(measurement, reference, law)
        return replace(command, state=state._replace(law=command.state))

    def _gained(self, state: AgreedState) -> Array:
        """Return D_i."""
        return np.asarray((state.law.integral - state.start) / self.law.arm.load_share)
