"""Transmission between drives and joints, with the friction of the arms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.model.cell_model import ArmPlace, SharedPlace
from coop_pin.model.joint_limits import per_joint
from coop_pin.model.pinocchio_model import model_key, shared_arm_model

_LINEAR = 1e-6
"""Below it tanh(x) / x is 1."""


class Friction(NamedTuple):
    """Coefficients of ``tau = -A^T (viscous w + level tanh(w / coulomb_velocity))`` with ``w = A v``.

    ``level = coulomb + excess exp(-(w / stribeck_velocity)^2)``

    Attributes:
        axes: A: the drive matrix for friction at the drives, the identity for friction at the joints, shape
            (k, k).
        viscous: viscous friction, N m s/rad, shape (k,).
        coulomb: Coulomb friction, N m, shape (k,).
        coulomb_velocity: width of the change of sign, rad/s.
        excess: stiction minus coulomb, N m, shape (k,).
        stribeck_velocity: velocity over which stiction decays, rad/s.
    """

    axes: Array
    viscous: Array
    coulomb: Array
    coulomb_velocity: float
    excess: Array
    stribeck_velocity: float

    def force(self, v: Array) -> Array:
        """Return the generalised force of friction at joint velocities, N m, shape (..., k) both."""
        w = v @ self.axes.T
        level = self.coulomb + self.excess * np.exp(-((w / self.stribeck_velocity) ** 2))
        return -(self.viscous * w + level * np.tanh(w / self.coulomb_velocity)) @ self.axes

    def damping(self, v: Array) -> Array:
        """Return D with ``force(v) = -D v`` at a joint velocity, N m s/rad, shape (k, k)."""
        w = self.axes @ v
        level = self.coulomb + self.excess * np.exp(-((w / self.stribeck_velocity) ** 2))
        x = w / self.coulomb_velocity
        steep = np.divide(np.tanh(x), x, out=np.ones_like(x), where=np.abs(x) > _LINEAR)
        return self.axes.T @ ((self.viscous + level / self.coulomb_velocity * steep)[:, None] * self.axes)


def friction(arm: Arm, name: str = "arm") -> Friction:
    """Return the friction of an arm: as described, or of the URDF's <dynamics>, which acts at the joints.

    Args:
        arm: Description of the arm.
        name: Name of the arm in the cell, for the path in error messages.

    Raises:
        FieldError: the number of coefficients differs from the number of joints.
    """
    model, options = shared_arm_model(model_key(arm)), arm.friction
    joints = int(model.nv)
    if isinstance(options, JointFriction):
        path = f"cell.arms.{name}.friction"
        viscous = per_joint(np.array(options.viscous), joints, f"{path}.viscous")
        coulomb = per_joint(np.array(options.coulomb), joints, f"{path}.coulomb")
        highest = options.coulomb if options.stiction is None else options.stiction
        excess = per_joint(np.array(highest), joints, f"{path}.stiction") - coulomb
        axes = arm.drive_matrix(joints)
    else:
        share, options = 1.0 if options == "urdf" else 0.0, JointFriction()
        viscous, coulomb, excess = share * model.damping, share * model.friction, np.zeros(joints)
        axes = np.eye(joints)
    return Friction(axes, viscous, coulomb, options.coulomb_velocity, excess, options.stribeck_velocity)


class Transmission:
    """Constant transmission of a cell, between drives and joint velocities, with its friction.

    ``v_drive = D v``, ``tau = D^T tau_drive``; D holds each arm's T at its place, then shared joints.
    """

    def __init__(
        self, cell: Cell, arms: Sequence[ArmPlace], nv: int, shared: Sequence[SharedPlace] = ()
    ) -> None:
        """Collect transmission matrices and friction.

        Raises:
            FieldError: a friction coefficient does not fit its arm.
        """
        edges = np.cumsum([0, *(len(arm.drive) for arm in arms)])
        drives = edges[-1] + len(shared)
        self._map, axes = np.zeros((drives, nv)), np.zeros((drives, nv))
        viscous, coulomb, excess, speeds, stribeck = np.zeros((5, drives))
        for arm, start, end in zip(arms, edges[:-1], edges[1:], strict=True):
            rows, resistance = slice(start, end), friction(cell.arms[arm.name], arm.name)
            self._map[rows, arm.v_slice], axes[rows, arm.v_slice] = arm.drive, resistance.axes
            viscous[rows], coulomb[rows], speeds[rows] = (
                resistance.viscous,
                resistance.coulomb,
                resistance.coulomb_velocity,
            )
            excess[rows], stribeck[rows] = resistance.excess, resistance.stribeck_velocity
        for row, slot in enumerate(shared, start=int(edges[-1])):
            self._map[row, slot.v_slice] = axes[row, slot.v_slice] = 1.0
            viscous[row], coulomb[row] = slot.resistance
            speeds[row], stribeck[row] = JointFriction().coulomb_velocity, JointFriction().stribeck_velocity
        self._viscous = -axes.T @ np.diag(viscous) @ axes
        self._to_scaled_speed = axes / speeds[:, None]
        self._to_stribeck_speed = axes / stribeck[:, None]
        self._coulomb, self._excess = -axes.T * coulomb, -axes.T * excess
        self._has_coulomb, self._has_stiction = bool((coulomb + excess).any()), bool(excess.any())

    def torque(self, drive_torques: Sequence[Array]) -> Array:
        """Return the generalised force of drive torques, N m, shape (nv,)."""
        return self._map.T.dot(np.concatenate(drive_torques))

    def friction(self, v: Array, out: Array | None = None) -> Array:
        """Return -A^T (viscous w + level tanh(w / coulomb_velocity)) with w = A v, N m, shape (nv,).

        The level is coulomb + excess exp(-(w / stribeck_velocity)^2), see JointFriction. A is D for friction
        at the drives; for friction of the URDF it picks the joint velocities. It is written to ``out``.
        """
        force: Array = self._viscous.dot(v, out)
        if not self._has_coulomb:
            return force
        direction = self._to_scaled_speed.dot(v)
        np.tanh(direction, direction)
        force += self._coulomb.dot(direction)
        if self._has_stiction:
            peak = np.exp(-(self._to_stribeck_speed.dot(v) ** 2))
            force += self._excess.dot(peak * direction)
        return force
