"""What an arm's URDF allows its joints, and its drives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm
from coop_pin.errors import FieldShapeError
from coop_pin.model.arm_alone import arm_alone
from coop_pin.model.joint_angles import JointAngles


class JointLimits(NamedTuple):
    """Limits of an arm, infinite where there are none.

    Attributes:
        lower: joint angles, rad or m, shape (k,).
        upper: likewise.
        velocity: joint rates, rad/s or m/s, shape (k,).
        torque: drive torques at which the actuation saturates, N m, shape (k,).
    """

    lower: Array
    upper: Array
    velocity: Array
    torque: Array


def joint_limits(arm: Arm, name: str = "arm") -> JointLimits:
    """Return the limits of an arm.

    A velocity or effort of zero is taken for "not stated", as many files mean it: no limit. Efforts of the URDF are drive
    torques only where the drives turn the joints one by one; with a drive matrix they set no limit.

    Args:
        arm: the description.
        name: the arm, for messages.

    Raises:
        FieldShapeError: the torque limits do not fit the arm.
    """
    model = arm_alone(arm)
    angles = JointAngles(model)
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    bounded = ~angles.continuous
    entries = angles.entry[bounded]
    lower[bounded], upper[bounded] = model.lowerPositionLimit[entries], model.upperPositionLimit[entries]
    return JointLimits(lower, upper, _stated(model.upperVelocityLimit), _torque_limits(arm, model, name))


def _stated(limits: Array) -> Array:
    return np.where(limits > 0.0, limits, np.inf)


def _torque_limits(arm: Arm, model: pin.Model, name: str) -> Array:
    nothing = np.full(model.nv, np.inf)
    if arm.torque_limits == "none":
        return nothing
    if arm.torque_limits == "urdf":
        one_by_one = np.array_equal(arm.drive_matrix(model.nv), np.eye(model.nv))
        return _stated(model.upperEffortLimit) if one_by_one else nothing
    return per_joint(np.array(arm.torque_limits, dtype=float), model.nv, f"cell.arms.{name}.torque_limits")


def per_joint(values: Array, joints: int, path: str) -> Array:
    """Return one value for each joint; a single one stands for all.

    Raises:
        FieldShapeError: there are more or fewer values than joints.
    """
    if values.ndim and values.shape != (joints,):
        raise FieldShapeError(f"has {len(values)} entries; the arm has {joints} joints", path)
    return np.full(joints, values) if values.ndim == 0 else values
