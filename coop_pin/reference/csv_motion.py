"""Payload motion read from a CSV table of poses."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Literal

import numpy as np

from coop_pin.base.errors import AmbiguousTurnError, FileReadError, OutOfRangeError
from coop_pin.reference.csv_table import read_table
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
        columns, lines, table = read_table(self.path, _known)
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


def _known(columns: Sequence[str]) -> Sequence[str]:
    """Return the columns of a table of poses whose header is stated."""
    return _POSITION + (_QUATERNION if {*columns} & {*_QUATERNION} else _RPY)
