"""Grasps taken from how arms and payload stand."""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import ArrayLike

from coop_pin.arrays import as_array
from coop_pin.description.arm import Arm
from coop_pin.description.urdf import load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import ArmNotFoundError
from coop_pin.reference.checks import as_pose
from coop_pin.schema.pose import Pose
from coop_pin.spatial import inverse_pose


def grasps_from_configuration(
    arms: Mapping[str, Arm], joint_angles: Mapping[str, ArrayLike], payload_pose: Pose | ArrayLike
) -> dict[str, Pose]:
    """Return the grasps X_PE that hold where arms and payload stand now: X_PE = X_WP^-1 X_WB X_BE(q).

    Args:
        arms: by name.
        joint_angles: of every arm: one for each joint that is neither fixed nor locked, rad or m, in Pinocchio's order.
        payload_pose: X_WP, as a Pose or a matrix of shape (4, 4).

    Raises:
        ArmNotFoundError: an arm has no joint angles.
        ShapeError: there are not as many angles as joints.
        UrdfNotFoundError, UrdfError, FrameNotFoundError: an arm's URDF or tip.
    """
    X_WP = payload_pose.matrix if isinstance(payload_pose, Pose) else as_pose("payload_pose", payload_pose)
    grasps = {}
    for name, arm in arms.items():
        if name not in joint_angles:
            raise ArmNotFoundError("arm", name, joint_angles, "joint_angles")
        robot = Robot(load_checked(arm.file))
        moving = robot.unlocked(arm.locked)
        angles = as_array(f"joint_angles[{name!r}]", joint_angles[name], len(moving))
        X_BE = robot.pose(arm.tip, robot.locked(arm.locked) | dict(zip(moving, angles.tolist(), strict=True)))
        grasps[name] = Pose.from_matrix(inverse_pose(X_WP) @ arm.base.matrix @ X_BE)
    return grasps
