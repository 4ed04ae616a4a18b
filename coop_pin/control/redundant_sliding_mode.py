"""Law (23) for arms with more joints than task rows: a variant, with what its proof loses said plainly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.contract import ArmController, ArmReference, Command
from coop_pin.control.force_term import force_term
from coop_pin.control.inverse import right_inverse
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.control.posture import Posture
from coop_pin.control.sliding_mode import SlidingModeState
from coop_pin.control.switching import Switching
from coop_pin.spatial.task_rows import TaskRows


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
        rows: the k_0 task rows.
        period: T, s.
        pose_gain: gamma, 1/s, shape (k_0, k_0).
        sign_gain: alpha, rad/s^2, shape (k, k), diagonal.
        damping_gain: K_d, N m s/rad, shape (k, k).
        force_gain: K_f.
        transient_rate: kappa, 1/s.
        switching: sgn, or a smooth function in its place.
        posture: what the spare joints do.
        inverse_damping: of the pseudo-inverse, in the unit of J's singular values; 0 is exact.
    """

    rows: TaskRows
    period: float
    pose_gain: Array
    sign_gain: Array
    damping_gain: Array
    force_gain: float
    transient_rate: float
    switching: Switching
    posture: Posture
    inverse_damping: float = 0.0

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> SlidingModeState:
        """Return the state at t_0: the surface there, and sigma = 0."""
        xtilde = self.rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        s = self._inverse(measurement).dot(xtildedot + self.pose_gain.dot(xtilde))
        return SlidingModeState(measurement.time, s, np.zeros_like(s))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState) -> Command:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank and no damping was asked for.
        """
        t, v, J = measurement.time, measurement.v, measurement.payload_jacobian
        J_plus = self._inverse(measurement)
        gamma_xtilde = self.pose_gain.dot(self.rows.pose_error(measurement.payload_pose, reference.pose))
        s = J_plus.dot(measurement.payload_twist - reference.twist + gamma_xtilde)
        s_d = state.start_surface * math.exp(-self.transient_rate * (t - state.start_time))
        s_q = s - s_d
        qdot_r = J_plus.dot(reference.twist - gamma_xtilde) + s_d - self.sign_gain.dot(state.sign_integral)
        s_r = v - qdot_r
        tau = -self.damping_gain.dot(s_r) - J.T.dot(force_term(self.rows, self.force_gain, measurement, reference))
        tau = tau + self.posture.torque(measurement.q, v, J, J_plus)
        sigma = state.sign_integral + self.period * (self.switching(s_q) * ~measurement.saturated)
        return Command(tau, SlidingModeState(state.start_time, state.start_surface, sigma))

    def _inverse(self, measurement: ArmMeasurement) -> Array:
        return right_inverse(measurement.payload_jacobian, measurement.time, self.inverse_damping)
