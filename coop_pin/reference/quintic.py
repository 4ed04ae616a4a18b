"""Quintic time scaling s(t) from rest to rest, and its integral."""

from __future__ import annotations

from typing import NamedTuple


class TimeScaling(NamedTuple):
    """A scalar s that rises from 0 to 1, and its derivatives by time.

    Attributes:
        value: s.
        rate: 1/s.
        acceleration: 1/s^2.
    """

    value: float
    rate: float
    acceleration: float


_BEFORE = TimeScaling(0.0, 0.0, 0.0)
_AFTER = TimeScaling(1.0, 0.0, 0.0)


def quintic(time: float, start_time: float, duration: float) -> TimeScaling:
    """Return s = 10 u^3 - 15 u^4 + 6 u^5 and its two derivatives, u = (time - start_time) / duration.

    Zero before, one after; rate and acceleration vanish at both ends, so that s is twice continuously
    differentiable.

    Args:
        time: s.
        start_time: s.
        duration: s, positive.
    """
    u = (time - start_time) / duration
    if u <= 0.0:
        return _BEFORE
    if u >= 1.0:
        return _AFTER
    w = 1.0 - u
    value = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return TimeScaling(value, 30.0 * u * u * w * w / duration, 60.0 * u * w * (w - u) / (duration * duration))


def quintic_integral(time: float, start_time: float, duration: float) -> float:
    """Return the integral of s: T (5/2 u^4 - 3 u^5 + u^6) with T = duration, and T (u - 1/2) after T."""
    u = (time - start_time) / duration
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return duration * (u - 0.5)
    return duration * u**4 * (2.5 + u * (u - 3.0))
