"""Controllers as a scenario states them: a law with its gains and force path, or a user's own class."""

from __future__ import annotations

from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, Field

from coop_pin.control.switching import Saturation, Sign, Switching
from coop_pin.errors import FieldError
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

    ``sign_gain`` over the width of the saturation is k_I, the integral rate of a PI controller, 1/s.

    Attributes:
        sliding_gain: K, on the task rows: three for the position, N s/m, then three for the orientation,
            N m s/rad.
        anchor_gain: g, the part of the measured wrench error that each new measurement takes out of the
            integral; without a measured wrench it does nothing.
        leak: lambda, how fast the integral forgets what it gained since the last measurement, 1/s; it acts
            while there is none. When omitted 10 where the law measures a wrench, else 0.2.
    """

    sliding_gain: PositiveGain
    anchor_gain: NotNegative = 0.1
    leak: NotNegative | None = None


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
        zero_at_grasp: each arm places its payload frame at the scenario's start pose, once: a kinematic bias
            fixed in its tip vanishes.
    """

    kind: str
    gains: GainsOfLaw
    arm_gains: dict[str, GainsOfLaw] = Field(default_factory=dict)
    switching: Switching = Sign()
    force_path: ForcePath = NoForcePath()
    zero_at_grasp: bool = False

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
    """The payload-space law, for any number of joints: PayloadSpaceController.

    What is measured decides how its integral keeps the internal force: the internal wrench anchors it; this
    arm's own wrist wrench does, with a stated payload mass; else it leaks.

    Attributes:
        posture: what the spare joints of redundant arms do.
        payload_mass: approximate mass of the payload, kg, to tell the payload's weight from the internal
            wrench at the arm's own wrist; when omitted, wrist sensors are not used by themselves.
        stale_after: ticks without a new measurement after which the integral leaks, beyond those that the
            force path itself takes.
    """

    kind: Literal["payload-space"] = "payload-space"
    switching: Switching = Saturation(width=0.05)
    posture: PostureGains = PostureGains()
    payload_mass: NotNegative | None = None
    stale_after: int = Field(default=3, ge=1)

    @property
    def measures(self) -> bool:
        """Whether the law measures a wrench."""
        return self.payload_mass is not None or not isinstance(self.force_path, NoForcePath)

    def leak_of(self, arm: str) -> float:
        """Return lambda of one arm, 1/s: fast where it bridges a lost sensor, slow where it carries loads."""
        leak = self.gains_of(arm).leak
        return leak if leak is not None else (10.0 if self.measures else 0.2)


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
