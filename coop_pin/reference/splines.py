"""One smooth path through timed poses."""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array, as_array
from coop_pin.errors import (
    AmbiguousTurnError,
    FileReadError,
    NotIncreasingError,
    OutOfRangeError,
    ShapeError,
    suggestion,
)
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, as_pose, as_times, keep, make_target


class TurningMotion(NamedTuple):
    """An orientation and how it changes, in world axes."""

    R: Array
    """Rotation matrix, shape (3, 3)."""

    omega: Array
    """Angular rate, rad/s, shape (3,)."""

    alpha: Array
    """Its derivative, rad/s^2, shape (3,)."""


def turning_motion(motion: Array) -> TurningMotion:
    """Return the rotation of q / |q| and its rates.

    With ``w = qdot q^-1 = (w_0, w_v)``: ``omega = 2 w_v``, ``alpha = 2 (vector part of qddot q^-1) - 4 w_0
    w_v``. The length of q drops out: scaling q adds only to the scalar part w_0.

    ``E a`` below is the vector part of the product a conj(q), ``G a`` that of conj(q) a; R = E G^T / |q|^2.

    Args:
        motion: rows q, qdot, qddot, each (x, y, z, w), shape (3, 4).
    """
    x, y, z, w = motion[0].tolist()
    square = x * x + y * y + z * z + w * w
    E = np.array(((w, -z, y, -x), (z, w, -x, -y), (-y, x, w, -z)))
    G = np.array(((w, z, -y, -x), (-z, w, x, -y), (y, -x, w, -z)))
    omega, alpha = motion[1:] @ E.T * (2.0 / square)
    w_0 = float(motion[0] @ motion[1]) / square
    return TurningMotion(E @ G.T / square, omega, alpha - 2.0 * w_0 * omega)


LARGEST_TURN = math.radians(175.0)
"""Between neighbours; beyond, the way round is not certain."""
SMALLEST_LENGTH = 0.2
"""Of the interpolated quaternion; below, the orientation swings wildly between its neighbours."""


@dataclass(frozen=True, eq=False)
class PoseSpline:
    """Quintic spline through positions and quaternions, at rest (rate and acceleration zero) at both ends.

    Positions and quaternions are seven coordinates of one spline with four continuous derivatives; the
    rotation is that of the quaternion scaled to length one, its angular rate and acceleration follow exactly.
    Before the first time and after the last the pose stands still, so that twist and acceleration are
    continuous everywhere.

    Attributes:
        times: s, strictly increasing, shape (n,), n >= 2.
        positions: m, shape (n, 3).
        quaternions: (x, y, z, w), either sign, any length but zero, shape (n, 4); kept with length one.

    Raises:
        ShapeError, OutOfRangeError: a field has another shape or holds a NaN.
        NotIncreasingError: times do not increase strictly.
        OutOfRangeError: a quaternion has no length.
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
        keep(
            self,
            _first=_resting(positions[0], quaternions[0]),
            _last=_resting(positions[-1], quaternions[-1]),
        )

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
        raise OutOfRangeError(f"length of quaternions[{int(lengths.argmin())}]", 0.0)
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


@dataclass(frozen=True, eq=False)
class Waypoints(PoseReference):
    """A smooth path through poses at their times, at rest before the first and after the last.

    The path does not stop at the poses between; see PoseSpline for how it is made. To stop at a pose, give it
    twice, or chain Line motions. Times that are spaced very unevenly make the path swing out between its
    poses.

    Attributes:
        times: s, strictly increasing, shape (n,), n >= 2.
        poses: X_WP_d at these times, shape (n, 4, 4).

    Raises:
        ShapeError, OutOfRangeError: a field has another shape or holds a NaN.
        NotAPoseError: one of the poses is not a pose.
        NotIncreasingError: times do not increase strictly.
        AmbiguousTurnError: neighbouring orientations are about half a turn apart.
    """

    times: Array
    poses: Array
    _spline: PoseSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the poses and fit the spline."""
        times = as_array("times", self.times, "n")
        poses = as_array("poses", self.poses, len(times), 4, 4)
        for index, pose in enumerate(poses):
            as_pose(f"poses[{index}]", pose)
        quaternions = np.reshape(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), (-1, 4))
        keep(self, times=times, poses=poses, _spline=PoseSpline(times, poses[:, :3, 3], quaternions))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        return self._spline.at(time)


POSITION = ("time", "x", "y", "z")
RPY = ("roll", "pitch", "yaw")
QUATERNION = ("qx", "qy", "qz", "qw")
LENGTH_ALLOWED = 1e-3
"""How far a quaternion in a file may be from length one."""


@dataclass(frozen=True, eq=False)
class Tabulated(PoseReference):
    """A smooth path through a table of poses, at rest before the first row and after the last.

    Attributes:
        times: s, strictly increasing, shape (n,), n >= 2.
        positions: m, shape (n, 3).
        quaternions: (x, y, z, w), shape (n, 4).

    Raises:
        the errors of PoseSpline, which also says how the path is made.
    """

    times: Array
    positions: Array
    quaternions: Array
    _spline: PoseSpline = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Fit the spline, and keep the table as the spline checked it."""
        spline = PoseSpline(self.times, self.positions, self.quaternions)
        keep(
            self,
            times=spline.times,
            positions=spline.positions,
            quaternions=spline.quaternions,
            _spline=spline,
        )

    @classmethod
    def from_csv(cls, path: str | Path) -> Tabulated:
        """Read a file of comma-separated values with a header.

        The columns, in any order and no others: time (s), x, y, z (m), and either roll, pitch, yaw (rad) or
        qx, qy, qz, qw. A motion that does not start and end at rest is brought from rest within its first
        interval and to rest within its last.

        Raises:
            FileReadError: the file cannot be read; it carries the line number where a line is to blame.
        """
        columns, lines, table = _read(str(path))
        column = dict(zip(columns, table.T, strict=True))
        if RPY[0] in column:
            quaternions = np.reshape(
                Rotation.from_euler("xyz", np.stack([column[name] for name in RPY], axis=1)).as_quat(),
                (-1, 4),
            )
        else:
            quaternions = np.stack([column[name] for name in QUATERNION], axis=1)
            _check_lengths(str(path), lines, quaternions)
        try:
            return cls(column["time"], np.stack([column[name] for name in POSITION[1:]], axis=1), quaternions)
        except (NotIncreasingError, AmbiguousTurnError) as error:
            raise FileReadError(str(error), str(path), lines[error.index]) from error

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        return self._spline.at(time)


def _read(path: str) -> tuple[tuple[str, ...], list[int], Array]:
    """Return the columns' names, the line number of each row, and the rows, shape (n, number of columns)."""
    lines: list[int] = []
    rows: list[list[float]] = []
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            columns = _header(path, next(reader, []))
            for cells in reader:
                if cells:
                    lines.append(reader.line_num)
                    rows.append(_numbers(path, reader.line_num, columns, cells))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileReadError(f"cannot be read as a table: {error}", path) from error
    if len(rows) < 2:
        raise FileReadError(f"has {len(rows)} rows of numbers; a motion needs at least 2", path)
    return columns, lines, np.array(rows)


def _header(path: str, cells: Sequence[str]) -> tuple[str, ...]:
    """Return the columns' names, checked."""
    columns = tuple(cell.strip() for cell in cells)
    rotation = QUATERNION if set(columns) & set(QUATERNION) else RPY
    wanted = POSITION + rotation
    missing = [name for name in wanted if name not in columns]
    if missing:
        detail = f"columns missing: {', '.join(missing)}; needed: {', '.join(POSITION)} and {', '.join(RPY)} or {', '.join(QUATERNION)}"
        raise FileReadError(detail, path, 1)
    for index, name in enumerate(columns):
        if name not in wanted:
            raise FileReadError(f"unknown column {name!r}; {suggestion(name, wanted)}", path, 1)
        if name in columns[:index]:
            raise FileReadError(f"column {name!r} stands there twice; keep one", path, 1)
    return columns


def _numbers(path: str, line: int, columns: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of one line, checked."""
    if len(cells) != len(columns):
        raise FileReadError(f"has {len(cells)} cells; the header has {len(columns)}", path, line)
    numbers = []
    for name, cell in zip(columns, cells, strict=True):
        try:
            number = float(cell)
        except ValueError:
            raise FileReadError(f"{name} is {cell!r}; it must be a number", path, line) from None
        if not math.isfinite(number):
            raise FileReadError(f"{name} is {number}; it must be a finite number", path, line)
        numbers.append(number)
    return numbers


def _check_lengths(path: str, lines: Sequence[int], quaternions: Array) -> None:
    """Refuse quaternions that are not of length one."""
    for line, length in zip(lines, np.linalg.norm(quaternions, axis=1), strict=True):
        if abs(length - 1.0) > LENGTH_ALLOWED:
            detail = f"the quaternion has length {length:.6g}; it must be 1 within {LENGTH_ALLOWED:g}"
            raise FileReadError(detail, path, line)
