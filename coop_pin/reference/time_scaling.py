"""The quintic from rest to rest: how every finite motion here starts and stops."""

from __future__ import annotations

from typing import NamedTuple


class Scaling(NamedTuple):
    """A scalar going from zero to one, with its derivatives by time."""

    value: float
    """s, between 0 and 1."""

    rate: float
    """Its first derivative, 1/s."""

    acceleration: float
    """Its second derivative, 1/s^2."""


BEFORE = Scaling(0.0, 0.0, 0.0)
AFTER = Scaling(1.0, 0.0, 0.0)


def rest_to_rest(time: float, start_time: float, duration: float) -> Scaling:
    """Return s = 10 u^3 - 15 u^4 + 6 u^5 and its two derivatives, u = (time - start_time) / duration.

    Zero before, one after; rate and acceleration vanish at both ends, so that s is twice continuously differentiable.

    Args:
        time: s.
        start_time: s.
        duration: s, positive.
    """
    u = (time - start_time) / duration
    if u <= 0.0:
        return BEFORE
    if u >= 1.0:
        return AFTER
    w = 1.0 - u
    value = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return Scaling(value, 30.0 * u * u * w * w / duration, 60.0 * u * w * (w - u) / (duration * duration))


def rest_to_rest_integral(time: float, start_time: float, duration: float) -> float:
    """Return the integral of s by time from start_time on: T (5/2 u^4 - 3 u^5 + u^6), and T/2 + (time - start_time - T) after T.

    Args:
        time: s.
        start_time: s.
        duration: T, s, positive.
    """
    u = (time - start_time) / duration
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return duration * (u - 0.5)
    return duration * u**4 * (2.5 + u * (u - 3.0))
