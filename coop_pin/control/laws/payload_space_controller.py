"""Controller of the payload-space law: sliding and integral terms act on the payload, shared like its load.

Where a wrench is measured, it anchors the integral, so that the internal force stays where it is desired.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.base import NotNegative
from coop_pin.base.spatial.generic_numbers import identity, known, where
from coop_pin.control.controller import ArmCommand
from coop_pin.control.gains import PositiveGain
from coop_pin.control.law import LawController
from coop_pin.control.laws.bounded_anchor import AnchorState, BoundedAnchor
from coop_pin.control.laws.sliding_surface import SurfaceGains, Switching
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.posture import Posture, null_space_part
from coop_pin.control.terms import is_new, jacobian_inverse, right_inverse


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
        command: torque of the last tick, N m, shape (k,).
        anchor: memory of the bounded anchor; None without a bound.
        holds: 1, and 0 from when the arms have lost their grip.
    """

    integral: Array
    anchored: Array
    wrench_age: float
    start_time: float
    start_surface: Array
    start_squeeze: Array
    holding_torque: Array
    start_pull: Array
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
            while there is none. When omitted 10 where the law measures a wrench, else 0.2.
    """

    on_rows: ClassVar[tuple[str, ...]] = ("pose_gain", "sign_gain", "sliding_gain")

    sliding_gain: PositiveGain
    anchor_gain: NotNegative = 0.1
    leak: NotNegative | None = None


@dataclass(frozen=True, eq=False)
class PayloadSpaceController(LawController[PayloadSpaceGains]):
    """Law (23) on the payload: motion terms leave no internal wrench; decentralised, without a model.

    For any number of joints k >= k_0. Wrenches and twists are about P in world axes, on the task rows.

    ::

        e        = exp(-kappa (t - t_0))
        s        = xtildedot + gamma (xtilde + R C (f_d - f_d(t_0) e)) - s_x(t_0) e
        f_r      = R (f_d - f_d(t_0) e)
        start    Z = Z_hold = -(J^+)^T tau_hold              for a pressed patch less f_d, and f_r = R f_d
        anchor   Z <- Z - g (fhat - f_r),  Z_hold <- Z       before the torque, once for each new measurement
        torque   tau = -J^T [c K s + Z + f_r - K_f (fhat - f_r)] + N^T [tau_hold + pull - pull(t_0) e]
        leak     Z <- Z - lambda T (Z - Z_hold)              after it, while no measurement is recent
        integral Z <- Z + T c K alpha phi(s)                 after it, while no torque of the arm is saturated

    s_x = xtildedot + gamma xtilde, R turns payload axes as this arm sees them (of a pressed patch as desired,
    so that f_r of all arms sum to zero although their patches tilt), N = I - J^+ J, and pull is the
    spring and damper of the spare joints. C is the compliance of a grasp that the arm knows, or zero: the
    squeeze deflects the grasp by -C f_d, and what the arm sees of it is no error. Inside a saturation layer
    of half width w the integral is that of a PI controller, k_I = alpha / w.

    What is measured decides what fhat is:

    - the internal wrench f_m: the law is the *anchored PI*. The anchors of all arms sum to zero, so that
      they do not move the payload, and a constant kinematic bias leaves a constant internal force;
    - this arm's own wrist wrench F, with a stated approximate payload mass: fhat = F - c What. Nothing
      crosses between the arms; the error of What is a constant load on the motion;
    - nothing: the *leaky PI*, which forgets what differs from the holding torques at the rate lambda.

    The derivation is on the page "Proofs of the payload-space law" of the documentation.

    Attributes:
        switching: phi: sgn, or a smooth function in its place.
        leak: lambda, 1/s.
        payload_weight: approximate weight What of the payload as a wrench, shape (k_0,); None ignores
            the wrist sensor.
        stale_after: age in ticks beyond which a measurement is no longer recent.
        posture: spring and damper of the spare joints; None for an arm without spare joints.
        bound: bound of the anchor; None without. With one, the integral takes over what drives cut: see the
            page "The bounded anchor".
        most_slip: slip of a patch from which on f_r = 0 and the anchor rests, m.
        turns: whether K is in payload axes and turns with them: R K R^T in place of K.
        compliance: C about P in payload axes, m/N and rad/(N m), shape (k_0, k_0); None for zero.
        least_normal: normal force of this arm's own wrist below which they do, N.
    """

    switching: Switching
    leak: float
    payload_weight: Array | None = None
    stale_after: float = 3.0
    posture: Posture | None = None
    bound: BoundedAnchor | None = None
    most_slip: float = np.inf
    turns: bool = False
    compliance: Array | None = None
    least_normal: float = 0.0

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> PayloadSpaceState:
        """Return the state at t_0, with which the first torque is the holding torque.

        Without a measured holding torque, Z = 0 and the spare joints' spring acts at once.

        Raises:
            SingularJacobianError: there is a holding torque, and the payload Jacobian loses rank.
        """
        J, tau_hold = measurement.payload_jacobian, measurement.holding_torque
        Z, nothing = np.zeros(self.arm.rows.size), np.zeros(J.shape[1])
        pull = nothing
        if tau_hold is not None:
            Z = -right_inverse(J, measurement.time).T.dot(tau_hold)
            pull = nothing if self.posture is None else self.posture.pull(measurement.q, measurement.v)
        start_squeeze = reference.internal_wrench
        if self.arm.pressed:  # the holding torque has the squeeze in it, which f_r keeps
            Z = Z - self.arm.rows.turn(self._squeeze_axes(measurement, reference), start_squeeze)
            start_squeeze = np.zeros_like(start_squeeze)
        reported = measurement.reported_torque
        return PayloadSpaceState(
            integral=Z,
            anchored=Z,
            wrench_age=np.inf,
            start_time=measurement.time,
            start_surface=self._surface(measurement, reference),
            start_squeeze=start_squeeze,
            holding_torque=nothing if tau_hold is None else tau_hold,
            start_pull=pull,
            command=nothing if reported is None else reported,
            anchor=None if self.bound is None else self.bound.start(),
        )

    def remarks(self, pose: Array, state: PayloadSpaceState) -> list[str]:
        """Return that the bound of the anchor acts, if it does."""
        if self.bound is None or state.anchor is None or not self.bound.is_reached(state.anchor, pose):
            return []
        return [
            "the anchor is at its bound: a dead arm, drives that are too weak, a wrong wrench, or a bias that"
            " changed after the start; analysis.anchor_bounded_time tells for how long, a larger"
            " controller.anchor_bias allows more"
        ]

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: PayloadSpaceState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next."""
        arm, gains, J = self.arm, self.gains, measurement.payload_jacobian
        T, c, pose = arm.period, arm.load_share, measurement.payload_pose
        e = np.exp(-gains.transient_rate * (measurement.time - state.start_time))
        s = self._surface(measurement, reference) - state.start_surface * e
        squeeze = reference.internal_wrench - state.start_squeeze * e
        f_r = arm.rows.turn(self._squeeze_axes(measurement, reference), squeeze)
        if self.compliance is not None:
            s = s + gains.pose_gain.dot(arm.rows.turn(pose, self.compliance.dot(squeeze)))
        holds, grip = state.holds, 1.0
        if arm.pressed:
            holds = grip = holds * self._grips(measurement, reference, f_r)
            f_r = grip * f_r
        fhat, age = self._measured_wrench(measurement, f_r, reference.share(arm))
        error = fhat - f_r

        fresh, stale = is_new(age, state.wrench_age), age > self.stale_after
        uncut, recent = 1.0 - measurement.saturated.any(), 1.0 - stale
        Z, Z_hold, anchor = state.integral, state.anchored, state.anchor
        asked = fresh * (-grip * gains.anchor_gain) * error
        J_plus = None if self.posture is None else right_inverse(J, measurement.time)
        if self.bound is not None and anchor is not None:
            cut = self._cut(measurement, state, J_plus)
            if cut is not None:
                Z, Z_hold = Z - recent * cut, Z_hold - recent * cut
            asked, anchor = self.bound.step(anchor, asked, fresh, uncut * recent, pose)
        Z = Z + asked
        Z_hold = where(fresh, Z, Z_hold)

        tau = -J.T.dot(c * self._weighted(pose, s) + Z + f_r - gains.force_gain * error)
        if self.posture is not None and J_plus is not None:
            pull = self.posture.pull(measurement.q, measurement.v) - state.start_pull * e
            tau = tau + null_space_part(state.holding_torque + pull, J, J_plus)

        leak = stale * self.leak * (Z - Z_hold)
        waits = self.bound is None or measurement.reported_torque is None
        goes_on = uncut if waits else where(stale, uncut, 1.0)
        integral = goes_on * c * self._weighted(pose, gains.sign_gain.dot(self.switching(s)))
        change = T * (integral - leak)
        if self.bound is not None and anchor is not None:
            anchor = self.bound.after(anchor, np.logical_not(stale), change, pose)
        return ArmCommand(
            tau,
            state._replace(
                integral=Z + change, anchored=Z_hold, wrench_age=age, command=tau, anchor=anchor, holds=holds
            ),
        )

    def _cut(
        self, measurement: ArmMeasurement, state: PayloadSpaceState, J_plus: Array | None
    ) -> Array | None:
        """Return the wrench by which drives changed the last command, shape (k_0,); None for none."""
        reported = measurement.reported_torque
        if reported is None:
            return None
        change = reported - state.command
        is_uncut = change.dot(change) == 0.0
        if known(is_uncut):
            return None
        if J_plus is None:  # only where it is used may a Jacobian not be singular
            J = measurement.payload_jacobian
            J_plus = jacobian_inverse(where(is_uncut, identity(len(J)), J), measurement.time)
        return J_plus.T.dot(change)

    def _weighted(self, pose: Array, s: Array) -> Array:
        """Return K s in world axes, shape (k_0,)."""
        K, rows = self.gains.sliding_gain, self.arm.rows
        return rows.turn(pose, K.dot(rows.turn(pose.T, s))) if self.turns else K.dot(s)

    def _squeeze_axes(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return the pose whose axes the squeeze turns with: as seen, or as desired by pressed arms."""
        return reference.pose if self.arm.pressed else measurement.payload_pose

    def _grips(self, measurement: ArmMeasurement, reference: ArmReference, f_r: Array) -> float:
        """Return 0.0 where the slip, or too little normal force where more is desired, tells of a loss."""
        grips = measurement.slip is None or measurement.slip <= self.most_slip
        F, n = measurement.interaction_wrench, self.arm.way_out
        if self.least_normal > 0.0 and F is not None and n is not None:
            normal = self.arm.rows.turn(reference.pose, self.arm.rows.select(np.append(n, np.zeros(3))))
            is_watched = normal.dot(f_r) > 2.0 * self.least_normal
            grips = grips and not (is_watched and normal.dot(F) < self.least_normal)
        return float(grips)

    def _surface(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return s_x = xtildedot + gamma xtilde, shape (k_0,)."""
        xtilde = self.arm.rows.pose_error(measurement.payload_pose, reference.pose)
        return measurement.payload_twist - reference.twist + self.gains.pose_gain.dot(xtilde)

    def _measured_wrench(self, measurement: ArmMeasurement, f_r: Array, share: float) -> tuple[Array, float]:
        """Return fhat, shape (k_0,), and its age in ticks; f_r of age inf if nothing is measured."""
        if measurement.internal_wrench is not None:
            return measurement.internal_wrench, measurement.internal_wrench_age
        if measurement.interaction_wrench is None or self.payload_weight is None:
            return f_r, np.inf
        return (
            measurement.interaction_wrench - share * self.payload_weight,
            measurement.interaction_wrench_age,
        )
