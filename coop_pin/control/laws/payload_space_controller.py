"""Controller of the payload-space law: sliding and integral terms act on the payload, shared like its load.

Where a wrench is measured, it anchors the integral, so that the internal force stays where it is desired.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import NotNegative
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.control.controller import ArmCommand
from coop_pin.control.gains import PositiveGain
from coop_pin.control.law import LawController
from coop_pin.control.laws.anchored_integral import AnchoredIntegral, IntegralState
from coop_pin.control.laws.bounded_anchor import AnchorState
from coop_pin.control.laws.sliding_surface import SurfaceGains, Switching
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.terms import GainAxes, Posture, full_rank_inverse, null_space_part


class PayloadSpaceStart(NamedTuple):
    """Start of the law, of which what is left decays.

    Attributes:
        time: t_0, s.
        surface: s_x(t_0), m/s and rad/s, shape (k_0,).
        squeeze: f_d(t_0) in payload axes, shape (k_0,).
        torque: tau_hold, N m, shape (k,).
        pull: pull of the posture's spring at t_0, N m, shape (k,).
    """

    time: float
    surface: Array
    squeeze: Array
    torque: Array
    pull: Array


class PayloadSpaceState(NamedTuple):
    """Memory of the law.

    Attributes:
        integral: Z.
        start: start of the law.
        command: torque of the last tick, N m, shape (k,).
        anchor: memory of the bounded anchor; None without a bound.
        holds: 1, and 0 from when the arms have lost their grip.
    """

    integral: IntegralState
    start: PayloadSpaceStart
    command: Array
    anchor: AnchorState | None
    holds: float = 1.0


class PayloadSpaceGains(SurfaceGains):
    """Gains of the payload-space law.

    ``sign_gain`` over the width of the saturation is k_I, the integral rate of a PI controller, 1/s.

    Attributes:
        sliding_gain: K, on the task rows: three for the position, N s/m, then three for the orientation,
            N m s/rad.
        anchor_gain: g, the part of the measured wrench error that each new measurement takes out of the
            integral; without a measured wrench it does nothing.
        leak: lambda, how fast the integral forgets what it gained since the last measurement, 1/s; it acts
            while there is none. When omitted 10 where the law measures a wrench, 0 with a dead zone of the
            integral, else 0.2.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("pose_gain", "sign_gain", "sliding_gain")

    sliding_gain: PositiveGain
    anchor_gain: NotNegative = 0.1
    leak: NotNegative | None = None


class GripGuard(NamedTuple):
    """Limits at which an arm that holds the payload by friction has lost its grip.

    Attributes:
        rows: the k_0 task rows.
        normal: n, normal of the face out of it in payload axes, a wrench on the task rows, shape (k_0,).
        most_slip: slip of a patch, m.
        least_normal: normal force at this arm's own wrist, N, where more than twice that is desired.
    """

    rows: TaskRows
    normal: Array
    most_slip: float = np.inf
    least_normal: float = 0.0

    def grips(self, measurement: ArmMeasurement, reference: ArmReference, f_r: Array) -> float:
        """Return 0.0 where slip or normal force are beyond a limit, else 1.0."""
        F = measurement.interaction_wrench
        grips = measurement.slip is None or measurement.slip <= self.most_slip
        if self.least_normal > 0.0 and F is not None:
            n = self.rows.turn(reference.pose, self.normal)
            is_watched = n.dot(f_r) > 2.0 * self.least_normal
            grips = grips and not (is_watched and n.dot(F) < self.least_normal)
        return float(grips)


@dataclass(frozen=True, eq=False)
class PayloadSpaceController(LawController[PayloadSpaceGains]):
    """Law (23) on the payload: motion terms leave no internal wrench; decentralised, without a model.

    For any number of joints k >= k_0; with fewer, J^+ = (J^T J)^-1 J^T and the drives feel J J^+ of a wrench:
    anchor and integral then move Z by that part alone, and the arm's structure bears the rest. Wrenches and
    twists are about P in world axes, on the task rows.

    ::

        e        = exp(-kappa (t - t_0))
        s        = xtildedot + gamma (xtilde + R C (f_d - f_d(t_0) e)) - s_x(t_0) e
        f_r      = R (f_d - f_d(t_0) e)
        start    Z = Z_hold = -(J^+)^T tau_hold              for a pressed patch less f_d, and f_r = R f_d
        anchor   Z <- Z - g (fhat - f_r),  Z_hold <- Z       before the torque, once for each new measurement
        torque   tau = -J^T [c K s + Z + f_r - K_f (fhat - f_r)] + N^T [tau_hold + pull - pull(t_0) e]
        leak     Z <- Z - lambda T (Z - Z_hold)              after it, while no measurement is recent
        integral Z <- Z + T c K alpha phi(s - z)             after it, while no torque of the arm is saturated
        z        = min(max(s, -gamma delta), gamma delta)    the part of s in the dead zone of the integral

    s_x = xtildedot + gamma xtilde, R turns payload axes as this arm sees them (of a pressed patch as desired,
    so that f_r of all arms sum to zero although their patches tilt), N = I - J^+ J, and pull is the
    spring and damper of the spare joints. C is the compliance of a grasp that the arm knows, or zero: the
    squeeze deflects the grasp by -C f_d, and what the arm sees of it is no error. Inside a saturation layer
    of half width w the integral is that of a PI controller, k_I = alpha / w. With a dead zone it rests while
    no row of the pose is more than delta off: views that differ by less than 2 delta leave no ramp, and the
    internal force depends on how the load came. See the page "What a law cannot do without a wrench".

    What is measured decides what fhat is:

    - the internal wrench f_m: the law is the *anchored PI*. The anchors of all arms sum to zero, so that
      they do not move the payload, and a constant kinematic bias leaves a constant internal force;
    - this arm's own wrist wrench F, with a stated approximate payload mass: fhat = F - c What. Nothing
      crosses between the arms; the error of What is a constant load on the motion;
    - nothing: the *leaky PI*, which forgets what differs from the holding torques at the rate lambda.

    The derivation is on the page "Proofs of the payload-space law" of the documentation.

    Attributes:
        switching: phi: sgn, or a smooth function in its place.
        integral: Z with anchor and leak. With a bound of the anchor, the integral takes over what drives cut:
            see the page "The bounded anchor".
        axes: axes of K; where they turn with the payload, R K R^T is in place of K.
        payload_weight: approximate weight What of the payload as a wrench, shape (k_0,); None ignores
            the wrist sensor.
        compliance: C about P in payload axes, m/N and rad/(N m), shape (k_0, k_0); None for zero.
        posture: spring and damper of the spare joints; None for an arm without spare joints.
        guard: limits beyond which f_r = 0 and the anchor rests; None for an arm that does not press.
        dead_zone: gamma delta, in the unit of the surface, shape (k_0,); None for none.
    """

    switching: Switching
    integral: AnchoredIntegral
    axes: GainAxes
    payload_weight: Array | None = None
    compliance: Array | None = None
    posture: Posture | None = None
    guard: GripGuard | None = None
    dead_zone: Array | None = None

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> PayloadSpaceState:
        """Return the state at t_0, with which the first torque is the holding torque.

        Without a measured holding torque, Z = 0 and the spare joints' spring acts at once.

        Raises:
            SingularJacobianError: there is a holding torque, and the payload Jacobian loses rank.
        """
        J, tau_hold = measurement.payload_jacobian, measurement.holding_torque
        Z, nothing = np.zeros(self.arm.rows.size), np.zeros(J.shape[1])
        pull, squeeze, reported = nothing, reference.internal_wrench, measurement.reported_torque
        if tau_hold is not None:
            Z = -full_rank_inverse(J, measurement.time).T.dot(tau_hold)
            pull = nothing if self.posture is None else self.posture.pull(measurement.q, measurement.v)
        if self.arm.pressed:  # the holding torque has the squeeze in it, which f_r keeps
            Z, squeeze = Z - self._squeeze(measurement, reference, squeeze), np.zeros_like(squeeze)
        return PayloadSpaceState(
            IntegralState(Z, Z, np.inf),
            PayloadSpaceStart(
                time=measurement.time,
                surface=self._surface(measurement, reference),
                squeeze=squeeze,
                torque=nothing if tau_hold is None else tau_hold,
                pull=pull,
            ),
            command=nothing if reported is None else reported,
            anchor=None if self.integral.bound is None else self.integral.bound.start(),
        )

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: PayloadSpaceState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian of an arm with spare joints, or too few, loses rank.
        """
        arm, gains, start = self.arm, self.gains, state.start
        c, K, J = arm.load_share, gains.sliding_gain, measurement.payload_jacobian
        X_WP, K_f = measurement.payload_pose, gains.force_gain
        e = np.exp(-gains.transient_rate * (measurement.time - start.time))
        s = self._surface(measurement, reference) - start.surface * e
        f_d = reference.internal_wrench - start.squeeze * e
        f_r, grip = self._squeeze(measurement, reference, f_d), 1.0
        if self.compliance is not None:
            s = s + gains.pose_gain.dot(arm.rows.turn(X_WP, self.compliance.dot(f_d)))
        if self.guard is not None:
            grip = state.holds * self.guard.grips(measurement, reference, f_r)
            f_r = grip * f_r
        fhat, age = self._measured_wrench(measurement, f_r, reference.share(arm))
        is_used = J.shape[1] < J.shape[0] or self.posture is not None
        J_plus = full_rank_inverse(J, measurement.time) if is_used else None
        error, uncut = _felt(fhat - f_r, J, J_plus), 1.0 - measurement.saturated.any()
        integral, anchor = self.integral.anchored(
            (state.integral, state.anchor),
            measurement,
            error=error,
            age=age,
            grip=grip,
            command=state.command,
            J_plus=J_plus,
            uncut=uncut,
        )
        tau = -J.T.dot(c * self.axes.product(K, X_WP, s) + integral.value + f_r - K_f * error)
        if self.posture is not None and J_plus is not None:
            pull = self.posture.pull(measurement.q, measurement.v) - start.pull * e
            tau = tau + null_space_part(start.torque + pull, J, J_plus)

        goes_on, leak = self.integral.rates(integral, measurement, uncut)
        rate = goes_on * c * self.axes.product(K, X_WP, gains.sign_gain.dot(self.switched(s)))
        change = _felt(arm.period * (rate - leak), J, J_plus)
        integral, anchor = self.integral.following((integral, anchor), change, X_WP)
        holds = state.holds if self.guard is None else grip
        return ArmCommand(tau, PayloadSpaceState(integral, start, tau, anchor, holds))

    def switched(self, s: Array) -> Array:
        """Return phi(s - z), shape (k_0,)."""
        if self.dead_zone is None:
            return self.switching(s)
        return self.switching(s - np.minimum(np.maximum(s, -self.dead_zone), self.dead_zone))

    def remarks(self, pose: Array, state: PayloadSpaceState) -> list[str]:
        """Return that the bound of the anchor acts, if it does."""
        bound, anchor = self.integral.bound, state.anchor
        if bound is None or anchor is None or not bound.is_reached(anchor, pose):
            return []
        return [
            "the anchor is at its bound: a dead arm, drives that are too weak, a wrong wrench, or a bias that"
            " changed after the start; analysis.anchor_bounded_time tells for how long, a larger"
            " controller.anchor_bias allows more"
        ]

    def _surface(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return s_x = xtildedot + gamma xtilde, shape (k_0,)."""
        xtilde = self.arm.rows.pose_error(measurement.payload_pose, reference.pose)
        return measurement.payload_twist - reference.twist + self.gains.pose_gain.dot(xtilde)

    def _squeeze(self, measurement: ArmMeasurement, reference: ArmReference, f_d: Array) -> Array:
        """Return R f_d, shape (k_0,), with R as desired for pressed arms, else as measured."""
        pose = reference.pose if self.arm.pressed else measurement.payload_pose
        return self.arm.rows.turn(pose, f_d)

    def _measured_wrench(self, measurement: ArmMeasurement, f_r: Array, share: float) -> tuple[Array, float]:
        """Return fhat, shape (k_0,), and its age in ticks; f_r of age inf if nothing is measured."""
        if measurement.internal_wrench is not None:
            return measurement.internal_wrench, measurement.internal_wrench_age
        if measurement.interaction_wrench is None or self.payload_weight is None:
            return f_r, np.inf
        fhat = measurement.interaction_wrench - share * self.payload_weight
        return fhat, measurement.interaction_wrench_age


def _felt(wrench: Array, J: Array, J_plus: Array | None) -> Array:
    """Return J J^+ of a wrench, the part that the drives feel: all of it with as many joints as rows."""
    if J_plus is None or J.shape[1] > J.shape[0]:
        return wrench
    return J.dot(J_plus.dot(wrench))
