"""Zero at grasp: an arm's payload frame is placed once, at the start pose that all arms agree on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import TaskRows, inverse_pose
from coop_pin.control.controller import ArmCommand
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.told_law import TellingLaw


class ZeroedState(NamedTuple):
    """Memory of a zeroed law.

    Attributes:
        offset: X_i(t_0)^-1 X_start, pose of the agreed payload frame in the one that the arm computes, shape
            (4, 4).
        law: the state of the law.
    """

    offset: Array
    law: Any


@dataclass(frozen=True, eq=False)
class ZeroedController(TellingLaw):
    """A law that sees its payload frame corrected by what it was off at the start.

    ::

        X_i <- X_i X_i(t_0)^-1 X_start

    Twist, Jacobian and the arm's own interaction wrench move to that point. A kinematic bias that is fixed in
    the arm's tip vanishes exactly, because X_i = X_WP G with a constant G; one that depends on the posture is
    left with what it changes since the start. Positional rows see no rotation: there the twist stays.

    Attributes:
        rows: the k_0 task rows.
        start_pose: X_start, the agreed pose of the payload at t_0, shape (4, 4).
    """

    rows: TaskRows
    start_pose: Array

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> ZeroedState:
        """Return the offset at t_0 and the law's state there; raises as the law."""
        offset = self._offset(measurement)
        return ZeroedState(offset, self.law.init(self._zeroed(measurement, offset), reference))

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: ZeroedState | None
    ) -> Array:
        """Return what the law tells the others."""
        offset = self._offset(measurement) if state is None else state.offset
        return super().message(self._zeroed(measurement, offset), reference, state)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: ZeroedState) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next; raises as the law."""
        command = self.law.step(self._zeroed(measurement, state.offset), reference, state.law)
        return replace(command, state=ZeroedState(state.offset, command.state))

    def _offset(self, measurement: ArmMeasurement) -> Array:
        """Return X_i^-1 X_start, shape (4, 4)."""
        return inverse_pose(measurement.payload_pose) @ self.start_pose

    def _zeroed(self, measurement: ArmMeasurement, offset: Array) -> ArmMeasurement:
        """Return the measurement about the corrected point: V' = A V, J' = A J, F' = A^-T F."""
        X_WP = measurement.payload_pose @ offset
        displacement = X_WP[:3, 3] - measurement.payload_pose[:3, 3]
        A = self.rows.twist_shift(displacement)
        F = measurement.interaction_wrench
        return measurement._replace(
            payload_pose=X_WP,
            payload_twist=A @ measurement.payload_twist,
            payload_jacobian=A @ measurement.payload_jacobian,
            interaction_wrench=None if F is None else self.rows.twist_shift(-displacement).T @ F,
        )
