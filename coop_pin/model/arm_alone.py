"""The one function that builds an arm's Pinocchio model: checked, its locked joints frozen, nothing else added."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm
from coop_pin.description.urdf import UrdfFile, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import LockedJointError, MimicJointError, UnsupportedJointError
from coop_pin.model.pinocchio_model import joint_id, model_from_text

_SLACK = 1e-9
_DRIVEN = ("revolute", "continuous", "prismatic")


class WholeArm(NamedTuple):
    """An arm before its joints are locked.

    Attributes:
        model: all joints of the URDF.
        text: the URDF.
        locked: indices of the joints to lock.
        configuration: at which they are locked, shape (nq,).
    """

    model: pin.Model
    text: str
    locked: list[int]
    configuration: Array


def arm_alone(arm: Arm) -> pin.Model:
    """Return the model of an arm by itself, with its base at the origin: a copy, which the caller may change.

    Models are built several times for a run; the file is read again only when it has changed.

    Raises:
        UrdfNotFoundError: the URDF does not exist.
        UrdfError: it has structural defects; LockedJointError: a locked joint is out of its limits, or none is left;
            MimicJointError: joints mimic others and ``mimic`` refuses them; UnsupportedJointError: a joint is planar or floating.
        JointNotFoundError: a locked joint does not exist.
    """
    file = arm.file
    version = file.path.stat()
    return _reduced(file, (version.st_mtime_ns, version.st_size), tuple(arm.locked.items()), arm.mimic == "ignore").copy()


def whole_arm(arm: Arm) -> WholeArm:
    """Return the model of an arm with all its joints, and which of them are locked where; raises as arm_alone."""
    return _whole(arm.file, arm.locked, arm.mimic == "ignore")


@lru_cache(maxsize=64)
def _reduced(file: UrdfFile, version: tuple[int, int], locked: tuple[tuple[str, float], ...], ignore_mimic: bool) -> pin.Model:  # noqa: ARG001
    whole = _whole(file, dict(locked), ignore_mimic)
    return pin.buildReducedModel(whole.model, whole.locked, whole.configuration) if whole.locked else whole.model


def _whole(file: UrdfFile, locked: Mapping[str, float], ignore_mimic: bool) -> WholeArm:
    text = load_checked(file)
    robot, model = Robot(text), model_from_text(text, file.path.name)
    angles = robot.locked(locked)
    q = pin.neutral(model)
    for joint, angle in angles.items():
        _lock(model, q, joint, angle)
    moving = robot.unlocked(locked)
    if not moving:
        raise LockedJointError(f"locks every joint of {file.path.name}; an arm must have one that moves", "locked")
    for joint in moving:
        if robot.joints[joint] not in _DRIVEN:
            raise UnsupportedJointError(file.path.name, joint, robot.joints[joint], "urdf")
    followers = [joint for joint in moving if joint in robot.mimics]
    if followers and not ignore_mimic:
        raise MimicJointError(file.path.name, followers, "mimic")
    return WholeArm(model, text, [joint_id(model, joint) for joint in angles], q)


def _lock(model: pin.Model, q: Array, joint: str, angle: float) -> None:
    index = joint_id(model, joint)
    first, size = int(model.idx_qs[index]), int(model.nqs[index])
    if size == 2:
        q[first : first + 2] = np.cos(angle), np.sin(angle)
    elif size > 2:
        raise LockedJointError("has more than one degree of freedom; only joints with one angle can be locked", f"locked.{joint}")
    else:
        lower, upper = float(model.lowerPositionLimit[first]), float(model.upperPositionLimit[first])
        if not lower - _SLACK <= angle <= upper + _SLACK:
            raise LockedJointError(f"is {angle:g}; the joint moves between {lower:g} and {upper:g}", f"locked.{joint}")
        q[first] = angle
