"""Free-flyer: pose of a rigid body that moves freely, as position and quaternion, and its increments.

An increment u = [r, w] is a twist in body axes that acts for one unit of time: X (+) u = X exp(u). Floats and
traced numbers are computed with alike.
"""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.tracing.elementary import polynomial

_TERMS = 6
"""Terms of the series of exp, which have the rounding of doubles up to turns of half a radian."""


def _series(first: int, base: float = 1.0) -> list[float]:
    """Return the coefficients of x^2 in sum_k (-base)^k x^2k / (2 k + first)!, the highest power first."""
    factorials = np.cumprod(np.arange(1.0, 2 * _TERMS + first + 1))
    return [(-base) ** k / factorials[2 * k + first - 1] for k in reversed(range(_TERMS))]


_HALF_SINE = [0.5 * each for each in _series(1, 0.25)]
"""sin(x / 2) / x, in x^2."""
_HALF_COSINE = [*(-0.25 * each for each in _series(2, 0.25)), 1.0]
"""cos(x / 2)."""
_ONE_LESS_COSINE = _series(2)
"""(1 - cos x) / x^2."""
_LESS_SINE = _series(3)
"""(x - sin x) / x^3."""


def rotation(quaternion: Array) -> Array:
    """Return the rotation matrix of a unit quaternion x, y, z, w, shape (3, 3)."""
    a, b, c, d = quaternion
    x, y, z = 2.0 * quaternion[:3]
    return np.stack(
        (
            np.stack((1.0 - b * y - c * z, a * y - d * z, a * z + d * y)),
            np.stack((a * y + d * z, 1.0 - a * x - c * z, b * z - d * x)),
            np.stack((a * z - d * y, b * z + d * x, 1.0 - a * x - b * y)),
        )
    )


def displaced(X: Array, u: Array) -> Array:
    """Return X (+) u.

    With x = |w|: the position moves by R (r + (1 - cos x) / x^2 w x r + (x - sin x) / x^3 w x (w x r)), and
    the quaternion is multiplied by [sin(x / 2) / x w, cos(x / 2)].

    Args:
        X: Position and quaternion x, y, z, w, shape (7,).
        u: Increment, m and rad, shape (6,).
    """
    r, w, (x, y, z, s) = u[:3], u[3:], X[3:]
    square = w @ w
    across = np.cross(w, r)
    moved = r + polynomial(square, _ONE_LESS_COSINE) * across
    moved = moved + polynomial(square, _LESS_SINE) * np.cross(w, across)
    (a, b, c), d = polynomial(square, _HALF_SINE) * w, polynomial(square, _HALF_COSINE)
    turned = np.stack(
        (
            s * a + x * d + y * c - z * b,
            s * b + y * d + z * a - x * c,
            s * c + z * d + x * b - y * a,
            s * d - x * a - y * b - z * c,
        )
    )
    return np.concatenate((X[:3] + rotation(X[3:]) @ moved, turned * (1.5 - 0.5 * (turned @ turned))))


def increment_rate(u: Array, V: Array) -> Array:
    """Return u' such that X (+) u(t) moves with twist V in body axes, shape (6,).

    It is dexp_u^-1 V = V + A V / 2 + A^2 V / 12 - A^4 V / 720 with A = ad_u, and a remainder of at most
    |u|^6 |V| / 30240.

    Args:
        u: Increment, shape (6,).
        V: Twist, m/s and rad/s, shape (6,).
    """
    first = _adjoint(u, V)
    second = _adjoint(u, first)
    fourth = _adjoint(u, _adjoint(u, second))
    return V + 0.5 * first + second / 12.0 - fourth / 720.0


def _adjoint(u: Array, V: Array) -> Array:
    """Return ad_u V = [w x v + r x w_V, w x w_V]."""
    return np.concatenate((np.cross(u[3:], V[:3]) + np.cross(u[:3], V[3:]), np.cross(u[3:], V[3:])))
