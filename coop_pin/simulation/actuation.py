"""What the motors make of commanded torques: they saturate at their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.description.cell import Cell
from coop_pin.errors import ShapeError
from coop_pin.model.joint_limits import JointLimits


class Applied(NamedTuple):
    """Drive torques as applied.

    Attributes:
        torques: of each arm, N m, shape (k,).
        saturated: which of them were cut, shape (k,) for each arm; read-only.
    """

    torques: list[Array]
    saturated: list[Mask]


class Actuation:
    """The motors of all arms.

    Attributes:
        idle: for each arm that nothing is saturated, shape (k,); read-only.
    """

    def __init__(self, cell: Cell, limits: Sequence[JointLimits]) -> None:
        """Take over the torque limits.

        Args:
            cell: for the arms' names.
            limits: of each arm, in the order of the arms.
        """
        self._names = tuple(cell.arms)
        self._limits = [limit.torque for limit in limits]
        self._limited = [bool(np.isfinite(limit).any()) for limit in self._limits]
        self.idle = [frozen(np.zeros(len(limit), dtype=bool)) for limit in self._limits]

    def commands(self, torques: Sequence[ArrayLike]) -> list[Array]:
        """Return what a controller answered as arrays.

        Raises:
            ShapeError: not one torque for each drive of each arm.
        """
        arrays = [np.asarray(torque, dtype=np.float64) for torque in torques]
        if len(arrays) != len(self._names):
            raise ShapeError("the list of torques, one entry for each arm,", (len(arrays),), (len(self._names),))
        for name, torque, limit in zip(self._names, arrays, self._limits, strict=True):
            if torque.shape != limit.shape:
                raise ShapeError(f"torque of arm {name!r}", torque.shape, limit.shape)
        return arrays

    def apply(self, torques: Sequence[Array]) -> Applied:
        """Return the torques cut at their limits, and where they were."""
        applied, saturated = list(torques), list(self.idle)
        for index, torque in enumerate(torques):
            if self._limited[index]:
                limit = self._limits[index]
                applied[index] = np.minimum(np.maximum(torque, -limit), limit)
                saturated[index] = frozen(applied[index] != torque)
        return Applied(applied, saturated)
