"""Errors of an arm's own kinematic model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Self

import numpy as np

from coop_pin.base.schema.base import Description, NumberOrVector
from coop_pin.base.schema.changes import words
from coop_pin.base.schema.pose import Pose


class Miscalibration(Description):
    """Errors of an arm's own kinematic model. The arm itself, and so the plant, is right.

    Attributes:
        tip: pose of the tip in the arm's own kinematic model, seen from the true tip.
        base: pose of the base in its model, seen from the true base.
        joint_offset: offset that its model adds to every joint position, rad or m; one value for all joints
            or one for each.
        link_length: relative error of the distance from each joint to the next, from the last one to the tip;
            one value for all joints or one for each.
    """

    tip: Pose = Pose()
    base: Pose = Pose()
    joint_offset: NumberOrVector = 0.0
    link_length: NumberOrVector = 0.0

    def differences(self, base: Self, path: tuple[str, ...]) -> Iterator[str]:
        """Yield what is off in place of what the base has, as lengths, angles and shares."""
        arm = words(path[:-1])
        for part, pose, usual in (("tip", self.tip, base.tip), ("base", self.base, base.base)):
            if pose != usual:
                off = ((1e3 * np.linalg.norm(pose.xyz), "mm"), (1e3 * np.linalg.norm(pose.rpy), "mrad"))
                sizes = " and ".join(f"{size:.3g} {unit}" for size, unit in off if size) or "nothing"
                yield f"{arm} model: {part} off by {sizes}"
        if self.joint_offset != base.joint_offset:
            yield f"{arm} model: joints off by {1e3 * np.abs(self.joint_offset).max():.3g} mrad"
        if self.link_length != base.link_length:
            yield f"{arm} model: links off by {100 * np.abs(self.link_length).max():.3g} %"
