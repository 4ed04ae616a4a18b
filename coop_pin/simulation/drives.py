"""The drives of all arms: torques and friction act in drive coordinates and reach the joints through T^T."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.errors import FieldShapeError
from coop_pin.model.cell_model import ArmPlace


class Drives:
    """Maps between the drives of a cell and the velocities of its tree.

    ``v_drive = D v``, ``tau = D^T tau_drive``; D holds each arm's T at its place.
    """

    def __init__(self, cell: Cell, arms: Sequence[ArmPlace], nv: int) -> None:
        """Collect drive matrices and friction.

        Raises:
            FieldShapeError: a friction or drive does not fit its arm.
        """
        sizes = [arm.v.stop - arm.v.start for arm in arms]
        self._slices = [slice(sum(sizes[:i]), sum(sizes[: i + 1])) for i in range(len(sizes))]
        self._map = np.zeros((sum(sizes), nv))
        viscous, coulomb, speeds = (np.zeros(sum(sizes)) for _ in range(3))
        for arm, rows in zip(arms, self._slices, strict=True):
            friction = cell.arms[arm.name].friction
            self._map[rows, arm.v] = _fitting(arm.drive, rows, f"cell.arms.{arm.name}.drive", square=True)
            viscous[rows] = _fitting(np.array(friction.viscous), rows, f"cell.arms.{arm.name}.friction.viscous")
            coulomb[rows] = _fitting(np.array(friction.coulomb), rows, f"cell.arms.{arm.name}.friction.coulomb")
            speeds[rows] = friction.coulomb_velocity
        self._viscous = -self._map.T @ np.diag(viscous) @ self._map
        self._to_scaled_speed = self._map / speeds[:, None]
        self._coulomb = -self._map.T * coulomb
        self._has_coulomb = bool(coulomb.any())

    def velocities(self, v: Array) -> list[Array]:
        """Return each arm's drive velocities, rad/s."""
        speeds = self._map @ v
        return [speeds[rows] for rows in self._slices]

    def torque(self, drive_torques: Sequence[Array]) -> Array:
        """Return the generalised force of drive torques, N m, shape (nv,)."""
        return self._map.T.dot(np.concatenate(drive_torques))

    def friction(self, v: Array) -> Array:
        """Return -D^T (viscous w + coulomb tanh(w / coulomb_velocity)) with w = D v, N m, shape (nv,)."""
        viscous: Array = self._viscous.dot(v)
        return viscous + self._coulomb.dot(np.tanh(self._to_scaled_speed.dot(v))) if self._has_coulomb else viscous


def _fitting(values: Array, rows: slice, path: str, square: bool = False) -> Array:
    size = rows.stop - rows.start
    if values.ndim and values.shape != ((size, size) if square else (size,)):
        raise FieldShapeError(f"has shape {values.shape}; the arm has {size} joints", path)
    return values
