"""A cell as a user says it: arms, one payload, where each arm grips it, and how the load is shared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationInfo, field_validator

from coop_pin.arrays import Array, as_array
from coop_pin.description.arm import Arm
from coop_pin.description.payload import Payload
from coop_pin.description.urdf import load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import ArmNotFoundError, FieldError, LoadShareError
from coop_pin.schema.base import Description, Vector3, check_arm_names
from coop_pin.schema.pose import Pose
from coop_pin.spatial import as_pose, inverse_pose
from coop_pin.spatial.task_rows import RowsName, TaskRows, task_rows


def grasps_from_configuration(
    arms: Mapping[str, Arm], joint_angles: Mapping[str, ArrayLike], payload_pose: Pose | ArrayLike
) -> dict[str, Pose]:
    """Return the grasps X_PE that hold where arms and payload stand now: X_PE = X_WP^-1 X_WB X_BE(q).

    Args:
        arms: by name.
        joint_angles: of every arm: one for each joint that is neither fixed nor locked, rad or m, in
            Pinocchio's order.
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


class Cell(Description):
    """Arms that rigidly hold one payload; a single one is an ordinary arm with a load.

    Attributes:
        arms: the arms by name; their order is the order of arrays.
        payload: the held object.
        payload_pose: pose X_WP at which the arms, in their postures, grip the payload as they stand; for
            "as-posed" grasps only.
        grasps: for each arm the pose X_PE of its tip in the payload frame; "as-posed" takes them from
            ``payload_pose`` and the postures, once: the cell then holds the poses themselves.
        rows: the task rows: "full" (6), "planar" (x, y and the turn about z, for arms that move in the
            world's x-y plane) or "positional" (x, y, z).
        gravity: m/s^2, in world axes.
        load_shares: c_i, the share of the load that each arm carries, summing to one; equal when omitted.
    """

    arms: dict[str, Arm] = Field(min_length=1)
    payload: Payload
    payload_pose: Pose | None = None
    grasps: dict[str, Pose]
    rows: RowsName = "full"
    gravity: Vector3 = (0.0, 0.0, -9.81)
    load_shares: dict[str, float] | None = None

    @field_validator("arms")
    @classmethod
    def _named(cls, arms: dict[str, Arm]) -> dict[str, Arm]:
        for name in arms:
            if "/" in name or "." in name or name in ("", "payload"):
                raise FieldError(f"arm name {name!r} must not be empty or 'payload', nor hold '/' or '.'")
        return arms

    @field_validator("grasps", mode="before")
    @classmethod
    def _as_posed(cls, grasps: Any, earlier: ValidationInfo) -> Any:
        if not isinstance(grasps, str):
            return grasps
        if grasps != "as-posed":
            raise FieldError(f'is {grasps!r}; it must be a table of poses by arm, or "as-posed"')
        arms, pose = earlier.data.get("arms"), earlier.data.get("payload_pose")
        if arms is None:
            return {}
        unposed = [name for name, arm in arms.items() if arm.posture is None]
        if pose is None or unposed:
            missing = "payload_pose is" if pose is None else f"the postures of {unposed} are"
            raise FieldError(f'is "as-posed", but {missing} missing; they say where the arms grip')
        return grasps_from_configuration(arms, {name: arm.posture for name, arm in arms.items()}, pose)

    @field_validator("grasps")
    @classmethod
    def _one_grasp_each(cls, grasps: dict[str, Pose], earlier: ValidationInfo) -> dict[str, Pose]:
        check_arm_names(grasps, earlier.data.get("arms"))
        return grasps

    @field_validator("load_shares")
    @classmethod
    def _shares_sum_to_one(
        cls, shares: dict[str, float] | None, earlier: ValidationInfo
    ) -> dict[str, float] | None:
        if shares is None:
            return None
        check_arm_names(shares, earlier.data.get("arms"), LoadShareError)
        total = sum(shares.values())
        if abs(total - 1.0) > 1e-9:
            raise LoadShareError(
                f"{shares} sum to {total:.9g}; load shares must sum to 1 (eq. (11) of the paper)"
            )
        return shares

    @property
    def task_rows(self) -> TaskRows:
        """The k_0 rows the cell works on."""
        return task_rows(self.rows)

    @property
    def shares(self) -> Array:
        """Load shares c_i in the order of the arms, shape (m,)."""
        if self.load_shares is None:
            return np.full(len(self.arms), 1.0 / len(self.arms))
        return np.array([self.load_shares[name] for name in self.arms])
