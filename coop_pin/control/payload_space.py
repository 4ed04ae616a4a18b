"""Payload-space law: sliding and integral terms act on the payload's motion and are shared like its load.

Where a wrench is measured, it anchors the integral, so that the internal force stays where it is desired.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.interface import ArmCommand, ArmController, ArmMeasurement, ArmReference
from coop_pin.control.switching import Switching
from coop_pin.control.terms import Posture, is_new, null_space_part, right_inverse
from coop_pin.spatial.task_rows import TaskRows


class PayloadSpaceState(NamedTuple):
    """Memory of the law: a wrench, and what it started from.

    Attributes:
        integral: Z, N and N m, shape (k_0,).
        anchored: Z_hold, Z at the last new measurement, at first Z(t_0), shape (k_0,).
        wrench_age: age of the measured wrench at the last tick, in ticks; inf before the first sample.
        start_time: t_0, s.
        start_surface: s_x(t_0), m/s and rad/s, shape (k_0,).
        start_squeeze: f_d(t_0) in payload axes, shape (k_0,).
        holding_torque: tau_hold, N m, shape (k,).
        start_pull: pull of the posture's spring at t_0, N m, shape (k,).
    """

    integral: Array
    anchored: Array
    wrench_age: float
    start_time: float
    start_surface: Array
    start_squeeze: Array
    holding_torque: Array
    start_pull: Array


@dataclass(frozen=True, eq=False)
class PayloadSpaceController(ArmController):
    """Law (23) on the payload: motion terms leave no internal wrench; decentralised, without a model.

    For any number of joints k >= k_0. Wrenches and twists are about P in world axes, on the task rows.

    ::

        e        = exp(-kappa (t - t_0))
        s        = xtildedot + gamma xtilde - s_x(t_0) e
        f_r      = R (f_d - f_d(t_0) e)
        start    Z = Z_hold = -(J^+)^T tau_hold
        anchor   Z <- Z - g (fhat - f_r),  Z_hold <- Z       before the torque, once for each new measurement
        torque   tau = -J^T [c K s + Z + f_r - K_f (fhat - f_r)] + N^T [tau_hold + pull - pull(t_0) e]
        leak     Z <- Z - lambda T (Z - Z_hold)              after it, while no measurement is recent
        integral Z <- Z + T c K alpha phi(s)                 after it, while no torque of the arm is saturated

    s_x = xtildedot + gamma xtilde, R turns payload axes as this arm sees them, N = I - J^+ J, and pull is the
    spring and damper of the spare joints. Inside a saturation layer of half width w the integral is that of a
    PI controller, k_I = alpha / w.

    What is measured decides what fhat is:

    - the internal wrench f_m: the law is the *anchored PI*. The anchors of all arms sum to zero, so that
      they do not move the payload, and a constant kinematic bias leaves a constant internal force;
    - this arm's own wrist wrench F, with a stated approximate payload mass: fhat = F - c What. Nothing
      crosses between the arms; the error of What is a constant load on the motion;
    - nothing: the *leaky PI*, which forgets what differs from the holding torques at the rate lambda.

    The derivation is on the page "Proofs of the payload-space law" of the documentation.

    Attributes:
        rows: the k_0 task rows.
        period: T, s.
        load_share: c of this arm.
        pose_gain: gamma, 1/s, shape (k_0, k_0).
        sliding_gain: K, N s/m and N m s/rad, shape (k_0, k_0).
        sign_gain: alpha, m/s^2 and rad/s^2, shape (k_0, k_0), diagonal.
        force_gain: K_f.
        transient_rate: kappa, 1/s.
        switching: phi: sgn, or a smooth function in its place.
        anchor_gain: g, for each new measurement.
        leak: lambda, 1/s.
        payload_weight: What, the approximate weight of the payload as a wrench, shape (k_0,); None ignores
            the wrist sensor.
        stale_after: age in ticks beyond which a measurement is no longer recent.
        posture: what spare joints do; None for an arm without spare joints.
    """

    rows: TaskRows
    period: float
    load_share: float
    pose_gain: Array
    sliding_gain: Array
    sign_gain: Array
    force_gain: float
    transient_rate: float
    switching: Switching
    anchor_gain: float = 0.0
    leak: float = 0.0
    payload_weight: Array | None = None
    stale_after: float = 3.0
    posture: Posture | None = None

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> PayloadSpaceState:
        """Return the state at t_0, with which the first torque is the holding torque.

        Without a measured holding torque, Z = 0 and the spare joints' spring acts at once.

        Raises:
            SingularJacobianError: there is a holding torque, and the payload Jacobian loses rank.
        """
        J, tau_hold = measurement.payload_jacobian, measurement.holding_torque
        Z, nothing = np.zeros(self.rows.size), np.zeros(J.shape[1])
        pull = nothing
        if tau_hold is not None:
            Z = -right_inverse(J, measurement.time).T.dot(tau_hold)
            pull = nothing if self.posture is None else self.posture.pull(measurement.q, measurement.v)
        return PayloadSpaceState(
            integral=Z,
            anchored=Z,
            wrench_age=np.inf,
            start_time=measurement.time,
            start_surface=self._surface(measurement, reference),
            start_squeeze=reference.internal_wrench,
            holding_torque=nothing if tau_hold is None else tau_hold,
            start_pull=pull,
        )

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: PayloadSpaceState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next."""
        T, c, K, J = self.period, self.load_share, self.sliding_gain, measurement.payload_jacobian
        e = np.exp(-self.transient_rate * (measurement.time - state.start_time))
        s = self._surface(measurement, reference) - state.start_surface * e
        f_r = self.rows.turn(measurement.payload_pose, reference.internal_wrench - state.start_squeeze * e)
        fhat, age = self._measured_wrench(measurement, f_r)

        fresh = is_new(age, state.wrench_age)
        Z = state.integral - fresh * self.anchor_gain * (fhat - f_r)
        Z_hold = np.where(fresh, Z, state.anchored)

        tau = -J.T.dot(c * K.dot(s) + Z + f_r - self.force_gain * (fhat - f_r))
        if self.posture is not None:
            pull = self.posture.pull(measurement.q, measurement.v) - state.start_pull * e
            J_plus = right_inverse(J, measurement.time)
            tau = tau + null_space_part(state.holding_torque + pull, J, J_plus)

        leak = (age > self.stale_after) * self.leak * (Z - Z_hold)
        integral = (1.0 - measurement.saturated.any()) * c * K.dot(self.sign_gain.dot(self.switching(s)))
        return ArmCommand(
            tau, state._replace(integral=Z + T * (integral - leak), anchored=Z_hold, wrench_age=age)
        )

    def _surface(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return s_x = xtildedot + gamma xtilde, shape (k_0,)."""
        xtilde = self.rows.pose_error(measurement.payload_pose, reference.pose)
        return measurement.payload_twist - reference.twist + self.pose_gain.dot(xtilde)

    def _measured_wrench(self, measurement: ArmMeasurement, f_r: Array) -> tuple[Array, float]:
        """Return fhat, shape (k_0,), and its age in ticks; f_r of age inf if nothing is measured."""
        if measurement.internal_wrench is not None:
            return measurement.internal_wrench, measurement.internal_wrench_age
        if measurement.interaction_wrench is None or self.payload_weight is None:
            return f_r, np.inf
        share_of_weight = self.load_share * self.payload_weight
        return measurement.interaction_wrench - share_of_weight, measurement.interaction_wrench_age
