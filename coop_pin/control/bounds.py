"""Sampled force feedback over a force path: its timing, and the bounds of K_f and g."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from coop_pin.base.arrays import Array, typed
from coop_pin.base.errors import FieldError, OutOfRangeError
from coop_pin.control.force_paths.averaged_wrench import ConsensusForcePath
from coop_pin.control.force_paths.exchanged_wrench import MessageForcePath
from coop_pin.control.force_paths.force_path import INSIST, LateForcePath, LowPassForcePath, NoForcePath
from coop_pin.control.force_paths.learned_load import LearnedForcePath

_Paths = (
    NoForcePath | LateForcePath | LowPassForcePath | MessageForcePath | ConsensusForcePath | LearnedForcePath
)
ForcePath = Annotated[_Paths, Field(discriminator="kind")]

_BISECTIONS = 50


class SampledWrist(NamedTuple):
    """Timing of a wrist sensor, in ticks.

    Attributes:
        delay: Age of a sample when it arrives.
        every: Ticks from one sample to the next.
    """

    delay: int
    every: int


class CellTiming(NamedTuple):
    """Arms of a cell, and the timing of its wrists and drives, against which a law is checked.

    Attributes:
        arms: Names of the arms.
        rows: Number k_0 of task rows.
        period: T, s.
        wrists: Wrist sensors that the arms have.
        lag: Largest time constant of the arms' drives, ticks.
    """

    arms: Sequence[str]
    rows: int
    period: float = np.nan
    wrists: Collection[SampledWrist] = ()
    lag: float = 0.0


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

    pole: float = 0.0
    delay: int = 0
    every: int = 1
    lag: float = 0.0
    force_gain: float = 0.0
    anchor_gain: float = 0.0

    @property
    def anchor_bound(self) -> float:
        """The anchor gain at which the loop is unstable, with these other numbers."""
        pole, delay, every, lag, force_gain, _ = self
        return anchor_gain_bound(pole=pole, delay=delay, every=every, force_gain=force_gain, lag=lag)

    def is_stable(self, further: int = 0) -> bool:
        """Return whether the loop decays, with a further delay, ticks.

        The eigenvalues are those of one period of the sensor. The state is [f[k-1], ..., f[k-1-D], f_m, Z]
        before tick k. Without an anchor Z rests, and its eigenvalue 1 does not count.
        """
        delay, r = self.delay + further, lag_pole(self.lag)
        filtered, integral, unit = delay + 1, delay + 2, np.eye(delay + 3)
        sample: Array = np.eye(delay + 3)
        sample[filtered] = (1.0 - self.pole) * unit[delay] + self.pole * unit[filtered]
        sample[integral] -= self.anchor_gain * sample[filtered]
        shift: Array = np.eye(delay + 3)
        shift[1 : delay + 1] = unit[:delay]
        shift[0] = r * unit[0]
        shift[0] += (1.0 - r) * (unit[integral] - self.force_gain * unit[filtered])
        period = np.linalg.matrix_power(shift, self.every) @ sample
        if self.anchor_gain == 0.0:
            period = period[:integral, :integral]
        return bool(np.abs(np.linalg.eigvals(period)).max() < 1.0)


@typed
@cache
def force_gain_bound(pole: float, delay: int = 0, *, lag: float = 0.0) -> float:
    """Return the force gain K_f at which sampled internal-force feedback goes unstable.

    In a rigid chain f is an algebraic function of the torque: f[k] = c - K_f ftilde_m[k] while the torque of
    tick k acts; drives with a lag add the pole r = exp(-1 / lag). Through the filter f_m[k+1] = p f_m[k] +
    (1 - p) f[k-D] the error obeys z^D (z - p)(z - r) + K_f (1 - p)(1 - r) z = 0. Its first roots reach the
    unit circle at z = exp(j a) with D a + arg(z - p) + arg(z - r) - a = pi, where K_f =
    ``|z - p| |z - r| / ((1 - p)(1 - r))``. Without delay and lag that is (1 + p) / (1 - p); without filter
    and lag it is 1, whatever the delay.

    Args:
        pole: p of the filter, in [0, 1); p = 0 is the wrench of one tick before.
        delay: D, further samples.
        lag: time constant of the drives, samples.

    Raises:
        OutOfRangeError: the pole is not, or the lag is negative or not finite.
        WrongTypeError: a value is no number.
    """
    if not 0.0 <= pole < 1.0:
        raise OutOfRangeError("pole", pole, "at least 0 and less than 1")
    low, high, r = 0.0, np.pi, lag_pole(lag)
    for _ in range(_BISECTIONS):  # without delay to high = pi
        angle = (low + high) / 2.0
        z = np.exp(1j * angle)
        beyond = (delay - 1) * angle + np.angle(z - pole) + np.angle(z - r) > np.pi
        low, high = (low, angle) if beyond else (angle, high)
    z = np.exp(1j * high)
    return float(abs(z - pole) * abs(z - r) / ((1.0 - pole) * (1.0 - r)))


def lag_pole(lag: float) -> float:
    """Return exp(-1 / lag), the pole of drives with a lag, samples; 0 for drives without."""
    if not 0.0 <= lag < np.inf:
        raise OutOfRangeError("lag", lag, "at least 0 and finite")
    return float(np.exp(-1.0 / lag)) if lag else 0.0


@typed
@cache
def anchor_gain_bound(
    *, pole: float = 0.0, delay: int = 0, every: int = 1, force_gain: float = 0.0, lag: float = 0.0
) -> float:
    """Return the anchor gain g at which the anchored integral of the payload-space law goes unstable.

    In a rigid chain the internal error is ftilde[k] = Z[k] - K_f ftilde_m[k] + const while the torque of tick
    k acts, and the anchor is Z[k] = Z[k-1] - g ftilde_m[k] at each new measurement. The bound is the smallest
    g at which an eigenvalue of this linear map over one period of the sensor leaves the unit circle, found
    by bisection. In closed form, for K_f = 0 and drives without lag:

    - a filter alone: 2 (1 + p) / (1 - p);
    - a delay alone: 2 sin(pi / (4 D + 2));
    - both, for a sensor at the control rate: a root of z^D (z - 1)(z - p) + g (1 - p) z on the unit circle.

    Args:
        pole: p of the filter f_m <- p f_m + (1 - p) f, in [0, 1); it advances with the sensor's samples.
        delay: D, ticks by which the measurement is older than f(t_k^-), the one just before tick k.
        every: ticks from one sample of the sensor to the next.
        force_gain: K_f; from its own bound on, the result is 0.
        lag: time constant of the drives, the same for all, ticks; at the end of a tick the internal error is
            r ftilde[k-1] + (1 - r)(Z[k] - K_f ftilde_m[k]) + const with r = exp(-1 / lag).

    Raises:
        OutOfRangeError: the pole is not in [0, 1), the delay or the lag is negative, or ``every`` is less
            than 1.
        WrongTypeError: a value is no number.
    """
    if delay < 0 or every < 1:
        name, value, least = ("delay", delay, 0) if delay < 0 else ("every", every, 1)
        raise OutOfRangeError(name, value, f"at least {least}")
    # Of filter and lag alone; delay and K_f lower it, a slow sensor does not raise it.
    low, high = 0.0, 2.0 * force_gain_bound(pole, lag=lag)
    loop = SampledLoop(pole, delay, every, lag, force_gain)
    if not loop.is_stable():
        return 0.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2.0
        if loop._replace(anchor_gain=middle).is_stable():
            low = middle
        else:
            high = middle
    return low


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
        bound = min(force_gain_bound(path.pole, delay, lag=each / every) for each in {0.0, lag})
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
