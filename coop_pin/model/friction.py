"""The friction of an arm: where it acts and how strongly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm, JointFriction
from coop_pin.model.arm_model import load_arm_model
from coop_pin.model.joint_limits import per_joint


class Friction(NamedTuple):
    """``tau = -A^T (viscous w + coulomb tanh(w / coulomb_velocity))`` with ``w = A v``.

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
    """Return the friction of an arm: as described, or the URDF's <dynamics>, which acts at the joints.

    Args:
        arm: the description.
        name: the arm, for messages.

    Raises:
        FieldError: a coefficient does not fit the arm.
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
