"""Decentralised sliding-mode law of Gueaieb et al. (2007), eqs. (18)-(23), as printed and for redundant arms.

SlidingModeController is the printed law for arms with as many joints as task rows (k = k_0).
RedundantSlidingModeController is the same law with the right pseudo-inverse of the payload Jacobian and a
posture term for the spare joints (k > k_0); its docstring states what the proof loses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.interface import ArmCommand, ArmController, ArmMeasurement, ArmReference
from coop_pin.control.switching import Switching
from coop_pin.control.terms import Posture, force_term, jacobian_inverse, right_inverse
from coop_pin.spatial.generic_numbers import exp
from coop_pin.spatial.task_rows import TaskRows


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


@dataclass(frozen=True, eq=False)
class SlidingModeController(ArmController):
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
    is saturated. The paper prints J^+ = (J^T J)^-1 J^T; for k = k_0 it is J^-1.

    Attributes:
        rows: the k_0 task rows.
        period: T, s.
        pose_gain: gamma, 1/s, shape (k_0, k_0).
        sign_gain: alpha, rad/s^2, shape (k, k), diagonal.
        damping_gain: K_d, N m s/rad, shape (k, k).
        force_gain: K_f.
        transient_rate: kappa, 1/s.
        switching: sgn, or a smooth function in its place.
    """

    rows: TaskRows
    period: float
    pose_gain: Array
    sign_gain: Array
    damping_gain: Array
    force_gain: float
    transient_rate: float
    switching: Switching

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> SlidingModeState:
        """Return the state at t_0: the surface there, and sigma = 0.

        Raises:
            SingularJacobianError: the payload Jacobian is singular.
        """
        return self.init_through(_inverse(measurement), measurement, reference)

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian is singular.
        """
        return self.step_through(_inverse(measurement), measurement, reference, state)

    def init_through(
        self, J_plus: Array, measurement: ArmMeasurement, reference: ArmReference
    ) -> SlidingModeState:
        """Return the state at t_0 for a stated inverse of the payload Jacobian, shape (k, k_0)."""
        xtilde = self.rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        s = J_plus.dot(xtildedot + self.pose_gain.dot(xtilde))
        return SlidingModeState(measurement.time, s, np.zeros_like(s))

    def step_through(
        self, J_plus: Array, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState
    ) -> ArmCommand:
        """Return the command for a stated inverse of the payload Jacobian, shape (k, k_0)."""
        # dot, not @: for a 3x3 matrix it costs a third.
        t, v, J = measurement.time, measurement.v, measurement.payload_jacobian
        gamma_xtilde = self.pose_gain.dot(self.rows.pose_error(measurement.payload_pose, reference.pose))
        s = J_plus.dot(measurement.payload_twist - reference.twist + gamma_xtilde)
        s_d = state.start_surface * exp(-self.transient_rate * (t - state.start_time))
        s_q = s - s_d
        qdot_r = J_plus.dot(reference.twist - gamma_xtilde) + s_d - self.sign_gain.dot(state.sign_integral)
        s_r = v - qdot_r
        tau = -self.damping_gain.dot(s_r) - J.T.dot(
            force_term(self.rows, self.force_gain, measurement, reference)
        )
        sigma = state.sign_integral + self.period * (self.switching(s_q) * ~measurement.saturated)
        return ArmCommand(tau, SlidingModeState(state.start_time, state.start_surface, sigma))


def _inverse(measurement: ArmMeasurement) -> Array:
    return jacobian_inverse(measurement.payload_jacobian, measurement.time)


@dataclass(frozen=True, eq=False)
class RedundantSlidingModeController(ArmController):
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
        printed: the printed law, evaluated with this J^+.
        posture: what the spare joints do.
        inverse_damping: of the pseudo-inverse, in the unit of J's singular values; 0 is exact.
    """

    printed: SlidingModeController
    posture: Posture
    inverse_damping: float = 0.0

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> SlidingModeState:
        """Return the state at t_0: the surface there, and sigma = 0.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank and the damping is zero.
        """
        return self.printed.init_through(self._inverse(measurement), measurement, reference)

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: SlidingModeState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank and the damping is zero.
        """
        J_plus = self._inverse(measurement)
        command = self.printed.step_through(J_plus, measurement, reference, state)
        posture = self.posture.torque(measurement.q, measurement.v, measurement.payload_jacobian, J_plus)
        return ArmCommand(command.torque + posture, command.state)

    def _inverse(self, measurement: ArmMeasurement) -> Array:
        return right_inverse(measurement.payload_jacobian, measurement.time, self.inverse_damping)
