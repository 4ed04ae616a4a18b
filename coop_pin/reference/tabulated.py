"""A motion read from a table in a file."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.errors import AmbiguousTurnError, NotIncreasingError, ReferenceFileError, suggestion
from coop_pin.reference.checks import keep
from coop_pin.reference.splines import PoseSpline
from coop_pin.reference.target import PoseReference, PoseTarget

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
        keep(self, times=spline.times, positions=spline.positions, quaternions=spline.quaternions, _spline=spline)

    @classmethod
    def from_csv(cls, path: str | Path) -> Tabulated:
        """Read a file of comma-separated values with a header.

        The columns, in any order and no others: time (s), x, y, z (m), and either roll, pitch, yaw (rad) or qx, qy, qz, qw.
        A motion that does not start and end at rest is brought from rest within its first interval and to rest within its last.

        Raises:
            ReferenceFileError: the file cannot be read; it carries the line number where a line is to blame.
        """
        columns, lines, table = _read(str(path))
        column = dict(zip(columns, table.T, strict=True))
        if RPY[0] in column:
            quaternions = np.reshape(Rotation.from_euler("xyz", np.stack([column[name] for name in RPY], axis=1)).as_quat(), (-1, 4))
        else:
            quaternions = np.stack([column[name] for name in QUATERNION], axis=1)
            _check_lengths(str(path), lines, quaternions)
        try:
            return cls(column["time"], np.stack([column[name] for name in POSITION[1:]], axis=1), quaternions)
        except (NotIncreasingError, AmbiguousTurnError) as error:
            raise ReferenceFileError(str(path), lines[error.index], str(error)) from error

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
        raise ReferenceFileError(path, 0, f"cannot be read as a table: {error}") from error
    if len(rows) < 2:
        raise ReferenceFileError(path, 0, f"has {len(rows)} rows of numbers; a motion needs at least 2")
    return columns, lines, np.array(rows)


def _header(path: str, cells: Sequence[str]) -> tuple[str, ...]:
    """Return the columns' names, checked."""
    columns = tuple(cell.strip() for cell in cells)
    rotation = QUATERNION if set(columns) & set(QUATERNION) else RPY
    wanted = POSITION + rotation
    missing = [name for name in wanted if name not in columns]
    if missing:
        detail = f"columns missing: {', '.join(missing)}; needed: {', '.join(POSITION)} and {', '.join(RPY)} or {', '.join(QUATERNION)}"
        raise ReferenceFileError(path, 1, detail)
    for index, name in enumerate(columns):
        if name not in wanted:
            raise ReferenceFileError(path, 1, f"unknown column {name!r}; {suggestion(name, wanted)}")
        if name in columns[:index]:
            raise ReferenceFileError(path, 1, f"column {name!r} stands there twice; keep one")
    return columns


def _numbers(path: str, line: int, columns: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of one line, checked."""
    if len(cells) != len(columns):
        raise ReferenceFileError(path, line, f"has {len(cells)} cells; the header has {len(columns)}")
    numbers = []
    for name, cell in zip(columns, cells, strict=True):
        try:
            number = float(cell)
        except ValueError:
            raise ReferenceFileError(path, line, f"{name} is {cell!r}; it must be a number") from None
        if not math.isfinite(number):
            raise ReferenceFileError(path, line, f"{name} is {number}; it must be a finite number")
        numbers.append(number)
    return numbers


def _check_lengths(path: str, lines: Sequence[int], quaternions: Array) -> None:
    """Refuse quaternions that are not of length one."""
    for line, length in zip(lines, np.linalg.norm(quaternions, axis=1), strict=True):
        if abs(length - 1.0) > LENGTH_ALLOWED:
            detail = f"the quaternion has length {length:.6g}; it must be 1 within {LENGTH_ALLOWED:g}"
            raise ReferenceFileError(path, line, detail)
