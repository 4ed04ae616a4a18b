"""Controllers as a scenario states them: a law with its gains and force path, or a user's own class."""

from __future__ import annotations

from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, Field
from scipy.optimize import brentq

from coop_pin.control.switching import Sign, Switching
from coop_pin.control.terms import force_gain_bound
from coop_pin.errors import FieldError, suggestion
from coop_pin.schema.base import Description, NotNegative, NumberVectorOrMatrix, Positive, Vector
from coop_pin.schema.user_code import FunctionName

Gain = NumberVectorOrMatrix
"""A gain matrix: a number times the identity, a diagonal, or rows."""


def _diagonal(alpha: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse an alpha that is not diagonal or has a negative entry."""
    rows = np.array(alpha)
    if rows.ndim == 2 and not np.array_equal(rows, np.diag(np.diag(rows))):
        raise FieldError(
            f"is {rows.tolist()}; alpha must be diagonal, otherwise s^T alpha sgn(s) has no sign"
        )
    if np.min(rows) < 0.0:
        raise FieldError(f"is {rows.tolist()}; alpha must not be negative")
    return alpha


def _positive_definite(gain: float | tuple[Any, ...]) -> float | tuple[Any, ...]:
    """Refuse a gain that is not positive, or a matrix whose symmetric part is not positive definite."""
    rows = np.array(gain, dtype=float)
    if rows.ndim == 2 and rows.shape[0] != rows.shape[1]:
        raise FieldError(f"has shape {rows.shape}; a gain matrix is square")
    smallest = float(np.linalg.eigvalsh((rows + rows.T) / 2)[0]) if rows.ndim == 2 else float(np.min(rows))
    if smallest <= 0.0:
        wanted = (
            "positive",
            "positive in every entry",
            f"positive definite (smallest eigenvalue {smallest:g})",
        )
        raise FieldError(f"is {rows.tolist()}; it must be {wanted[rows.ndim]}")
    return gain


PositiveGain = Annotated[Gain, AfterValidator(_positive_definite)]
SignGain = Annotated[Gain, AfterValidator(_diagonal)]


class Gains(Description):
    """Gains common to the laws.

    Attributes:
        pose_gain: gamma, how fast pose errors decay, 1/s; one for all task rows (6, or 3 for a planar cell)
            or one for each.
        sign_gain: alpha, on the integral of the error's sign; diagonal. On the joints, rad/s^2, or on the
            task rows, m/s^2 and rad/s^2: see the law.
        force_gain: K_f, how strongly the measured internal wrench is fed back; no unit.
        transient_rate: kappa of eq. (20), how fast the sliding surface that starts at the first error decays,
            1/s.
    """

    pose_gain: PositiveGain
    sign_gain: SignGain
    force_gain: NotNegative = 0.0
    transient_rate: Positive


class SlidingModeGains(Gains):
    """Gains of law (23) for one arm.

    Attributes:
        damping_gain: K_d, on the joints, N m s/rad; one for all or one for each.
    """

    damping_gain: PositiveGain


class PayloadSpaceGains(Gains):
    """Gains of the payload-space law.

    Attributes:
        sliding_gain: K_x, on the task rows: three for the position, N s/m, then three for the orientation,
            N m s/rad.
    """

    sliding_gain: PositiveGain


class PostureGains(Description):
    """Null-space spring towards the arm's posture, and damper, of the spare joints of redundant arms.

    Attributes:
        stiffness: N m/rad, one value for all joints or one for each.
        damping: N m s/rad, likewise.
    """

    stiffness: NotNegative | Vector = 40.0
    damping: NotNegative | Vector = 8.0


class NoForcePath(Description):
    """No measured internal wrench: K_f must be zero, and the law is truly decentralised."""

    kind: Literal["none"] = "none"


_Delay = Annotated[int, Field(ge=0)]


class LateForcePath(Description):
    """Internal wrench of one tick before: f_m[k] = f(t_k^-), f_m[0] = f_d.

    Attributes:
        delay: D, ticks of transport: f_m[k] = f(t_{k-D}^-), and f_d until the first sample is there.
    """

    kind: Literal["late"] = "late"
    delay: _Delay = 0

    @property
    def pole(self) -> float:
        """The filter's p: 0."""
        return 0.0


class LowPassForcePath(Description):
    """Discrete low-pass filter: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    It takes every sample once, when it arrives; between samples of slow sensors it holds.

    Attributes:
        pole: p, in [0, 1).
        delay: D, ticks of transport before the filter, which then takes f(t_{k-D}^-).
    """

    kind: Literal["low-pass"] = "low-pass"
    pole: float = Field(default=0.9, ge=0.0, lt=1.0)
    delay: _Delay = 0


ForcePath = Annotated[NoForcePath | LateForcePath | LowPassForcePath, Field(discriminator="kind")]

GainsOfLaw = TypeVar("GainsOfLaw", bound=Gains)


class DecentralisedLaw(Description, Generic[GainsOfLaw]):
    """Fields common to the decentralised laws.

    Attributes:
        gains: for every arm.
        arm_gains: gains of single arms, in place of ``gains``.
        switching: the switching function of the integral, eq. (18).
        force_path: how the internal wrench reaches the law.
    """

    kind: str
    gains: GainsOfLaw
    arm_gains: dict[str, GainsOfLaw] = Field(default_factory=dict)
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()

    def gains_of(self, arm: str) -> GainsOfLaw:
        """Return the gains of one arm."""
        return self.arm_gains.get(arm, self.gains)


class SlidingMode(DecentralisedLaw[SlidingModeGains]):
    """The decentralised sliding-mode law, Gueaieb et al. (2007), eq. (23): SlidingModeController.

    For arms with as many joints as task rows.
    """

    kind: Literal["sliding-mode"] = "sliding-mode"


class RedundantSlidingMode(DecentralisedLaw[SlidingModeGains]):
    """Law (23) for arms with more joints than task rows: RedundantSlidingModeController.

    Its docstring states what the proof loses.

    Attributes:
        posture: what the spare joints of redundant arms do.
        inverse_damping: of the pseudo-inverse; 0 is exact, anything else biases the tracking.
    """

    kind: Literal["sliding-mode-redundant"] = "sliding-mode-redundant"
    posture: PostureGains = PostureGains()
    inverse_damping: NotNegative = 0.0


class PayloadSpace(DecentralisedLaw[PayloadSpaceGains]):
    """The payload-space law, a repair of law (23) for any number of joints: PayloadSpaceController.

    Attributes:
        posture: what the spare joints of redundant arms do.
    """

    kind: Literal["payload-space"] = "payload-space"
    posture: PostureGains = PostureGains()


Law = SlidingMode | RedundantSlidingMode | PayloadSpace
"""The laws that come with coop_pin."""


class UserController(Description):
    """A controller class of the user's own.

    Attributes:
        target: "module:Class", or the class; it is called with the scenario, the arm's name and the options.
        options: handed to it.
        force_path: how the internal wrench reaches it.
    """

    kind: Literal["user"] = "user"
    target: FunctionName
    options: dict[str, Any] = Field(default_factory=dict)
    force_path: ForcePath = NoForcePath()


Controller = Annotated[Law | UserController, Field(discriminator="kind")]

_INSIST = "or insist with beyond_bound = true"


def controller_problems(
    controller: Law | UserController, arms: list[str], wrist_delay: int = 0
) -> list[FieldError]:
    """Return what is wrong with a controller for a cell.

    Args:
        controller: the law with its gains.
        arms: of the cell.
        wrist_delay: samples by which wrist sensors delay the internal wrench, besides the force path.
    """
    if isinstance(controller, UserController):
        return []
    strangers = [name for name in controller.arm_gains if name not in arms]
    if strangers:
        detail = f"names {strangers}, which the cell does not have; {suggestion(strangers[0], arms)}"
        return [FieldError(detail, "arm_gains")]
    return [*_unequal(controller, arms), *_beyond_force_bound(controller, arms, wrist_delay)]


def _unequal(controller: Law, arms: list[str]) -> list[FieldError]:
    """Return the gains that differ between arms although Theorem 2 needs one value for all."""
    problems: list[FieldError] = []
    for field, symbol in (("pose_gain", "gamma"), ("force_gain", "K_f")):
        values = {name: getattr(controller.gains_of(name), field) for name in arms}
        if not all(np.array_equal(value, values[arms[0]]) for value in values.values()):
            detail = f"differs between arms: {values}; Theorem 2 needs one {symbol} for all arms"
            problems.append(FieldError(f"{detail}. Make them equal, {_INSIST}", f"arm_gains.*.{field}"))
    return problems


def _beyond_force_bound(controller: Law, arms: list[str], wrist_delay: int) -> list[FieldError]:
    """Return the problem of a force gain without measured force, or with unstable sampled feedback."""
    path, largest = controller.force_path, max(controller.gains_of(name).force_gain for name in arms)
    if isinstance(path, NoForcePath):
        allowed = largest == 0.0
        detail = (
            "but force_path.kind 'none' measures no force; "
            "set the gain to 0, or the kind to 'late' or 'low-pass'"
        )
    else:
        delay = path.delay + wrist_delay
        bound = _delayed_bound(path.pole, delay) if delay else force_gain_bound(path.pole)
        allowed = largest < bound
        late = f" with {delay} samples of delay" if delay else ""
        detail = f"but feedback over {path.kind!r}{late} is unstable from {bound:g} on; lower it, {_INSIST}"
    return [] if allowed else [FieldError(f"is {largest:g}, {detail}", "gains.force_gain")]


def _delayed_bound(pole: float, delay: int) -> float:
    """Return the force gain at which feedback over a filter and D > 0 ticks of delay goes unstable.

    z^D (z - p) + K_f (1 - p) = 0 has its first roots on the unit circle at z = exp(j a) with D a + arg(z - p)
    = pi, where K_f = |z - p| / (1 - p). Without a filter it is 1, whatever the delay.
    """

    def point(angle: float) -> complex:
        return complex(np.exp(1j * angle) - pole)

    angle = brentq(lambda a: delay * a + np.angle(point(a)) - np.pi, 0.0, np.pi)
    return float(abs(point(angle)) / (1.0 - pole))
