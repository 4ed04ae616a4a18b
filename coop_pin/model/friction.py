"""Viscous and Coulomb friction of an arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm, JointFriction
from coop_pin.model.joint_limits import per_joint
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
