"""One smooth path through timed poses."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import make_interp_spline

from coop_pin.arrays import Array, as_array
from coop_pin.errors import AmbiguousTurnError, NotPositiveError, ShapeError
from coop_pin.reference.checks import as_times, keep
from coop_pin.reference.quaternion_motion import turning_motion
from coop_pin.reference.target import PoseTarget, make_target

LARGEST_TURN = math.radians(175.0)
"""Between neighbours; beyond, the way round is not certain."""
SMALLEST_LENGTH = 0.2
"""Of the interpolated quaternion; below, the orientation swings wildly between its neighbours."""


@dataclass(frozen=True, eq=False)
class PoseSpline:
    """Quintic spline through positions and quaternions, at rest (rate and acceleration zero) at both ends.

    Positions and quaternions are seven coordinates of one spline with four continuous derivatives; the rotation is that of
    the quaternion scaled to length one, its angular rate and acceleration follow exactly. Before the first time and after
    the last the pose stands still, so that twist and acceleration are continuous everywhere.

    Attributes:
        times: s, strictly increasing, shape (n,), n >= 2.
        positions: m, shape (n, 3).
        quaternions: (x, y, z, w), either sign, any length but zero, shape (n, 4); kept with length one.

    Raises:
        ShapeError, NotFiniteError: a field has another shape or holds a NaN.
        NotIncreasingError: times do not increase strictly.
        NotPositiveError: a quaternion has no length.
        AmbiguousTurnError: neighbouring orientations are too far apart.
    """

    times: Array
    positions: Array
    quaternions: Array
    _knots: tuple[float, ...] = field(init=False, repr=False)
    _coefficients: Array = field(init=False, repr=False)
    _first: PoseTarget = field(init=False, repr=False)
    _last: PoseTarget = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and fit the spline."""
        times = as_times("times", self.times)
        if len(times) < 2:
            raise ShapeError("times", times.shape, ("2 or more",))
        positions = as_array("positions", self.positions, len(times), 3)
        quaternions = _same_sign(as_array("quaternions", self.quaternions, len(times), 4))
        coefficients = _quintic_coefficients(times, np.hstack((positions, quaternions)))
        _check_length(times, coefficients, quaternions)
        keep(self, times=times, positions=positions, quaternions=quaternions)
        keep(self, _knots=tuple(times.tolist()), _coefficients=coefficients)
        keep(self, _first=_resting(positions[0], quaternions[0]), _last=_resting(positions[-1], quaternions[-1]))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        if time <= self._knots[0]:
            return self._first
        if time >= self._knots[-1]:
            return self._last
        segment = bisect_right(self._knots, time) - 1
        motion = _powers(time - self._knots[segment]) @ self._coefficients[segment]
        R, omega, alpha = turning_motion(motion[:, 3:])
        return make_target(R, motion[0, :3], motion[1, :3], omega, motion[2, :3], alpha)


def _powers(u: float) -> Array:
    """Return the powers 0 to 5 of u, their first and their second derivatives, shape (3, 6)."""
    u2 = u * u
    u3 = u2 * u
    return np.array(
        (
            (1.0, u, u2, u3, u2 * u2, u2 * u3),
            (0.0, 1.0, 2.0 * u, 3.0 * u2, 4.0 * u3, 5.0 * u2 * u2),
            (0.0, 0.0, 2.0, 6.0 * u, 12.0 * u2, 20.0 * u3),
        )
    )


def _same_sign(quaternions: Array) -> Array:
    """Return the quaternions with length one, each with the sign nearer to the one before it, shape (n, 4)."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    if not lengths.all():
        raise NotPositiveError(f"length of quaternions[{int(lengths.argmin())}]", 0.0)
    unit: Array = quaternions / lengths
    for index in range(1, len(unit)):
        cosine = float(unit[index] @ unit[index - 1])
        angle = 2.0 * math.acos(min(abs(cosine), 1.0))
        if angle > LARGEST_TURN:
            raise AmbiguousTurnError(f"orientation {index - 1}", f"orientation {index}", index, angle)
        if cosine < 0.0:
            unit[index] = -unit[index]
    return unit


def _quintic_coefficients(times: Array, points: Array) -> Array:
    """Return the coefficients of powers 0 to 5 of (t - times[i]) on each segment, shape (n - 1, 6, 7).

    Args:
        times: the knots, shape (n,).
        points: shape (n, 7).
    """
    still = np.zeros(points.shape[1])
    at_rest = [(1, still), (2, still)]
    spline = make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))
    derivatives = [spline(times[:-1], nu) / math.factorial(nu) for nu in range(6)]
    return np.stack(derivatives, axis=1)


def _check_length(times: Array, coefficients: Array, quaternions: Array) -> None:
    """Refuse a spline whose quaternion nearly vanishes somewhere between its knots."""
    fractions = np.linspace(0.0, 1.0, 17)
    powers = (np.diff(times)[:, None] * fractions)[..., None] ** np.arange(6)
    shortest = np.linalg.norm(powers @ coefficients[..., 3:], axis=-1).min(axis=-1)
    segment = int(shortest.argmin())
    if shortest[segment] < SMALLEST_LENGTH:
        cosine = float(quaternions[segment] @ quaternions[segment + 1])
        angle = 2.0 * math.acos(min(cosine, 1.0))
        raise AmbiguousTurnError(f"orientation {segment}", f"orientation {segment + 1}", segment + 1, angle)


def _resting(position: Array, quaternion: Array) -> PoseTarget:
    """Return the target that stands still at a pose."""
    still = np.zeros((3, 4))
    still[0] = quaternion
    return make_target(turning_motion(still).R, position)
