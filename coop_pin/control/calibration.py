"""Zero at grasp: calibration of an arm's payload frame by the start pose that all arms agree on."""

from __future__ import annotations

from dataclasses import dataclass

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import TaskRows, inverse_pose
from coop_pin.control.law_wrapper import LawWrapper, Parts, Received, WrappedState
from coop_pin.control.measurement import ArmMeasurement, ArmReference


@dataclass(frozen=True, eq=False)
class ZeroedController(LawWrapper):
    """Law with a payload frame that is corrected by what it was off at the start.

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

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return X_i^-1 X_start, the agreed payload frame in the one that the arm computes, shape (4, 4)."""
        return inverse_pose(measurement.payload_pose) @ self.start_pose

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState | None
    ) -> Array:
        """Return the message of the law, of the corrected measurement."""
        offset = self.start(measurement, reference) if state is None else state.memory
        return super().message(self._zeroed(measurement, offset), reference, state)

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Array,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Array]:
        """Return the corrected measurement, and the same correction."""
        return self._zeroed(measurement, memory), memory

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
