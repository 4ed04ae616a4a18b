"""Quintic splines through timed poses, given in a scenario (waypoints) or in a CSV table."""

from __future__ import annotations

import math
from bisect import bisect_right
from functools import cached_property
from typing import Literal, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import AmbiguousTurnError, ArgumentError, FieldError, OutOfRangeError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import quaternions
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, make_target

_LARGEST_TURN = math.radians(175.0)
"""Largest turn between neighbours; beyond, its direction is not certain."""
_SMALLEST_LENGTH = 0.2
"""Smallest length of the interpolated quaternion; below, the orientation swings wildly between neighbours."""


_SHORTEST = 1e-9
"""Shortest time between two poses, s."""
_SPACE = "space the times more evenly, between a nanosecond and a year"


class PoseSpline(NamedTuple):
    """Quintic spline through positions and quaternions, at rest (rate and acceleration zero) at both ends.

    Positions and quaternions are seven coordinates of one spline with four continuous derivatives; the
    rotation is that of the quaternion scaled to length one. Before the first time and after the last the pose
    stands still, so that twist and acceleration are continuous everywhere.

    Attributes:
        knots: times t_i, s.
        coefficients: coefficients of powers 0 to 5 of (t - t_i) on each segment, shape (n - 1, 6, 7).
        first: target before the first time.
        last: target after the last.
    """

    knots: tuple[float, ...]
    coefficients: Array
    first: PoseTarget
    last: PoseTarget

    @classmethod
    def through(cls, times: Array, positions: Array, quaternions: Array, stops: bool = False) -> Self:
        """Return the spline through poses.

        Args:
            times: s, strictly increasing, shape (n,), n >= 2.
            positions: m, shape (n, 3).
            quaternions: (x, y, z, w), either sign, any length but zero, shape (n, 4).
            stops: Whether it rests at every pose.

        Raises:
            OutOfRangeError: the times do not increase strictly; ``index`` is that of the first such time.
            AmbiguousTurnError: neighbouring orientations are too far apart.
        """
        backward = np.flatnonzero(~(np.diff(times) >= _SHORTEST))
        if backward.size:
            index = int(backward[0]) + 1
            allowed = f"a nanosecond after {times[index - 1]:.6g}: times increase strictly; sort them"
            raise OutOfRangeError("times", float(times[index]), allowed, (index,))
        unit = _same_sign(quaternions)
        through = _stopping_coefficients if stops else quintic_coefficients
        coefficients = through(times, np.hstack((positions, unit)))
        _check_length(times, coefficients, unit)
        first, last = _resting(positions[0], unit[0]), _resting(positions[-1], unit[-1])
        return cls(tuple(times.tolist()), coefficients, first, last)

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        if time <= self.knots[0]:
            return self.first
        if time >= self.knots[-1]:
            return self.last
        segment = bisect_right(self.knots, time) - 1
        motion = powers(time - self.knots[segment]) @ self.coefficients[segment]
        R, omega, alpha = _rotation_of(motion[:, 3:])
        return make_target(R, motion[0, :3], motion[1, :3], omega, motion[2, :3], alpha)


def _rotation_of(motion: Array) -> tuple[Array, Array, Array]:
    """Return rotation matrix, angular velocity (rad/s) and acceleration (rad/s^2) of q / |q|, in world axes.

    With ``w = qdot q^-1 = (w_0, w_v)``: ``omega = 2 w_v``, ``alpha = 2 (vector part of qddot q^-1) - 4 w_0
    w_v``. The length of q drops out: scaling q adds only to the scalar part w_0. ``E a`` below is the vector
    part of the product a conj(q), ``G a`` that of conj(q) a; R = E G^T / |q|^2.

    Args:
        motion: rows q, qdot, qddot, each (x, y, z, w), shape (3, 4).
    """
    x, y, z, w = motion[0].tolist()
    square = x * x + y * y + z * z + w * w
    E = np.array(((w, -z, y, -x), (z, w, -x, -y), (-y, x, w, -z)))
    G = np.array(((w, z, -y, -x), (-z, w, x, -y), (y, -x, w, -z)))
    omega, alpha = motion[1:] @ E.T * (2.0 / square)
    w_0 = float(motion[0] @ motion[1]) / square
    return E @ G.T / square, omega, alpha - 2.0 * w_0 * omega


def powers(u: float) -> Array:
    """Return the powers 0 to 5 of u, their first and their second derivatives, shape (3, 6)."""
    u2, u3 = u * u, u * u * u
    return np.array(
        (
            (1.0, u, u2, u3, u2 * u2, u2 * u3),
            (0.0, 1.0, 2.0 * u, 3.0 * u2, 4.0 * u3, 5.0 * u2 * u2),
            (0.0, 0.0, 2.0, 6.0 * u, 12.0 * u2, 20.0 * u3),
        )
    )


def _same_sign(quaternions: Array) -> Array:
    """Return the quaternions with length one, each with the sign nearer to its predecessor, shape (n, 4)."""
    unit: Array = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    for index in range(1, len(unit)):
        cosine = float(unit[index] @ unit[index - 1])
        angle = 2.0 * math.acos(min(abs(cosine), 1.0))
        if angle > _LARGEST_TURN:
            raise AmbiguousTurnError(f"orientation {index - 1}", f"orientation {index}", index, angle)
        if cosine < 0.0:
            unit[index] = -unit[index]
    return unit


def quintic_coefficients(times: Array, points: Array) -> Array:
    """Return the coefficients of powers 0 to 5 of (t - times[i]) on each segment, shape (n - 1, 6, 7)."""
    still = np.zeros(points.shape[1])
    at_rest = [(1, still), (2, still)]
    try:
        from scipy.interpolate import make_interp_spline  # slow to load

        spline = make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ArgumentError(f"no spline leads through the poses: {error}; {_SPACE}") from None
    coefficients = np.stack([spline(times[:-1], nu) / math.factorial(nu) for nu in range(6)], axis=1)
    if not np.isfinite(coefficients).all():
        raise ArgumentError(f"no spline leads through the poses: it would not be finite; {_SPACE}")
    return coefficients


def _stopping_coefficients(times: Array, points: Array) -> Array:
    """Return the coefficients of the quintics from rest to rest, as of ``quintic_coefficients``."""
    powers = np.array((0.0, 0.0, 0.0, 10.0, -15.0, 6.0)) / np.diff(times)[:, None] ** np.arange(6)
    coefficients: Array = powers[..., None] * np.diff(points, axis=0)[:, None]
    coefficients[:, 0] = points[:-1]
    return coefficients


def _check_length(times: Array, coefficients: Array, quaternions: Array) -> None:
    """Refuse a spline whose quaternion nearly vanishes between two knots."""
    powers = (np.diff(times)[:, None] * np.linspace(0.0, 1.0, 17))[..., None] ** np.arange(6)
    shortest = np.linalg.norm(powers @ coefficients[..., 3:], axis=-1).min(axis=-1)
    segment = int(shortest.argmin())
    if shortest[segment] < _SMALLEST_LENGTH:
        cosine = float(quaternions[segment] @ quaternions[segment + 1])
        angle = 2.0 * math.acos(min(cosine, 1.0))
        raise AmbiguousTurnError(f"orientation {segment}", f"orientation {segment + 1}", segment + 1, angle)


def _resting(position: Array, quaternion: Array) -> PoseTarget:
    """Return the target that stands still at a pose."""
    return make_target(_rotation_of(np.vstack((quaternion, np.zeros((2, 4)))))[0], position)


class Waypoint(Pose):
    """Pose at a time.

    Attributes:
        time: s.
    """

    time: float


class WaypointsMotion(PoseReference):
    """Spline through poses at their times, at rest before the first and after the last.

    To stop at a pose between, give it twice. Times that are spaced very unevenly make the path swing out.

    Attributes:
        points: two or more, their times increasing.
        stops: whether it rests at every point: straight lines by quintics, which do not swing out.
    """

    kind: Literal["waypoints"] = "waypoints"
    points: tuple[Waypoint, ...]
    stops: bool = False

    @model_validator(mode="after")
    def _one_path(self) -> Self:
        if len(self.points) < 2:
            raise FieldError(f"has {len(self.points)} entries; a path needs at least 2", "points")
        try:
            _ = self._spline
        except OutOfRangeError as error:
            raise FieldError(f"does not increase: {error}", f"points.{error.index[0]}.time") from None
        except AmbiguousTurnError as error:
            raise FieldError(f"is ambiguous: {error}", f"points.{error.index[0]}.rpy") from None
        return self

    @cached_property
    def _spline(self) -> PoseSpline:
        poses = np.stack([point.matrix for point in self.points])
        times = np.array([point.time for point in self.points])
        return PoseSpline.through(times, poses[:, :3, 3], quaternions(poses[:, :3, :3]), self.stops)

    @property
    def span(self) -> tuple[float, float]:
        """Times of the first and of the last point, s."""
        return self.points[0].time, self.points[-1].time

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        return self._spline.at(time)
