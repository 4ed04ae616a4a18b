"""Payload-space law: sliding and integral terms act on the payload's motion and are shared like its load.

Where a wrench is measured, it anchors the integral, so that the internal force stays where it is desired.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from coop_pin.arrays import Array
from coop_pin.control.bounded_anchor import AnchorState, BoundedAnchor
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.gains import PositiveGain
from coop_pin.control.interface import (
    ArmCommand,
    ArmController,
    ArmMeasurement,
    ArmReference,
    ControlledArm,
)
from coop_pin.control.law import LawController, PostureGains
from coop_pin.control.sliding_surface import Saturation, SurfaceGains, SurfaceLaw, Switching
from coop_pin.control.steady_state import SteadyDirection
from coop_pin.control.terms import Posture, is_new, jacobian_inverse, null_space_part, right_inverse
from coop_pin.errors import FieldError
from coop_pin.schema.base import NotNegative, Positive, number_or_row
from coop_pin.spatial import weight_wrench
from coop_pin.spatial.generic_numbers import identity, known, where
from coop_pin.spatial.task_rows import TaskRows

_BOUND = ("anchor_bias", "anchor_bias_answered")
"""Fields of the bound; a law without one is written without them, as before there was one."""


def _bias(value: Any) -> Any:
    """Return a bias, m and rad, as a pair of positive numbers."""
    bias = value if isinstance(value, str) else number_or_row(value)
    if not isinstance(bias, tuple) or len(bias) != 2 or min(bias) <= 0.0:
        raise FieldError(f"is {value!r}; it must be two positive numbers, m and rad")
    return bias


def _bias_or_none(value: Any) -> Any:
    return value if isinstance(value, str) and value == "none" else _bias(value)


SLIP_GUARD = 1e-2
"""Slip from which on the arms give up, m."""


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


class PayloadSpace(SurfaceLaw[PayloadSpaceGains]):
    """The payload-space law, for any number of joints: PayloadSpaceController.

    What is measured decides how its integral keeps the internal force: the internal wrench anchors it; this
    arm's own wrist wrench does, with a stated payload mass; else it leaks.

    Attributes:
        posture: Spring and damper of the spare joints of redundant arms.
        payload_mass: Approximate mass of the payload, kg, to tell the payload's weight from the internal
            wrench at the arm's own wrist; when omitted, wrist sensors are not used by themselves.
        stale_after: Ticks without a new measurement after which the integral leaks, beyond those that the
            force path itself takes.
        anchor_bias: b_0, the bias of the kinematics for which measured internal wrenches may move the
            integral at any time, m and rad; "none" bounds nothing. At most half of the layer of the integral.
        slip_guard: Slip of a patch, m, from which on the arms of the cell give up squeeze and anchor, which
            would push them on; the largest slip crosses between the arms as measured wrenches do.
        normal_guard: Normal force at the arm's own wrist, N, below which it does so alone where more than
            twice that is desired; 0 guards nothing. The others lose theirs, and give up by themselves.
        anchor_bias_answered: b_max, how far they may while a bias shows at the start, m and rad; a bias near
            it need not come to rest. At most the norm of the edges of the layer. Equal to b_0: a fixed bound.
        gain_axes: Axes of ``sliding_gain``: "world", or "payload", in which a matrix turns with the payload
            as each arm sees it. Then ``pose_gain`` is one value for positions and one for rotations.
        knows_deflection: Whether the arms know the stiffness of compliant grasps, and count on how far the
            squeeze deflects them; else they give up a part of the squeeze to what they see of it.
    """

    later_fields: ClassVar[tuple[str, ...]] = ("gain_axes", "slip_guard", "normal_guard", "knows_deflection")

    equal_gains: ClassVar[Mapping[str, str]] = {
        **SurfaceLaw.equal_gains,
        "anchor_gain": "else the anchors move the payload: it needs one g",
    }

    spare_spring: ClassVar[str] = "controller.posture.stiffness"
    reads_plan: ClassVar[bool] = True

    kind: Literal["payload-space"] = "payload-space"
    switching: Switching = Saturation(width=0.05)
    posture: PostureGains = PostureGains()
    payload_mass: NotNegative | None = None
    stale_after: int = Field(default=3, ge=1)
    anchor_bias: Annotated[Any, BeforeValidator(_bias_or_none)] = (2e-3, 1e-2)
    anchor_bias_answered: Annotated[Any, BeforeValidator(_bias)] = (2e-2, 1e-1)
    slip_guard: Positive = SLIP_GUARD
    gain_axes: Literal["world", "payload"] = "world"
    normal_guard: NotNegative = 0.0
    knows_deflection: bool = False

    @model_validator(mode="before")
    @classmethod
    def _without_bound(cls, fields: Any) -> Any:
        """Return the fields of a record without ``anchor_bias``: of a law that bounds no anchor."""
        omitted = {*_BOUND, "payload_mass", *cls.later_fields}
        is_record = isinstance(fields, Mapping) and {*cls.model_fields} - omitted <= {*fields} - {*_BOUND}
        return {"anchor_bias": "none"} | dict(fields) if is_record else fields

    @model_validator(mode="after")
    def _answers_for_more(self) -> Self:
        if self.anchor_bias != "none" and np.less(self.anchor_bias_answered, self.anchor_bias).any():
            least = list(self.anchor_bias)
            detail = f"is {list(self.anchor_bias_answered)}; it must be at least anchor_bias, {least}"
            raise FieldError(detail, "anchor_bias_answered")
        return self

    @model_serializer(mode="wrap")
    def _written(self, fields_of: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields, without = super()._written(fields_of), _BOUND if self.anchor_bias == "none" else ()
        return {name: value for name, value in fields.items() if name not in without}

    @property
    def measures(self) -> bool:
        """Whether the law measures a wrench."""
        return self.payload_mass is not None or self.force_path.measures

    @property
    def puts_down(self) -> bool:
        """Whether it anchors the integral without a bound, which would keep the load that a table gets."""
        return self.measures and self.gains.anchor_gain > 0.0 and self.anchor_bias == "none"

    @property
    def needs(self) -> tuple[str, ...]:
        """What the law uses besides kinematics: the holding torque, and the internal or its own wrench."""
        is_own = self.payload_mass is not None and not self.force_path.measures
        return self.measured(["holding torque", "own wrench" if is_own else "internal wrench"])

    @property
    def active_gains(self) -> dict[str, Any]:
        """Gains that have an effect, by name; the leak as it acts."""
        return super().active_gains | {"leak": self._leak(self.gains)}

    def _leak(self, gains: PayloadSpaceGains) -> float:
        """Return lambda, 1/s: fast where it bridges a lost sensor, slow where it carries loads."""
        return gains.leak if gains.leak is not None else (10.0 if self.measures else 0.2)

    def controller_of(self, arm: ControlledArm, gains: PayloadSpaceGains, scenario: Any) -> ArmController:
        """Return the law of one arm."""
        return self.payload_space_controller(arm, gains, scenario)

    def payload_space_controller(
        self, arm: ControlledArm, gains: PayloadSpaceGains, scenario: Any
    ) -> PayloadSpaceController:
        """Return the payload-space law of one arm."""
        leak, fastest, mass = self._leak(gains), 1.0 / arm.period, self.payload_mass
        if leak * arm.period > 1.0:  # the integral would overshoot its goal
            detail = f"is {leak:g} /s; at {fastest:g} Hz it can be at most {fastest:g}: state a smaller one"
            raise FieldError(detail, "controller.gains.leak")
        return PayloadSpaceController(
            arm,
            gains,
            self.switching,
            leak,
            payload_weight=None if mass is None else arm.rows.select(weight_wrench(mass, arm.gravity)),
            stale_after=self.stale_after + arm.oldest_wrench,
            posture=self.posture.term(arm) if arm.drives > arm.rows.size else None,
            most_slip=self.slip_guard,
            turns=self._turns(arm.rows, gains),
            compliance=self._compliance(arm, scenario),
            least_normal=self.normal_guard,
            bound=self._bound(arm.rows, gains, arm.load_share, arm.period, 1 + arm.oldest_wrench),
        )

    def _compliance(self, arm: ControlledArm, scenario: Any) -> Array | None:
        """Return C on the task rows, shape (k_0, k_0); None where it is zero, or not known."""
        if not self.knows_deflection or arm.name not in scenario.cell.compliant:
            return None
        return np.array(scenario.cell.compliance(arm.name)[np.ix_(arm.rows.indices, arm.rows.indices)])

    def _turns(self, rows: TaskRows, gains: PayloadSpaceGains) -> bool:
        """Return whether K turns with the payload.

        Raises:
            FieldError: gamma is not that of any axes.
        """
        gamma, linear = gains.pose_gain.diagonal(), rows.are_linear
        kinds = {*gamma[linear]}, {*gamma[~linear]}
        if self.gain_axes == "payload" and max(map(len, kinds)) > 1:
            detail = f"is {gamma.tolist()}; with gain_axes 'payload' it must be one value for all positions"
            raise FieldError(f"{detail}, and one for all rotations", "controller.gains.pose_gain")
        return self.gain_axes == "payload"

    def _bound(
        self, rows: TaskRows, gains: PayloadSpaceGains, share: float, period: float, ticks: int
    ) -> BoundedAnchor | None:
        """Return the bound of the anchor of a share c; None where none is stated, or derived.

        Args:
            rows: The task rows.
            gains: Gains, sized.
            share: c.
            period: T, s.
            ticks: Age that measured wrenches reach at the next tick, without the filter's.
        """
        K, gamma, alpha = gains.sliding_gain, gains.pose_gain, gains.sign_gain.diagonal()
        anchors = self.force_path.measures and gains.anchor_gain > 0.0 and bool(alpha.all())
        if not anchors or self.anchor_bias == "none" or not self.switching.is_smooth:
            return None
        width, pole = self.switching.width, self.force_path.pole
        age = period * (ticks + pole / (1.0 - pole))
        return BoundedAnchor.of_rows(
            rows,
            (self.anchor_bias, self.anchor_bias_answered),
            gain=share * K @ gamma,
            turns=self.gain_axes == "payload",
            forget=alpha / width,
            largest=width / gamma.diagonal(),
            rate=1.0 / (1.0 / gains.transient_rate + age * (1.0 + gains.force_gain) / gains.anchor_gain),
            period=period,
        )

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return K gamma and the integral K alpha phi(gamma x) in each linear task row."""
        gains, internal, phi = self.gains.sized(rows.size, 0), self.force_path.tells_wrenches, self.switching
        beta, leak = gains.anchor_gain / (loop.every * period), self._leak(gains)
        anchored = self.measures and beta > 0.0
        linear = np.flatnonzero(rows.are_linear)
        bound, free, most = self._bound(rows, gains, 1.0, period, loop.every + loop.delay), np.inf, np.inf
        if bound is not None:
            part = gains.anchor_gain / (loop.every * (1.0 + gains.force_gain))
            most = bound.followed_bias(linear[0], part=part, transient_rate=gains.transient_rate)
            free = float(bound.free[linear[0]])

        def direction(gamma: float, K: float, alpha: float) -> SteadyDirection:
            return SteadyDirection(
                spring=lambda x: 0.0 if anchored else K * gamma * x,
                integral=lambda x: K * alpha * float(phi(np.array(gamma * x))),
                internal_rate=beta if self.measures else leak,
                load_rate=0.0 if internal else beta if self.measures else leak,
                free=free,
                most=most,
                force_gain=gains.force_gain if internal else 0.0,
            )

        diagonals = (
            gain.diagonal()[linear] for gain in (gains.pose_gain, gains.sliding_gain, gains.sign_gain)
        )
        if self.gain_axes == "payload":  # K mixes the rows
            return []
        return [direction(*map(float, values)) for values in zip(*diagonals, strict=True)]
