"""Decentralised sliding-mode law of Gueaieb et al. (2007), eqs. (18)-(23), as printed and for redundant arms.

SlidingModeController is the printed law for arms with as many joints as task rows (k = k_0).
RedundantSlidingModeController is the same law with the right pseudo-inverse of the payload Jacobian and a
posture term for the spare joints (k > k_0); its docstring states what the proof loses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import NotNegative
from coop_pin.base.spatial.generic_numbers import exp
from coop_pin.control.controller import ArmCommand, ArmController
from coop_pin.control.gains import PositiveGain, gain_matrix
from coop_pin.control.law import LawController
from coop_pin.control.laws.sliding_surface import SurfaceGains, SurfaceLaw, Switching
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.terms import Posture, PostureGains, force_term, jacobian_inverse, right_inverse


class SlidingModeState(NamedTuple):
    """Memory of the law.

    Attributes:
        start_time: t_0, s.
        start_surface: s(t_0), rad/s, shape (k,).
        sign_integral: sigma, s, shape (k,).
    """

    start_time: float
    start_surface: Array
    sign_integral: Array


class SlidingModeGains(SurfaceGains):
    """Gains of law (23) for one arm.

    Attributes:
        damping_gain: K_d, on the joints, N m s/rad; one for all or one for each.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("pose_gain",)
    on_drives: ClassVar[tuple[str, ...]] = ("sign_gain", "damping_gain")

    damping_gain: PositiveGain


@dataclass(frozen=True, eq=False)
class SlidingModeController(LawController[SlidingModeGains]):
    """Law (23) for an arm with as many joints as task rows (k = k_0), in sampled time.

    ::

        s       = J^-1 (xtildedot + gamma xtilde)                  (19)
        s_d     = s(t_0) exp(-kappa (t - t_0))                     (20)
        s_q     = s - s_d                                          (21)
        qdot_r  = J^-1 (xdot_d - gamma xtilde) + s_d - alpha sigma
        s_r     = qdot - qdot_r
        tau     = -K_d s_r - J^T (f_d - K_f ftilde)                (23)
        sigma[k+1] = sigma[k] + T sgn(s_q[k]),  sigma[0] = 0       (18)

    The torque of tick k uses sigma[k] and is held for T. Ours: sigma_j is held while the torque of joint j
    is saturated. The paper prints J^+ = (J^T J)^-1 J^T; for k = k_0 it is J^-1. On shared joints that the arm
    is told of, xdot = J qdot + J_s v_s, and qdot_r has xdot_d - J_s v_s in place of xdot_d.

    Attributes:
        switching: sgn, or a smooth function in its place.
    """

    switching: Switching

    def inverse(self, measurement: ArmMeasurement) -> Array:
        """Return J^-1, shape (k, k_0)."""
        return jacobian_inverse(measurement.payload_jacobian, measurement.time)

    def with_posture(self, tau: Array, measurement: ArmMeasurement, J_plus: Array) -> Array:
        """Return the torque with that of spare joints, of which there are none, N m, shape (k,)."""
        return tau

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> SlidingModeState:
        """Return the state at t_0: the surface there, and sigma = 0.

        Raises:
            SingularJacobianError: the payload Jacobian is singular.
        """
        xtilde = self.arm.rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        s = self.inverse(measurement).dot(xtildedot + self.gains.pose_gain.dot(xtilde))
        return SlidingModeState(measurement.time, s, np.zeros_like(s))

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian is singular.
        """
        # dot, not @: for a 3x3 matrix it costs a third.
        gains, rows, J_plus = self.gains, self.arm.rows, self.inverse(measurement)
        t, v, J = measurement.time, measurement.v, measurement.payload_jacobian
        gamma_xtilde = gains.pose_gain.dot(rows.pose_error(measurement.payload_pose, reference.pose))
        s = J_plus.dot(measurement.payload_twist - reference.twist + gamma_xtilde)
        s_d = state.start_surface * exp(-gains.transient_rate * (t - state.start_time))
        s_q = s - s_d
        qdot_r = (
            J_plus.dot(measurement.by_arm(reference.twist) - gamma_xtilde)
            + s_d
            - gains.sign_gain.dot(state.sign_integral)
        )
        s_r = v - qdot_r
        tau = -gains.damping_gain.dot(s_r) - J.T.dot(
            force_term(rows, gains.force_gain, measurement, reference)
        )
        sigma = state.sign_integral + self.arm.period * (self.switching(s_q) * ~measurement.saturated)
        tau = self.with_posture(tau, measurement, J_plus)
        return ArmCommand(tau, SlidingModeState(state.start_time, state.start_surface, sigma))


@dataclass(frozen=True, eq=False)
class RedundantSlidingModeController(SlidingModeController):
    """Law (23) for a redundant arm (k > k_0): right pseudo-inverse and posture term, in sampled time.

    ::

        J^+ = J^T (J J^T + damping^2 I)^-1

    The paper prints J^+ = (J^T J)^-1 J^T, which is singular for k > k_0. The other equations are those of
    SlidingModeController.

    **What the proof loses.** For k > k_0, ``s_r = qdot - qdot_r = s_q + alpha sigma + (I - J^+ J) qdot``: eq.
    (21)'s second equality fails. J s_r is as in the paper, so that the internal-wrench terms V_2 and V_3 of
    Theorem 2 stay bounded; but s_q now differs from s_r - alpha sigma by the null-space motion, whose
    derivative is not bounded by the gains: the sliding condition ``s_q^T s_q' <= -epsilon |s_q|`` is not
    proven. K_d damps the null space too. With ``inverse_damping`` > 0, J J^+ is not the identity either, and
    x follows x_d only up to that damping; the scenario of the run records it.

    Attributes:
        posture: spring and damper of the spare joints.
        inverse_damping: damping of the pseudo-inverse, in the unit of J's singular values; 0 is exact.
    """

    posture: Posture
    inverse_damping: float = 0.0

    def inverse(self, measurement: ArmMeasurement) -> Array:
        """Return J^+, shape (k, k_0)."""
        return right_inverse(measurement.payload_jacobian, measurement.time, self.inverse_damping)

    def with_posture(self, tau: Array, measurement: ArmMeasurement, J_plus: Array) -> Array:
        """Return the torque with that of the posture, N m, shape (k,)."""
        return tau + self.posture.torque(measurement.q, measurement.v, measurement.payload_jacobian, J_plus)


class SlidingMode(SurfaceLaw[SlidingModeGains]):
    """The decentralised sliding-mode law, Gueaieb et al. (2007), eq. (23): SlidingModeController.

    For arms with as many joints as task rows.
    """

    needs_square: ClassVar[bool] = True

    kind: Literal["sliding-mode"] = "sliding-mode"

    def controller_of(self, arm: ControlledArm, gains: SlidingModeGains, scenario: Any) -> ArmController:
        """Return the printed law of one arm."""
        return SlidingModeController(arm, gains, self.switching)

    def joint_spring(self, arm: str, J_inverse: Array) -> Array | None:
        """Return B = J^-T K_d J^-1 gamma, shape (k_0, k_0); infinite with an integral, which ramps."""
        gains = self.gains_of(arm)
        K_d, gamma = (gain_matrix(gain, len(J_inverse)) for gain in (gains.damping_gain, gains.pose_gain))
        B: Array = J_inverse.T @ K_d @ J_inverse @ gamma
        return np.full_like(B, np.inf) if np.any(gains.sign_gain) else B


class RedundantSlidingMode(SurfaceLaw[SlidingModeGains]):
    """Law (23) for arms with more joints than task rows: RedundantSlidingModeController.

    Its docstring states what the proof loses.

    Attributes:
        posture: Spring and damper of the spare joints of redundant arms.
        inverse_damping: Damping of the pseudo-inverse; 0 is exact, anything else biases the tracking.
    """

    controls_grasps: ClassVar[bool] = True
    spare_spring: ClassVar[str] = "controller.posture.stiffness"

    kind: Literal["sliding-mode-redundant"] = "sliding-mode-redundant"
    posture: PostureGains = PostureGains()
    inverse_damping: NotNegative = 0.0

    def controller_of(self, arm: ControlledArm, gains: SlidingModeGains, scenario: Any) -> ArmController:
        """Return the law of one arm with its posture term."""
        posture = self.posture.term(arm)
        return RedundantSlidingModeController(arm, gains, self.switching, posture, self.inverse_damping)
