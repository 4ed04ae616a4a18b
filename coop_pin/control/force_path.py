"""Force paths, by which measured internal wrenches reach a law, and the timing of sampled force feedback."""

from __future__ import annotations

import functools
from collections.abc import Collection
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

from pydantic import Field

from coop_pin.control.bounds import anchor_gain_bound, force_gain_bound, force_loop_is_stable
from coop_pin.errors import FieldError
from coop_pin.schema.base import Description, NotNegative, Positive, WithLaterFields

INSIST = "or insist with beyond_bound = true"
"""Advice for those who know better than the bounds."""


Split = Literal["shares", "virtual-linkage"]
"""Load in the measured wrenches, which less it are internal: shares about P, or forces at the tips."""


class _Traits:
    """What is asked of every force path."""

    measures: ClassVar[bool] = True
    """Whether a wrench is measured."""
    by_sensors: ClassVar[bool] = False
    """Whether the internal wrench comes with the measurement, from the wrists of all arms."""
    hears_all: ClassVar[bool] = False
    """Whether every arm hears all others, and its wrench is as late as their messages."""
    tells_wrenches: ClassVar[bool] = True
    """Whether wrenches cross between the arms."""


class NoForcePath(_Traits, Description):
    """No measured internal wrench: K_f must be zero, and the law is truly decentralised."""

    measures: ClassVar[bool] = False
    tells_wrenches: ClassVar[bool] = False
    pole: ClassVar[float] = 0.0
    delay: ClassVar[int] = 0
    split: ClassVar[Split] = "shares"

    kind: Literal["none"] = "none"


_Delay = Annotated[int, Field(ge=0)]


class LateForcePath(_Traits, WithLaterFields):
    """Internal wrench of one tick before: f_m[k] = f(t_k^-), f_m[0] = f_d.

    Attributes:
        delay: D, ticks of transport: f_m[k] = f(t_{k-D}^-), and f_d until the first sample is there.
        split: Load in the measured wrenches: the "shares" about P, or in the "virtual-linkage" tip
            forces without moments, which patches can bear; then the payload's mass may be unknown.
    """

    later_fields: ClassVar[tuple[str, ...]] = ("split",)

    by_sensors: ClassVar[bool] = True
    pole: ClassVar[float] = 0.0

    kind: Literal["late"] = "late"
    delay: _Delay = 0
    split: Split = "shares"


class LowPassForcePath(_Traits, WithLaterFields):
    """Discrete low-pass filter: f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d.

    It takes every sample once, when it arrives; between samples of slow sensors it holds.

    Attributes:
        pole: p, in [0, 1).
        delay: D, ticks of transport before the filter, which then takes f(t_{k-D}^-).
        split: Load in the measured wrenches, as of LateForcePath.
    """

    later_fields: ClassVar[tuple[str, ...]] = ("split",)

    by_sensors: ClassVar[bool] = True

    kind: Literal["low-pass"] = "low-pass"
    pole: float = Field(default=0.9, ge=0.0, lt=1.0)
    delay: _Delay = 0
    split: Split = "shares"


class _TellingForcePath(_Traits, Description):
    """Internal wrench that each arm forms from its wrist wrench and what the arms tell each other."""

    pole: ClassVar[float] = 0.0
    delay: ClassVar[int] = 0
    split: ClassVar[Split] = "shares"


class MessageForcePath(_TellingForcePath):
    """Internal wrench that each arm forms from the wrist wrenches of all, by messages: ExchangedWrench."""

    hears_all: ClassVar[bool] = True

    kind: Literal["messages"] = "messages"


class ConsensusForcePath(_TellingForcePath):
    """Internal wrench over any connected graph, by consensus on the mean of the wrenches: AveragedWrench.

    Attributes:
        input_gain: gamma, part of its own wrench that an arm's mean takes up in a tick.
        proportional_gain: k_P, on the disagreement with the arms that are heard.
        integral_gain: k_I, likewise.
    """

    kind: Literal["consensus"] = "consensus"
    input_gain: float = Field(default=0.2, gt=0.0, lt=2.0)
    proportional_gain: NotNegative = 0.25
    integral_gain: Positive = 0.2


class LearnedForcePath(_TellingForcePath):
    """Wrist wrench less the share of a load that the arms learn together: LearnedLoad.

    Attributes:
        payload_mass: Mean of the mass that is expected, kg.
        mass_deviation: Standard deviation of that mass, kg.
        force_deviation: Standard deviation of a wrist's force, N.
        consensus_gain: g of the consensus on what is learned.
    """

    tells_wrenches: ClassVar[bool] = False

    kind: Literal["learned-load"] = "learned-load"
    payload_mass: NotNegative = 0.0
    mass_deviation: Positive = 10.0
    force_deviation: Positive = 1.0
    consensus_gain: Positive = 0.25


_Paths = (
    NoForcePath | LateForcePath | LowPassForcePath | MessageForcePath | ConsensusForcePath | LearnedForcePath
)
ForcePath = Annotated[_Paths, Field(discriminator="kind")]


class SampledWrist(NamedTuple):
    """Timing of a wrist sensor, in ticks.

    Attributes:
        delay: Age of a sample when it arrives.
        every: Ticks from one sample to the next.
    """

    delay: int
    every: int


class SampledLoop(NamedTuple):
    """Feedback of measured wrenches, sampled.

    Attributes:
        pole: p of the filter.
        delay: D of force path and wrists together, ticks.
        every: Ticks from one sample to the next.
        lag: Time constant of the slowest drives, ticks.
        force_gain: K_f, by which a wrench acts at once.
        anchor_gain: g, by which it moves an integral.
    """

    pole: float
    delay: int
    every: int
    lag: float
    force_gain: float = 0.0
    anchor_gain: float = 0.0

    @property
    def anchor_bound(self) -> float:
        """The anchor gain at which the loop is unstable, with these other numbers."""
        return _anchor_bound(self._replace(anchor_gain=0.0))

    def is_stable(self, further: int = 0) -> bool:
        """Return whether the loop decays, with a further delay, ticks."""
        return force_loop_is_stable(self.anchor_gain, **self._replace(delay=self.delay + further).numbers())

    def numbers(self) -> dict[str, Any]:
        """Return everything but the anchor gain, by name."""
        return {name: value for name, value in self._asdict().items() if name != "anchor_gain"}


@functools.lru_cache(maxsize=256)
def _force_bound(pole: float, delay: int, lag: float) -> float:
    return force_gain_bound(pole, delay, lag=lag)


@functools.lru_cache(maxsize=256)
def _anchor_bound(loop: SampledLoop) -> float:
    return anchor_gain_bound(**loop.numbers())


def sampled_loop(path: ForcePath, wrists: Collection[SampledWrist], lag: float) -> SampledLoop:
    """Return the timing of the slowest feedback over a force path, or over the wrists alone without one."""
    slowest = max((wrist.delay for wrist in wrists), default=0)
    every = max((wrist.every for wrist in wrists), default=1)
    return SampledLoop(path.pole, path.delay + slowest, every, lag)


def force_gain_problems(
    path: ForcePath, wrists: Collection[SampledWrist], lag: float, largest: float
) -> list[FieldError]:
    """Return the problem of a force gain without measured force, or with unstable sampled feedback.

    Args:
        path: Force path.
        wrists: Wrist sensors that the arms have.
        lag: Largest time constant of the arms' drives, ticks.
        largest: Largest force gain of the arms.
    """
    allowed, detail = (
        largest == 0.0,
        "measures no force; set the gain to 0, or the kind to 'late' or 'low-pass'",
    )
    reason = f"but force_path.kind 'none' {detail}"
    if path.measures:
        # A sample that arrives before the next is taken is in time: the loop closes once for each sample.
        delay = max(((path.delay + w.delay) // w.every for w in wrists), default=path.delay)
        every = max((wrist.every for wrist in wrists), default=1)
        bound = min(_force_bound(path.pole, delay, each / every) for each in {0.0, lag})
        loop, allowed = f"{path.kind!r}{_late(delay, lag)}", largest < bound
        reason = f"but feedback over {loop} is unstable from {bound:g} on; lower it, {INSIST}"
    return [] if allowed else [FieldError(f"is {largest:g}, {reason}", "gains.force_gain")]


def anchor_gain_problems(path: ForcePath, loop: SampledLoop) -> list[FieldError]:
    """Return the problem of an anchor gain with which the sampled internal loop is unstable."""
    if loop.anchor_gain == 0.0:
        return []
    # Drives of different lags lie between those of none and of the largest.
    bound = min(loop._replace(lag=lag).anchor_bound for lag in {0.0, loop.lag})
    if loop.anchor_gain < bound:
        return []
    detail = (
        f"is {loop.anchor_gain:g}, but the anchored integral over {path.kind!r}{_late(loop.delay, loop.lag)}"
        f" with K_f = {loop.force_gain:g} is unstable from {bound:.4g} on; lower it, {INSIST}"
    )
    return [FieldError(detail, "gains.anchor_gain")]


def _late(delay: int, lag: float) -> str:
    late = f" with a delay of {delay}" if delay else ""
    return f"{late} and drives with a lag of {lag:.3g} ticks" if lag else late
