"""Payload-space law as a scenario states it: its fields, its checks, its bound, and its errors at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    model_validator,
)

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import NotNegative, Positive, number_or_row
from coop_pin.base.spatial import TaskRows, weight_wrench
from coop_pin.base.spatial.grasp_rows import GraspRows
from coop_pin.control.bounds import SampledLoop
from coop_pin.control.controller import ArmController
from coop_pin.control.grasp_space import gains_in_grasp
from coop_pin.control.law import LoadTransfer
from coop_pin.control.laws.anchored_integral import AnchoredIntegral
from coop_pin.control.laws.bounded_anchor import BoundedAnchor
from coop_pin.control.laws.payload_space_controller import (
    GripGuard,
    PayloadSpaceController,
    PayloadSpaceGains,
)
from coop_pin.control.laws.sliding_surface import Saturation, SurfaceLaw, Switching
from coop_pin.control.measurement import ControlledArm
from coop_pin.control.steady_state import SteadyDirection
from coop_pin.control.terms import GainAxes, PostureGains


def _bias(value: Any) -> Any:
    """Return a bias, m and rad, as a pair of positive numbers."""
    bias = value if isinstance(value, str) else number_or_row(value)
    if not isinstance(bias, tuple) or len(bias) != 2 or min(bias) <= 0.0:
        raise FieldError(f"is {value!r}; it must be two positive numbers, m and rad")
    return bias


def _half_widths(value: Any) -> Any:
    """Return the half widths of a dead zone, m and rad."""
    zone = number_or_row(value)
    if not isinstance(zone, tuple) or len(zone) != 2 or min(zone) < 0.0:
        raise FieldError(f"is {value!r}; it must be two numbers, m and rad, of which none is negative")
    return zone


def _bias_or_none(value: Any) -> Any:
    return value if isinstance(value, str) and value == "none" else _bias(value)


SLIP_GUARD = 1e-2
"""Slip from which on the arms give up, m."""


class PayloadSpace(SurfaceLaw[PayloadSpaceGains]):
    """The payload-space law, for any number of joints: PayloadSpaceController.

    What is measured decides how its integral keeps the internal force: the internal wrench anchors it; this
    arm's own wrist wrench does, with a stated payload mass; else it leaks, or has a dead zone.

    Attributes:
        posture: Spring and damper of the spare joints of redundant arms.
        payload_mass: Approximate mass of the payload, kg, to separate the payload's weight from the internal
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
        integral_dead_zone: delta, errors of the pose within which the integral rests, m and rad, for a law
            without measured wrench and without leak; more than half of what the arms' views differ by.
    """

    equal_gains: ClassVar[Mapping[str, str]] = {
        **SurfaceLaw.equal_gains,
        "anchor_gain": "else the anchors move the payload: it needs one g",
    }

    controls_grasps: ClassVar[bool] = True
    controls_part: ClassVar[bool] = True
    works_apart: ClassVar[bool] = True
    spare_spring: ClassVar[str] = "controller.posture.stiffness"

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
    integral_dead_zone: Annotated[Any, BeforeValidator(_half_widths)] = (0.0, 0.0)

    @model_validator(mode="after")
    def _rests_alone(self) -> Self:
        if any(self.integral_dead_zone) and (self.measures or self._leaks):
            why = "a measured wrench anchors the integral" if self.measures else "gains.leak empties it"
            detail = f"is {list(self.integral_dead_zone)}, but {why}; leave one of the two out"
            raise FieldError(detail, "integral_dead_zone")
        return self

    @model_validator(mode="after")
    def _answers_for_more(self) -> Self:
        if self.anchor_bias != "none" and np.less(self.anchor_bias_answered, self.anchor_bias).any():
            least = list(self.anchor_bias)
            detail = f"is {list(self.anchor_bias_answered)}; it must be at least anchor_bias, {least}"
            raise FieldError(detail, "anchor_bias_answered")
        return self

    @property
    def measures(self) -> bool:
        """Whether the law measures a wrench."""
        return self.payload_mass is not None or self.force_path.measures

    @property
    def load_transfer(self) -> LoadTransfer:
        """Response to the plan; an anchor with a bound would keep the load that a table gets."""
        is_anchored = self.measures and self.gains.anchor_gain > 0.0
        return LoadTransfer(follows_plan=True, releases=is_anchored and self.anchor_bias == "none")

    @property
    def needs(self) -> tuple[str, ...]:
        """Needs of the law: the holding torque, and the internal or its own wrench."""
        is_own = self.payload_mass is not None and not self.force_path.measures
        return self.measured(["holding torque", "own wrench" if is_own else "internal wrench"])

    @property
    def active_gains(self) -> dict[str, Any]:
        """Gains that have an effect, by name; the leak as it acts."""
        return super().active_gains | {"leak": self._leak(self.gains)}

    def _leak(self, gains: PayloadSpaceGains) -> float:
        """Return lambda, 1/s: fast where it bridges a lost sensor, slow where it carries loads."""
        if gains.leak is not None:
            return gains.leak
        return 10.0 if self.measures else 0.0 if any(self.integral_dead_zone) else 0.2

    @property
    def _leaks(self) -> bool:
        """Whether a leak is stated for any arm."""
        return any(gains.leak for gains in (self.gains, *self.arm_gains.values()))

    @property
    def beyond_dead_zone(self) -> Self:
        """The law without its dead zone, as it acts on errors beyond it."""
        if not any(self.integral_dead_zone):
            return self
        arms = {name: gains.replace(leak=0.0) for name, gains in self.arm_gains.items()}
        gains = self.gains.replace(leak=0.0)
        return self.replace(gains=gains, arm_gains=arms, integral_dead_zone=(0.0, 0.0))

    def controller_of(self, arm: ControlledArm, gains: PayloadSpaceGains, scenario: Any) -> ArmController:
        """Return the law of one arm."""
        leak, fastest, mass = self._leak(gains), 1.0 / arm.period, self.payload_mass
        if leak * arm.period > 1.0:  # the integral would overshoot its goal
            detail = f"is {leak:g} /s; at {fastest:g} Hz it can be at most {fastest:g}: state a smaller one"
            raise FieldError(detail, "controller.gains.leak")
        rows, share, n, axes = arm.rows, arm.load_share, arm.way_out, self._axes(arm.rows, gains)
        integral = AnchoredIntegral(
            gain=gains.anchor_gain,
            leak=leak,
            stale_after=self.stale_after + arm.oldest_wrench,
            bound=self._bound(axes, gains, share, arm.period, 1 + arm.oldest_wrench),
        )
        guard = None
        if n is not None:
            normal = rows.select(np.append(n, np.zeros(3)))
            guard = GripGuard(rows, normal, self.slip_guard, self.normal_guard)
        return PayloadSpaceController(
            arm,
            gains,
            self.switching,
            integral,
            axes,
            payload_weight=None if mass is None else rows.select(weight_wrench(mass, arm.gravity)),
            compliance=self._compliance(arm, scenario),
            posture=self.posture.term(arm) if arm.drives > rows.size else None,
            guard=guard,
            dead_zone=self._zone(rows, gains) if any(self.integral_dead_zone) else None,
        )

    def gains_in(self, grasp: GraspRows, gains: PayloadSpaceGains) -> PayloadSpaceGains:
        """Return sized gains on the rows of a grasp, with K as the grasp transmits it.

        Raises:
            FieldError: the law reads its own wrist, whose load a joint does not bear by its share.
        """
        if self.payload_mass is not None:
            detail = f"is {self.payload_mass:g} kg, but a grasp is a joint, which bears no load share"
            raise FieldError(f"{detail}; measure the internal wrench: force_path", "controller.payload_mass")
        return gains_in_grasp(gains, grasp, self.gain_axes == "payload", "sliding_gain")

    def _zone(self, rows: TaskRows, gains: PayloadSpaceGains) -> Array:
        """Return gamma delta, shape (k_0,)."""
        zone: Array = gains.pose_gain.diagonal() * rows.select(np.repeat(self.integral_dead_zone, 3))
        return zone

    def _compliance(self, arm: ControlledArm, scenario: Any) -> Array | None:
        """Return C on the task rows, shape (k_0, k_0); None where it is zero, or not known."""
        if not self.knows_deflection or arm.name not in scenario.cell.compliant:
            return None
        return np.array(scenario.cell.compliance(arm.name)[np.ix_(arm.rows.indices, arm.rows.indices)])

    def _axes(self, rows: TaskRows, gains: PayloadSpaceGains) -> GainAxes:
        """Return the axes of K.

        Raises:
            FieldError: gamma is not that of any axes.
        """
        gamma, linear = gains.pose_gain.diagonal(), rows.are_linear
        kinds = {*gamma[linear]}, {*gamma[~linear]}
        if self.gain_axes == "payload" and max(map(len, kinds)) > 1:
            detail = f"is {gamma.tolist()}; with gain_axes 'payload' it must be one value for all positions"
            raise FieldError(f"{detail}, and one for all rotations", "controller.gains.pose_gain")
        return GainAxes(rows, self.gain_axes == "payload")

    def _bound(
        self, axes: GainAxes, gains: PayloadSpaceGains, share: float, period: float, ticks: int
    ) -> BoundedAnchor | None:
        """Return the bound of the anchor of a share c; None where none is stated, or derived.

        Args:
            axes: Axes of K.
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
            axes,
            (self.anchor_bias, self.anchor_bias_answered),
            gain=share * K @ gamma,
            forget=alpha / width,
            largest=width / gamma.diagonal(),
            rate=1.0 / (1.0 / gains.transient_rate + age * (1.0 + gains.force_gain) / gains.anchor_gain),
            period=period,
        )

    def steady_directions(self, rows: TaskRows, loop: SampledLoop, period: float) -> list[SteadyDirection]:
        """Return K gamma and the integral K alpha phi(gamma x) in each linear task row."""
        gains, internal, phi = (
            self.gains.sized(rows.size, 0),
            self.force_path.exchanges_wrenches,
            self.switching,
        )
        beta, leak = gains.anchor_gain / (loop.every * period), self._leak(gains)
        anchored = self.measures and beta > 0.0
        linear = np.flatnonzero(rows.are_linear)
        bound, free, most = (
            self._bound(GainAxes(rows), gains, 1.0, period, loop.every + loop.delay),
            np.inf,
            np.inf,
        )
        if bound is not None:
            part = gains.anchor_gain / (loop.every * (1.0 + gains.force_gain))
            most = bound.followed_bias(linear[0], part=part, transient_rate=gains.transient_rate)
            free = float(bound.free[linear[0]])

        delta = self.integral_dead_zone[0]

        def direction(gamma: float, K: float, alpha: float) -> SteadyDirection:
            return SteadyDirection(
                spring=lambda x: 0.0 if anchored else K * gamma * x,
                integral=lambda x: K * alpha * float(phi(np.array(gamma * max(x - delta, 0.0)))),
                internal_rate=beta if self.measures else leak,
                load_rate=0.0 if internal else beta if self.measures else leak,
                free=free,
                most=most,
                force_gain=gains.force_gain if internal else 0.0,
                rests=delta,
            )

        diagonals = (
            gain.diagonal()[linear] for gain in (gains.pose_gain, gains.sliding_gain, gains.sign_gain)
        )
        if self.gain_axes == "payload":  # K mixes the rows
            return []
        return [direction(*map(float, values)) for values in zip(*diagonals, strict=True)]
