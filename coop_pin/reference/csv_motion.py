"""Payload motion read from a CSV table of poses."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import AmbiguousTurnError, FileReadError, OutOfRangeError, suggestion
from coop_pin.base.user_files import read_user_file
from coop_pin.reference.pose_reference import PoseReference, PoseTarget
from coop_pin.reference.splines import PoseSpline


class CsvMotion(PoseReference):
    """Spline through the poses of a CSV table, at rest before its first row and after its last.

    The columns, in any order and no others: time (s), x, y, z (m), and either roll, pitch, yaw (rad) or qx,
    qy, qz, qw. The spline goes from rest within the first interval and to rest within the last. The table is
    read at the first use, so that a scenario can be read on a machine without the file; ``replace()`` returns
    a motion that reads it again.

    Attributes:
        path: a file with a header. In a scenario's file it is relative to that file.
    """

    kind: Literal["csv"] = "csv"
    path: str

    @cached_property
    def _spline(self) -> PoseSpline:
        columns, lines, table = _read(self.path)
        column = dict(zip(columns, table.T, strict=True))
        if _RPY[0] in column:
            from scipy.spatial.transform import Rotation  # slow to load

            turns = Rotation.from_euler("xyz", np.stack([column[name] for name in _RPY], axis=1))
            quaternions = np.reshape(turns.as_quat(), (-1, 4))
        else:
            quaternions = np.stack([column[name] for name in _QUATERNION], axis=1)
            for line, length in zip(lines, np.linalg.norm(quaternions, axis=1), strict=True):
                if abs(length - 1.0) > _ALLOWED:
                    detail = f"the quaternion has length {length:.6g}; it must be 1 within {_ALLOWED:g}"
                    raise FileReadError(detail, self.path, line)
        positions = np.stack([column[name] for name in _POSITION[1:]], axis=1)
        try:
            return PoseSpline.through(column["time"], positions, quaternions)
        except (OutOfRangeError, AmbiguousTurnError) as error:
            raise FileReadError(str(error), self.path, lines[error.index[0]]) from error

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the table, s; raises as ``at``."""
        return float(self._spline.knots[0]), float(self._spline.knots[-1])

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s.

        Raises:
            FileReadError: the file cannot be read; it carries the line number of a wrong line.
        """
        return self._spline.at(time)


_POSITION = ("time", "x", "y", "z")
_RPY = ("roll", "pitch", "yaw")
_QUATERNION = ("qx", "qy", "qz", "qw")
_ALLOWED = 1e-3
"""Largest deviation of a quaternion in a file from length one."""
_MAX_BYTES = 50_000_000
"""Half a million rows."""


def _read(path: str) -> tuple[tuple[str, ...], list[int], Array]:
    """Return the columns' names, the line number of each row, and the rows, shape (n, number of columns)."""
    try:
        text = read_user_file(path, limit=_MAX_BYTES, kind="a table").decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""))
        columns = _header(path, next(reader, []))
        cells = [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileReadError(f"cannot be read as a table: {error}", path) from error
    if len(cells) < 2:
        raise FileReadError(f"has {len(cells)} rows of numbers; a motion needs at least 2", path)
    numbers = np.array([_numbers(path, line, columns, row) for line, row in cells])
    return columns, [line for line, _ in cells], numbers


def _header(path: str, cells: Sequence[str]) -> tuple[str, ...]:
    """Return the columns' names, checked."""
    columns = tuple(cell.strip() for cell in cells)
    known = _POSITION + (_QUATERNION if set(columns) & set(_QUATERNION) else _RPY)
    if missing := ", ".join(name for name in known if name not in columns):
        needed = f"{', '.join(_POSITION)} and {', '.join(_RPY)} or {', '.join(_QUATERNION)}"
        raise FileReadError(f"columns missing: {missing}; needed: {needed}", path, 1)
    for index, name in enumerate(columns):
        if name not in known:
            raise FileReadError(f"unknown column {name!r}; {suggestion(name, known)}", path, 1)
        if name in columns[:index]:
            raise FileReadError(f"column {name!r} is given twice; keep one", path, 1)
    return columns


def _numbers(path: str, line: int, columns: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of one line, checked."""
    if len(cells) != len(columns):
        raise FileReadError(f"has {len(cells)} cells; the header has {len(columns)}", path, line)
    return [_number(path, line, *cell) for cell in zip(columns, cells, strict=True)]


def _number(path: str, line: int, name: str, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise FileReadError(f"{name} is {cell!r}; it must be a finite number", path, line)
    return number
