"""The drives of all arms: torques and friction act in drive coordinates and reach the joints through T^T."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.friction import friction


class Drives:
    """Maps between the drives of a cell and the velocities of its tree.

    ``v_drive = D v``, ``tau = D^T tau_drive``; D holds each arm's T at its place.
    """

    def __init__(self, cell: Cell, arms: Sequence[ArmPlace], nv: int) -> None:
        """Collect drive matrices and friction.

        Raises:
            FieldShapeError: a friction coefficient does not fit its arm.
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
        return viscous + self._coulomb.dot(np.tanh(self._to_scaled_speed.dot(v))) if self._has_coulomb else viscous
