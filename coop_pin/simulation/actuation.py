"""What the motors make of commanded torques: they saturate at their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.description.cell import Cell
from coop_pin.errors import ShapeError
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.friction import friction
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
            raise ShapeError(
                "the list of torques, one entry for each arm,", (len(arrays),), (len(self._names),)
            )
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


class Transmission:
    """Maps between the drives of a cell and the velocities of its tree.

    ``v_drive = D v``, ``tau = D^T tau_drive``; D holds each arm's T at its place.
    """

    def __init__(self, cell: Cell, arms: Sequence[ArmPlace], nv: int) -> None:
        """Collect drive matrices and friction.

        Raises:
            FieldError: a friction coefficient does not fit its arm.
        """
        sizes = [len(arm.drive) for arm in arms]
        self._slices = [slice(sum(sizes[:i]), sum(sizes[: i + 1])) for i in range(len(sizes))]
        self._map, axes = np.zeros((sum(sizes), nv)), np.zeros((sum(sizes), nv))
        viscous, coulomb, speeds = (np.zeros(sum(sizes)) for _ in range(3))
        for arm, rows in zip(arms, self._slices, strict=True):
            found = friction(cell.arms[arm.name], arm.name)
            self._map[rows, arm.v], axes[rows, arm.v] = arm.drive, found.axes
            viscous[rows], coulomb[rows], speeds[rows] = found.viscous, found.coulomb, found.coulomb_velocity
        self._viscous = -axes.T @ np.diag(viscous) @ axes
        self._to_scaled_speed = axes / speeds[:, None]
        self._coulomb = -axes.T * coulomb
        self._has_coulomb = bool(coulomb.any())

    def velocities(self, v: Array) -> list[Array]:
        """Return each arm's drive velocities, rad/s."""
        speeds = self._map @ v
        return [speeds[rows] for rows in self._slices]

    def torque(self, drive_torques: Sequence[Array]) -> Array:
        """Return the generalised force of drive torques, N m, shape (nv,)."""
        return self._map.T.dot(np.concatenate(drive_torques))

    def friction(self, v: Array) -> Array:
        """Return -A^T (viscous w + coulomb tanh(w / coulomb_velocity)) with w = A v, N m, shape (nv,).

        A is D for friction at the drives; for friction of the URDF it picks the joints' rates.
        """
        viscous: Array = self._viscous.dot(v)
        return (
            viscous + self._coulomb.dot(np.tanh(self._to_scaled_speed.dot(v)))
            if self._has_coulomb
            else viscous
        )
