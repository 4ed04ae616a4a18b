"""Law (23) for arms with more joints than task rows: a variant, with what its proof loses said plainly."""

from __future__ import annotations

from dataclasses import dataclass

from coop_pin.arrays import Array
from coop_pin.control.contract import ArmController, ArmReference, Command
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.control.posture import Posture
from coop_pin.control.sliding_mode import SlidingModeController, SlidingModeState
from coop_pin.control.terms import right_inverse


@dataclass(frozen=True, eq=False)
class RedundantSlidingModeController(ArmController):
    """Law (23) with the right pseudo-inverse J^+ = J^T (J J^T + damping^2 I)^-1, for k > k_0, plus a posture term.

    The paper prints J^+ = (J^T J)^-1 J^T, which is singular for k > k_0. Equations as in SlidingModeController.

    **What the proof loses.** For k > k_0, ``s_r = qdot - qdot_r = s_q + alpha sigma + (I - J^+ J) qdot``: eq. (21)'s second
    equality fails. J s_r is as in the paper, so that the internal-wrench terms V_2 and V_3 of Theorem 2 stay bounded; but
    s_q now differs from s_r - alpha sigma by the null-space motion, whose derivative is not bounded by the gains: the sliding
    condition ``s_q^T s_q' <= -epsilon |s_q|`` is not proven. K_d damps the null space too. With ``inverse_damping`` > 0, J J^+ is not
    the identity either, and x follows x_d only up to that damping: a run that asks for it carries the flag in its scenario.

    Attributes:
        printed: the law as printed, which takes J^+ from here.
        posture: what the spare joints do.
        inverse_damping: of the pseudo-inverse, in the unit of J's singular values; 0 is exact.
    """

    printed: SlidingModeController
    posture: Posture
    inverse_damping: float = 0.0

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> SlidingModeState:
        """Return the state at t_0: the surface there, and sigma = 0.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank and no damping was asked for.
        """
        return self.printed.init_through(self._inverse(measurement), measurement, reference)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState) -> Command:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank and no damping was asked for.
        """
        J_plus = self._inverse(measurement)
        command = self.printed.step_through(J_plus, measurement, reference, state)
        posture = self.posture.torque(measurement.q, measurement.v, measurement.payload_jacobian, J_plus)
        return Command(command.torque + posture, command.state)

    def _inverse(self, measurement: ArmMeasurement) -> Array:
        return right_inverse(measurement.payload_jacobian, measurement.time, self.inverse_damping)
