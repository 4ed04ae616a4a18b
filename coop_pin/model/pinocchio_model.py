"""Pinocchio models of arms from URDF, and safe access to their frames and joints.

Pinocchio reports some mistakes, such as a wrong frame name, only by undefined behaviour; the functions of
this module raise typed errors instead.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import MimicJointError, NameNotFoundError, UrdfError
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.armature import Rotors, reflected
from coop_pin.description.urdf import UrdfFile, load_checked
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.robot import Robot

_DRIVEN = ("revolute", "continuous", "prismatic")
_SLACK = 1e-9
_NO_INERTIA = 1e-18
"""Inertia about a joint's axis, kg m^2 or kg, that is zero but for rounding."""


def model_from_text(text: str, name: str) -> pin.Model:
    """Return the Pinocchio model of checked URDF text.

    If a link and a joint share a name, which URDF allows, the frame of that name is the link's.

    Raises:
        UrdfError: Pinocchio rejects it.
    """
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise UrdfError(f"Pinocchio rejects {name!r}: {error}") from None
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name = f"{frame.name} (joint)"
    return model


def frame_id(model: pin.Model, name: str, container: str = "") -> int:
    """Return the index of a frame; messages name the container, or else the model.

    For an unknown name pin.Model.getFrameId returns an index beyond the last frame, which corrupts memory.

    Raises:
        NameNotFoundError: no frame has that name.
    """
    require_type("frame", name, str)
    if not (name.isascii() or name.isprintable()) or not model.existFrame(name):
        # Suggest links first, from the ends of the tree: a misspelt frame of an arm is most often its tip.
        frames = list(model.frames)[::-1]
        frames.sort(key=lambda frame: frame.type != pin.FrameType.BODY)
        known = [frame.name for frame in frames]
        raise NameNotFoundError("frame", name, known, container or f"model {model.name!r}")
    return int(model.getFrameId(name))


def joint_id(model: pin.Model, name: str) -> int:
    """Return the index of a joint.

    Raises:
        NameNotFoundError: no joint has that name.
    """
    require_type("joint", name, str)
    if not (name.isascii() or name.isprintable()) or not model.existJointName(name):
        raise NameNotFoundError("joint", name, list(model.names)[1:], f"model {model.name!r}")
    return int(model.getJointId(name))


def add_frame(model: pin.Model, name: str, joint: int, X_joint_frame: pin.SE3) -> int:
    """Add an operational frame to a joint and return its index."""
    return int(model.addFrame(pin.Frame(name, joint, 0, X_joint_frame, pin.FrameType.OP_FRAME)))


def append_arm(tree: pin.Model, arm: pin.Model, prefix: str, X_WB: Array, mount: int = 0) -> pin.Model:
    """Return the tree with an arm based at X_WB on a mount added, all of it named ``prefix/name``."""
    named = arm.copy()
    for joint in range(1, named.njoints):
        named.names[joint] = f"{prefix}/{named.names[joint]}"
    for frame in named.frames:
        frame.name = f"{prefix}/{frame.name}"
    return append_part(tree, named, X_WB, mount)


def append_part(tree: pin.Model, part: pin.Model, X_WB: Array, mount: int = 0) -> pin.Model:
    """Return the tree with a part based at X_WB on a mount added, its names as they are.

    The mount is a frame: the world's, 0, or one on the last joint.
    """
    joined = pin.appendModel(tree, part, mount, pin.SE3(X_WB))
    joined.gravity = tree.gravity  # appendModel resets it to the Earth's
    joined.armature = np.concatenate((tree.armature, part.armature))  # appendModel drops it
    return joined


def empty_model(gravity: tuple[float, ...] | Array) -> pin.Model:
    """Return a model without joints and bodies, with the given gravity, m/s^2."""
    model = pin.Model()
    model.gravity.linear = np.array(gravity, dtype=float)
    return model


def without_inertia(model: pin.Model) -> pin.Model:
    """Return a copy for kinematics only: inertias and gravity are zero, so it contains no dynamics."""
    copy = model.copy()
    for joint in range(copy.njoints):
        copy.inertias[joint] = pin.Inertia.Zero()
    copy.armature, copy.gravity.linear = np.zeros(copy.nv), np.zeros(3)
    return copy


def jacobian_matrix(J: Array) -> Array:
    """Return a Jacobian of Pinocchio, shape (6, nv), which is flat for a model with one degree of freedom."""
    return J.reshape(6, -1)


def symmetric(upper: Array) -> Array:
    """Return the full symmetric matrix from its upper triangle, which is all that pin.crba fills."""
    return np.triu(upper) + np.triu(upper, 1).T


def kinetic_energy(model: pin.Model, data: pin.Data, v: Array, *, has_rotors: bool) -> float:
    """Return the kinetic energy of bodies and rotors at the last forward kinematics, J.

    T = sum_i V_i^T I_i V_i / 2 + v^T diag(armature) v / 2. That of Pinocchio leaves out a part of rotors on
    joints whose axis is none of their frame's (JointModelRevoluteUnaligned).

    Args:
        model: the model.
        data: data of the model, moved with v.
        v: velocity, shape (nv,).
        has_rotors: whether a joint of the model has an armature.
    """
    if not has_rotors:
        return float(pin.computeKineticEnergy(model, data))
    bodies = sum(inertia.vtiv(V) for inertia, V in zip(model.inertias, data.v, strict=True))
    return 0.5 * float(bodies + v @ (model.armature * v))


def momentum_rate(inertia: pin.Inertia, V: pin.Motion, A: pin.Motion) -> Array:
    """Return I A + V x* I V, the resultant wrench on a rigid body by Newton and Euler, shape (6,).

    All are about one point of the body in one set of axes. Where A is less gravity, so is the wrench.

    Args:
        inertia: I.
        V: twist.
        A: spatial acceleration.
    """
    wrench: Array = (inertia * A + V.cross(inertia * V)).vector
    return wrench


class UnreducedArm(NamedTuple):
    """Model of an arm with all joints of its URDF, and the joints to lock.

    Attributes:
        model: all joints of the URDF.
        text: the URDF.
        locked: indices of the joints to lock.
        configuration: configuration at which they are locked, shape (nq,).
    """

    model: pin.Model
    text: str
    locked: list[int]
    configuration: Array


class ModelKey(NamedTuple):
    """What the model of an arm depends on.

    Attributes:
        file: URDF of the arm.
        version: time and size of the file.
        locked: angles of the locked joints, by name.
        ignores_mimic: whether followers of mimic joints move by themselves.
        armature: inertia of rotors, as stated.
        base_joints: number of its joints that move its mobile base.
    """

    file: UrdfFile
    version: tuple[int, int]
    locked: tuple[tuple[str, float], ...]
    ignores_mimic: bool
    armature: Rotors | float | tuple[float, ...]
    base_joints: int


def model_key(arm: Arm) -> ModelKey:
    """Return the key of an arm's model."""
    file, locked = arm.file, tuple(arm.locked.items())
    stamp = os.stat(file.path)  # noqa: PTH116
    version = stamp.st_mtime_ns, stamp.st_size
    return ModelKey(file, version, locked, arm.mimic == "ignore", arm.armature, arm.base_joints)


def load_arm_model(arm: Arm) -> pin.Model:
    """Return the Pinocchio model of an arm with its base at the origin: a copy, which the caller may change.

    Models are cached: a run builds several, and the file is read again only if it has changed.

    Raises:
        UrdfError: the URDF does not exist; it has structural defects; a joint is locked beyond its limits, or
            all joints are locked; a joint is planar or floating, or moves no mass.
        MimicJointError: it has mimic joints, and ``mimic`` refuses them.
        NameNotFoundError: a locked joint does not exist.
    """
    return shared_arm_model(model_key(arm)).copy()


def load_unreduced_arm(arm: Arm) -> UnreducedArm:
    """Return the model of an arm with all its joints, and those to lock; raises as load_arm_model."""
    return unreduced_of(model_key(arm))


def unreduced_of(key: ModelKey) -> UnreducedArm:
    """Return what ``load_unreduced_arm`` does, by the key of an arm."""
    return _unreduced(key.file, dict(key.locked), key.ignores_mimic)


@lru_cache(maxsize=64)
def shared_arm_model(key: ModelKey) -> pin.Model:
    """Return the model that load_arm_model copies, which nobody may change."""
    arm = unreduced_of(key)
    model = pin.buildReducedModel(arm.model, arm.locked, arm.configuration) if arm.locked else arm.model
    _require_moved_mass(model, key.file.path.name)
    model.armature = reflected(key.armature, int(model.nv), key.base_joints)
    return model


def _require_moved_mass(model: pin.Model, name: str) -> None:
    """Raise an error if joints move no inertia: the mass matrix is singular in every configuration.

    M_jj is the inertia about joint j of all that it moves.

    Raises:
        UrdfError: with the names of the joints.
    """
    inertia = np.diag(pin.crba(model, model.createData(), pin.neutral(model)))
    if joints := [model.names[1 + int(j)] for j in np.flatnonzero(inertia <= _NO_INERTIA)]:
        message = f"{name!r} has joints that move no inertia: {listed(joints)}; add <inertial> to their links"
        raise UrdfError(f"{message}, or lock them (locked)", "urdf", joints)


def _unreduced(file: UrdfFile, locked: Mapping[str, float], ignore_mimic: bool) -> UnreducedArm:
    text = load_checked(file)
    robot, model = Robot(text), model_from_text(text, file.path.name)
    angles, moving = robot.locked(locked), robot.unlocked(locked)
    q = pin.neutral(model)
    for joint, angle in angles.items():
        _lock(model, q, joint, angle)
    if not moving:
        raise UrdfError(f"locks every joint of {file.path.name}; an arm must have one that moves", "locked")
    for joint in moving:
        if robot.joints[joint] not in _DRIVEN:
            raise UrdfError(
                f"{file.path.name!r} has joint {joint!r} of type {robot.joints[joint]};"
                " arms have revolute, continuous, prismatic and fixed joints",
                "urdf",
                [joint],
            )
    followers = [joint for joint in moving if joint in robot.mimics]
    if followers and not ignore_mimic:
        stop = "lock them or those joints with locked = { joint = angle }"
        raise MimicJointError(file.path.name, followers, "mimic", stop)
    indices = [joint_id(model, joint) for joint in angles]
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for index in indices:  # the reduced model has frames with their names, which no link may have
        if model.names[index] in links:
            model.names[index] += " (joint)"
    return UnreducedArm(model, text, indices, q)


def _lock(model: pin.Model, q: Array, joint: str, angle: float) -> None:
    """Write a locked joint's angle into q."""
    index = joint_id(model, joint)
    first, size = int(model.idx_qs[index]), int(model.nqs[index])
    if size == 2:
        q[first : first + 2] = np.cos(angle), np.sin(angle)
    elif size > 2:
        raise UrdfError(
            "has more than one degree of freedom; only joints with one angle can be locked", f"locked.{joint}"
        )
    else:
        lower, upper = float(model.lowerPositionLimit[first]), float(model.upperPositionLimit[first])
        if not lower - _SLACK <= angle <= upper + _SLACK:
            raise UrdfError(
                f"is {angle:g}; the joint moves between {lower:g} and {upper:g}", f"locked.{joint}"
            )
        q[first] = angle
