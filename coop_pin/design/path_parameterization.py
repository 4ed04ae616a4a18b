"""Time-optimal parameterization of a path under limits that are affine in s'' and s'^2 (TOPP-RA)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.memory import require_memory

_PER_WIDTH = 8
"""Times within the width of a moving average, at least."""
_TIME = 32768.0
"""Memory of a time, whose neighbourhood is looked at in four places, bytes."""
_FLAT = 1e-12
"""A coefficient of u below this part of a row's largest is none."""


class PathLimits(NamedTuple):
    """Limits ``a u + b x + c <= 0`` at n places of a path, with u = s'' and x = s'^2.

    Attributes:
        places: s, increasing, shape (n,).
        a: coefficients of u, shape (n, r).
        b: coefficients of x, shape (n, r).
        c: the rest, negative at rest, shape (n, r).
    """

    places: Array
    a: Array
    b: Array
    c: Array

    def largest(self, u: Array, x: Array) -> Array:
        """Return the largest a u + b x + c at every place, shape (n,); u and x of shape (n,)."""
        return np.asarray((self.a * u[:, None] + self.b * x[:, None] + self.c).max(axis=1))


def fastest(limits: PathLimits) -> Array:
    """Return x = s'^2 of the fastest motion from rest to rest at every place, shape (n,).

    Pham and Pham (2018), "A new approach to time-optimal path parameterization based on reachability
    analysis". u is constant between two places, x_{i+1} = x_i + 2 (s_{i+1} - s_i) u_i, and the limits hold at
    both. Backwards, the x from which the end can be reached at rest are an interval at every place::

        K_n = {0}
        K_i = {x >= 0: some u keeps the limits at s_i and s_{i+1}, and x + 2 Delta u is in K_{i+1}}

    and forwards the largest such u is taken.

    Args:
        limits: Limits, which hold at rest; at every place some bound x.

    Raises:
        InfeasibleMotionError: cause "torque": they do not hold at rest; cause "limits": x is not bounded.
    """
    steps = np.diff(limits.places)
    if (resting := float(limits.c.max())) > 0.0:
        s = limits.places[int(limits.c.max(axis=1).argmax())]
        detail = f"at s = {s:.3g} of the path a limit is exceeded at rest by {resting:.3g} of it"
        raise InfeasibleMotionError("torque", f"{detail}; carry less, squeeze less, or take another path")
    rows = [_rows(limits, i, 2.0 * step) for i, step in enumerate(steps)]
    lower, upper = np.zeros((2, len(limits.places)))
    for i in reversed(range(len(steps))):
        a, b, c = rows[i]
        reach = 2.0 * steps[i] * np.array([1.0, -1.0])
        ends = np.array([-upper[i + 1], lower[i + 1]])
        lower[i], upper[i] = _projected(
            np.concatenate((a, reach, [0.0])),
            np.concatenate((b, [1.0, -1.0, -1.0])),
            np.concatenate((c, ends, [0.0])),
        )
        if not np.isfinite(upper[i]):
            detail = f"nothing limits the speed at s = {limits.places[i]:.3g} of the path"
            raise InfeasibleMotionError("limits", f"{detail}; state torque_limits of the arms")
    x = np.zeros(len(limits.places))
    for i, (a, b, c) in enumerate(rows):
        rising = a > _FLAT
        u = float(((-c - b * x[i])[rising] / a[rising]).min(initial=np.inf))
        x[i + 1] = min(max(x[i] + 2.0 * steps[i] * u, lower[i + 1]), upper[i + 1])
    return x


def _rows(limits: PathLimits, i: int, step: float) -> tuple[Array, Array, Array]:
    """Return the limits of u_i and x_i at s_i and s_{i+1}, scaled to a largest entry of one."""
    _, a, b, c = limits
    rows = np.stack(
        [
            np.concatenate((a[i], a[i + 1] + step * b[i + 1])),
            np.concatenate((b[i], b[i + 1])),
            np.concatenate((c[i], c[i + 1])),
        ]
    )
    rows = rows / np.maximum(np.abs(rows).max(axis=0), 1e-300)
    return rows[0], rows[1], rows[2]


def _projected(a: Array, b: Array, c: Array) -> tuple[float, float]:
    """Return the interval of x with some u for which a u + b x + c <= 0, by elimination of u."""
    up, down, flat = a > _FLAT, a < -_FLAT, np.abs(a) <= _FLAT
    p, q = (a[up, None], b[up, None], c[up, None]), (-a[down], b[down], c[down])
    B = np.concatenate(((p[0] * q[1] + q[0] * p[1]).ravel(), b[flat]))
    C = np.concatenate(((p[0] * q[2] + q[0] * p[2]).ravel(), c[flat]))
    upper = float((-C[B > _FLAT] / B[B > _FLAT]).min(initial=np.inf))
    lower = float((-C[B < -_FLAT] / B[B < -_FLAT]).max(initial=0.0))
    upper = max(upper, 0.0)
    return min(lower, upper), upper  # an interval that is empty by rounding is a point


def times_of(places: Array, x: Array) -> Array:
    """Return the time at every place, s: u is constant between two, shape (n,)."""
    v = np.sqrt(x)
    return np.concatenate(([0.0], np.cumsum(2.0 * np.diff(places) / (v[1:] + v[:-1]))))


def smoothed(places: Array, x: Array, width: float, least: int) -> tuple[Array, Array]:
    """Return times, s, and fractions of a motion with constant u between places, averaged over a time.

    Args:
        places: s, shape (n,).
        x: s'^2 at each, 1/s^2, shape (n,).
        width: Time of the moving average, s.
        least: Number of times, at least; there are eight within the width.
    """
    ends, v, u = times_of(places, x), np.sqrt(x), np.diff(x) / (2.0 * np.diff(places))
    spans = np.diff(ends)
    areas = places[:-1] * spans + v[:-1] * spans**2 / 2.0 + u * spans**3 / 6.0
    before = np.concatenate(([0.0], np.cumsum(areas)))

    def integral(t: Array) -> Array:
        i = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(u) - 1)
        h = np.clip(t, 0.0, ends[-1]) - ends[i]
        whole = before[i] + places[i] * h + v[i] * h**2 / 2.0 + u[i] * h**3 / 6.0
        return np.asarray(whole + np.maximum(t - ends[-1], 0.0))

    count = max(float(least), _PER_WIDTH * (float(ends[-1]) / width + 1.0) + 1.0)
    require_memory(f"{count:.3g} times of a moving average", _TIME * count, "take a wider one")
    times = np.linspace(0.0, ends[-1] + width, int(count))
    fractions = (integral(times) - integral(times - width)) / width
    fractions[0], fractions[-1] = 0.0, 1.0
    return times, fractions
