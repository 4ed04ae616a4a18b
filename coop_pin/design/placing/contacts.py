"""Contacts of arms around a payload, and the shoulders of the arms of one robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.payload import Payload
from coop_pin.model.joint_limits import JointLimits

_INSET = 0.8
"""Grasps from above, from the payload's centre (0) to its edge (1)."""
_FAN = np.pi / 3.0
"""Angle between neighbouring bases that stand side by side, rad."""
_HANDS = 0.15
"""Width of a payload below which tools from both of its sides meet, m."""
_WIDTH = 0.02
"""Distance between shoulders beside each other, m."""
_SAMPLES, _BEHIND = 200, 0.25
"""Configurations that are compared, and mean way back of a robot that faces back, over the farthest."""
_SMALL = 1e-9
"""Numbers that count as zero."""

Side = Literal["above", "sides", "ahead"]
Layout = Literal["facing", "side-by-side", "one-base"]


class Contact(NamedTuple):
    """Where and how an arm holds a payload that stands upright.

    Attributes:
        point: position of the tip in the payload frame, m, shape (3,).
        approach: direction of the tool in world axes, shape (3,).
        around: direction from the payload to the arm's base, about the vertical, rad.
        one_base: whether other arms share the base, which then faces the payload's centre.
    """

    point: Array
    approach: Array
    around: float
    one_base: bool


class Shoulders(NamedTuple):
    """Where the arms of one robot begin, in its root link.

    Attributes:
        middle: mean of their first joints, m, shape (3,).
        forward: level direction across the line between the first and the last, shape (3,).
        floor: height of the lowest link that no arm moves, 0 or below, m.
    """

    middle: Array
    forward: Array
    floor: float

    @classmethod
    def of(cls, arms: Iterable[Arm]) -> Shoulders:
        """Return the shoulders of arms from left to right; where they stand in line, forward is x."""
        arms = [*arms]
        points = np.array([arm.robot.pose(arm.moving_joints()[0], arm.locked)[:3, 3] for arm in arms])
        robot, angles = arms[0].robot, arms[0].locked
        moving = {joint for arm in arms for joint in arm.moving_joints()}
        still = (link for link in robot.links if not moving & {*robot.movers(link)})
        floor = round(min(float(robot.pose(link, angles)[2, 3]) for link in still), 3)
        across = (points[0] - points[-1]) * (1.0, 1.0, 0.0)
        width = float(np.linalg.norm(across))
        forward = np.cross(across / width, np.eye(3)[2]) if width > _WIDTH else np.eye(3)[0]
        return cls(points.mean(axis=0), forward, min(0.0, floor))

    @property
    def root(self) -> Shoulders:
        """The root link in place of the shoulders, with x forward."""
        return Shoulders(np.zeros(3), np.eye(3)[0], self.floor)


def faces_back(arms: Sequence[Arm]) -> bool:
    """Return whether arms from left to right, along x of their robot, reach mostly the other way.

    The tips of configurations within the joint limits are compared with the shoulders, in parts of the
    farthest; arms that reach all around face along x.

    Args:
        arms: arms of one robot.
    """
    forward, before = Shoulders.of(arms).forward, []
    for arm in arms:
        limits = JointLimits(arm)
        angles = limits.joints.of(np.array(limits.random_configurations(_SAMPLES)))
        tips = arm.replace(base=Pose()).tip_poses(angles)[:, :3, 3]
        before.append((tips - arm.robot.pose(arm.moving_joints()[0], arm.locked)[:3, 3]) @ forward)
    ways = np.array(before)
    return bool(ways.mean() < -_BEHIND * np.abs(ways).max())


def contacts(payload: Payload, count: int, side: Side, layout: Layout) -> Iterator[Contact]:
    """Yield the contacts of two or more arms, evenly around the payload or along one side of it.

    Arms around a narrow one, whose hands would meet across it, hold its ends, and one side of it between.
    """
    half, shared = np.array(payload.size) / 2.0, layout == "one-base"
    is_block = payload.shape != "cylinder"
    is_narrow = layout == "facing" and is_block and count > 2 and 2.0 * half[:2].min() < _HANDS
    for k in range(count):
        around = at = np.pi * (1.0 + 2.0 * k / count)
        if is_narrow:
            around = at = np.pi * (k / (count - 1) - (1.0 if half[0] > half[1] else 0.5))
        elif layout != "facing":
            fan = 0.0 if shared else _FAN * (k - (count - 1) / 2.0)
            around, at = fan - np.pi / 2.0, np.pi * (k / (count - 1) - 1.0)
        outward = np.array((np.cos(at), np.sin(at), 0.0))
        parts = np.maximum(np.abs(outward[:2]), _SMALL)
        to_edge = np.min(half[:2] / parts) if is_block else half[0]
        point, approach = to_edge * outward, -outward
        if is_narrow:
            point = (*half[:2], 0.0) * outward / parts.max()
        if side == "ahead":
            approach = -np.array((np.cos(around), np.sin(around), 0.0))
        if side == "above":
            point, approach = _INSET * point + (0.0, 0.0, half[2]), -np.eye(3)[2]
        yield Contact(point, approach, around, shared)
