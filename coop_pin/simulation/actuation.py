"""Actuation: from commanded drive torques to generalised forces (limits, transmission, friction)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask, frozen
from coop_pin.control.interface import CellCommand
from coop_pin.description.arm import Arm, JointFriction
from coop_pin.description.cell import Cell
from coop_pin.errors import DivergedError, ShapeError
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits, per_joint
from coop_pin.model.pinocchio_model import load_arm_model


class Friction(NamedTuple):
    """Coefficients of ``tau = -A^T (viscous w + coulomb tanh(w / coulomb_velocity))`` with ``w = A v``.

    Attributes:
        axes: A: the drive matrix for friction at the drives, the identity for friction at the joints, shape
            (k, k).
        viscous: N m s/rad, shape (k,).
        coulomb: N m, shape (k,).
        coulomb_velocity: rad/s.
    """

    axes: Array
    viscous: Array
    coulomb: Array
    coulomb_velocity: float


def friction(arm: Arm, name: str = "arm") -> Friction:
    """Return the friction of an arm: as described, or of the URDF's <dynamics>, which acts at the joints.

    Args:
        arm: the description.
        name: its name in the cell, for the path in error messages.

    Raises:
        FieldError: the number of coefficients differs from the number of joints.
    """
    model, chosen = load_arm_model(arm), arm.friction
    joints = int(model.nv)
    if isinstance(chosen, JointFriction):
        path = f"cell.arms.{name}.friction"
        viscous = per_joint(np.array(chosen.viscous), joints, f"{path}.viscous")
        coulomb = per_joint(np.array(chosen.coulomb), joints, f"{path}.coulomb")
        return Friction(arm.drive_matrix(joints), viscous, coulomb, chosen.coulomb_velocity)
    share = 1.0 if chosen == "urdf" else 0.0
    return Friction(
        np.eye(joints), share * model.damping, share * model.friction, JointFriction().coulomb_velocity
    )


_TORQUE_LIMIT = 1e7
"""A larger command counts as diverged, N m."""


class Applied(NamedTuple):
    """Torques of one tick, for each arm, N m, shape (k,).

    Attributes:
        commanded: by the controller.
        torques: after the torque limits.
        saturated: which of them were cut at their limits; read-only.
        force: the generalised force of the torques, N m, shape (nv,).
    """

    commanded: list[Array]
    torques: list[Array]
    saturated: list[Mask]
    force: Array


class Transmission:
    """Constant transmission of a cell, between drives and joint velocities, with its friction.

    ``v_drive = D v``, ``tau = D^T tau_drive``; D holds each arm's T at its place.
    """

    def __init__(self, cell: Cell, arms: Sequence[ArmPlace], nv: int) -> None:
        """Collect transmission matrices and friction.

        Raises:
            FieldError: a friction coefficient does not fit its arm.
        """
        edges = np.cumsum([0, *(len(arm.drive) for arm in arms)])
        drives = edges[-1]
        self._map, axes = np.zeros((drives, nv)), np.zeros((drives, nv))
        viscous, coulomb, speeds = np.zeros((3, drives))
        for arm, start, end in zip(arms, edges[:-1], edges[1:], strict=True):
            rows, found = slice(start, end), friction(cell.arms[arm.name], arm.name)
            self._map[rows, arm.v_slice], axes[rows, arm.v_slice] = arm.drive, found.axes
            viscous[rows], coulomb[rows], speeds[rows] = found.viscous, found.coulomb, found.coulomb_velocity
        self._viscous = -axes.T @ np.diag(viscous) @ axes
        self._to_scaled_speed = axes / speeds[:, None]
        self._coulomb = -axes.T * coulomb
        self._has_coulomb = bool(coulomb.any())

    def torque(self, drive_torques: Sequence[Array]) -> Array:
        """Return the generalised force of drive torques, N m, shape (nv,)."""
        return self._map.T.dot(np.concatenate(drive_torques))

    def friction(self, v: Array) -> Array:
        """Return -A^T (viscous w + coulomb tanh(w / coulomb_velocity)) with w = A v, N m, shape (nv,).

        A is D for friction at the drives; for friction of the URDF it picks the joint velocities.
        """
        viscous: Array = self._viscous.dot(v)
        if not self._has_coulomb:
            return viscous
        return viscous + self._coulomb.dot(np.tanh(self._to_scaled_speed.dot(v)))


class Actuation:
    """Actuators of all arms: check a command, cut it at the torque limits, map it to generalised forces."""

    def __init__(self, cell: Cell, limits: Sequence[JointLimits], transmission: Transmission) -> None:
        """Take over the torque limits.

        Args:
            cell: for the arms' names.
            limits: of each arm, in the order of the arms.
            transmission: of the cell.
        """
        self._limits = {name: limit.torque for name, limit in zip(cell.arms, limits, strict=True)}
        self._transmission = transmission

    def apply(self, time: float, command: CellCommand) -> Applied:
        """Return what the actuators make of a command.

        Args:
            time: of the tick, s, for the message.
            command: the controller's output.

        Raises:
            ShapeError: not one torque for each drive of each arm.
            DivergedError: a torque is not finite, or beyond 1e7 N m.
        """
        commanded = self.commanded(command)
        torques, saturated = [], []
        for (name, limit), torque in zip(self._limits.items(), commanded, strict=True):
            largest = float(np.abs(torque).max())
            if not largest < _TORQUE_LIMIT:  # also catches NaN
                raise DivergedError(time, f"torque of arm {name!r}, N m,", largest, _TORQUE_LIMIT)
            torques.append(np.minimum(np.maximum(torque, -limit), limit))
            saturated.append(frozen(torques[-1] != torque))
        return Applied(commanded, torques, saturated, self._transmission.torque(torques))

    def commanded(self, command: CellCommand) -> list[Array]:
        """Return the torques of a command as arrays.

        Raises:
            ShapeError: not one torque for each drive of each arm.
        """
        torques = [np.asarray(torque, dtype=np.float64) for torque in command.torques]
        if len(torques) != len(self._limits):
            raise ShapeError(
                "the list of torques, one entry for each arm,", (len(torques),), (len(self._limits),)
            )
        for (name, limit), torque in zip(self._limits.items(), torques, strict=True):
            if torque.shape != limit.shape:
                raise ShapeError(f"torque of arm {name!r}", torque.shape, limit.shape)
        return torques
