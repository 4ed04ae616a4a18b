"""Payload motion read from a CSV table of joint angles, through the kinematics of the arms of a cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Self

import numpy as np
from pydantic import PrivateAttr

from coop_pin.base.arrays import Array
from coop_pin.base.errors import (
    AmbiguousTurnError,
    ArgumentError,
    ArmsDisagreeError,
    FileReadError,
    OutOfRangeError,
)
from coop_pin.base.schema.base import Positive
from coop_pin.base.spatial import log3, quaternions
from coop_pin.reference.csv_table import read_table
from coop_pin.reference.pose_reference import ForwardKinematics, PoseReference, PoseTarget
from coop_pin.reference.splines import PoseSpline


class JointMotion(PoseReference):
    """Payload motion of a recorded or planned joint-space trajectory, a CSV table of the arms' joint angles.

    The columns, in any order and no others: ``time`` (s), and ``ARM/JOINT`` (rad, of prismatic joints m) for
    every moving joint of one or more arms of the cell. Each row becomes the payload pose by the forward
    kinematics of every arm in the table, without ``calibration_error``; the motion is the quintic spline
    through their means, from rest to rest. It is no motion of joints: a law tracks the payload pose, and the
    posture of the arms selects the branch in which they start.

    A row per 10 to 50 ms is dense enough; between rows the pose is interpolated, not the joint angles. A
    scenario gives the motion the kinematics of its cell; ``on(cell)`` does so elsewhere.

    Attributes:
        path: a file with a header. In a scenario's file it is relative to that file.
        allowed: largest distance between the payload poses of two arms, m, and angle, rad.
    """

    kind: Literal["joints"] = "joints"
    path: str
    allowed: Positive = 1e-3

    _spline: PoseSpline | None = PrivateAttr(None)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the table, s; raises as ``at``."""
        knots = self._path.knots
        return float(knots[0]), float(knots[-1])

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s.

        Raises:
            ArgumentError: the motion has no kinematics, which ``on(cell)`` gives it.
        """
        return self._path.at(time)

    @property
    def _path(self) -> PoseSpline:
        if self._spline is None:
            raise ArgumentError("the motion is a table of joint angles; motion.on(cell) has poses")
        return self._spline

    def on(self, cell: ForwardKinematics) -> Self:
        """Return the motion of the payload of a cell; the table is read again.

        Args:
            cell: cell whose arms the table names.

        Raises:
            FileReadError: the file cannot be read, or has other columns; it carries the line of the mistake.
            ArmsDisagreeError: two arms hold the payload at different poses.
        """
        joints = cell.arm_joints()
        columns, lines, table = read_table(self.path, lambda header: _known(header, joints))
        column = dict(zip(columns, table.T, strict=True))
        poses = {
            arm: cell.payload_poses(arm, np.stack([column[f"{arm}/{name}"] for name in names], axis=1))
            for arm, names in joints.items()
            if f"{arm}/{names[0]}" in column
        }
        self._require_agreement(poses, column["time"], lines)
        each = np.array(list(poses.values()))
        quaternion = quaternions(each[0, :, :3, :3])
        around = np.array([quaternions(X[:, :3, :3]) for X in each])
        around *= np.copysign(1.0, np.sum(around * quaternion, axis=-1, keepdims=True))
        mean = around.mean(axis=0)
        try:
            spline = PoseSpline.through(column["time"], each[..., :3, 3].mean(axis=0), mean)
        except (OutOfRangeError, AmbiguousTurnError) as error:
            raise FileReadError(str(error), self.path, lines[error.index[0]]) from error
        motion = self.replace()
        motion._spline = spline
        return motion

    def _require_agreement(self, poses: Mapping[str, Array], times: Array, lines: Sequence[int]) -> None:
        """Refuse rows in which an arm holds the payload elsewhere than the first one."""
        (first, X), *others = poses.items()
        for arm, X_arm in others:
            distance = np.linalg.norm(X_arm[:, :3, 3] - X[:, :3, 3], axis=1)
            angle = np.linalg.norm(log3(X_arm[:, :3, :3] @ X[:, :3, :3].swapaxes(1, 2)), axis=1)
            worst = int(np.argmax(np.maximum(distance, angle)))
            if max(distance[worst], angle[worst]) > self.allowed:
                numbers = float(times[worst]), float(distance[worst]), float(angle[worst])
                raise ArmsDisagreeError(first, arm, *numbers, self.allowed, self.path, lines[worst])


def _known(header: Sequence[str], joints: Mapping[str, Sequence[str]]) -> Sequence[str]:
    """Return the columns of the arms of which the header names a joint; of all arms if of none."""
    named = {column.partition("/")[0] for column in header} & {*joints}
    return ("time", *(f"{arm}/{name}" for arm in joints if arm in (named or joints) for name in joints[arm]))
