"""The one door to Pinocchio models: every name resolved once, every silent failure a typed error."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.description.urdf import find_urdf, load_checked, text_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import ArgumentError, MimicJointError, NameNotFoundError, UrdfError


def model_from_text(text: str, name: str) -> pin.Model:
    """Return the Pinocchio model of checked URDF text.

    Where a link and a joint share a name, which URDF allows, the frame of that name is the link's.

    Raises:
        UrdfError: Pinocchio refuses it.
    """
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise UrdfError(f"Pinocchio refuses {name!r}: {error}") from None
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name = f"{frame.name} (joint)"
    return model


def frame_id(model: pin.Model, name: str) -> int:
    """Return the index of a frame; Pinocchio's own look-up answers a wrong name with an index that corrupts memory.

    Raises:
        NameNotFoundError: no frame has that name.
    """
    if not model.existFrame(name):
        # Links first, from the ends of the tree: who misspells a frame of an arm most often means its tip.
        frames = list(model.frames)[::-1]
        frames.sort(key=lambda frame: frame.type != pin.FrameType.BODY)
        raise NameNotFoundError("frame", name, [frame.name for frame in frames], f"model {model.name!r}")
    return int(model.getFrameId(name))


def joint_id(model: pin.Model, name: str) -> int:
    """Return the index of a joint.

    Raises:
        NameNotFoundError: no joint has that name.
    """
    if not model.existJointName(name):
        raise NameNotFoundError("joint", name, list(model.names)[1:], f"model {model.name!r}")
    return int(model.getJointId(name))


def add_frame(model: pin.Model, name: str, joint: int, X_joint_frame: pin.SE3) -> int:
    """Add an operational frame to a joint and return its index."""
    return int(model.addFrame(pin.Frame(name, joint, 0, X_joint_frame, pin.FrameType.OP_FRAME)))


def append_arm(tree: pin.Model, arm: pin.Model, prefix: str, X_WB: Array) -> pin.Model:
    """Return the tree with an arm standing at X_WB, its joints and frames named ``prefix/name``."""
    named = arm.copy()
    for joint in range(1, named.njoints):
        named.names[joint] = f"{prefix}/{named.names[joint]}"
    for frame in named.frames:
        frame.name = f"{prefix}/{frame.name}"
    joined = pin.appendModel(tree, named, 0, pin.SE3(X_WB))
    joined.gravity = tree.gravity  # appendModel goes back to the Earth's
    return joined


def empty_model(gravity: tuple[float, ...] | Array) -> pin.Model:
    """Return a model with nothing in it but gravity, m/s^2."""
    model = pin.Model()
    model.gravity.linear = np.array(gravity, dtype=float)
    return model


def without_inertia(model: pin.Model) -> pin.Model:
    """Return a copy that knows kinematics only: every inertia is zero, so that no dynamics can leak from it."""
    copy = model.copy()
    for joint in range(copy.njoints):
        copy.inertias[joint] = pin.Inertia.Zero()
    copy.gravity.linear = np.zeros(3)
    return copy


def symmetric(upper: Array) -> Array:
    """Return the full matrix of which Pinocchio's crba fills the upper triangle."""
    triangle = np.triu(upper)
    return triangle + np.triu(upper, 1).T


def mechanism_model(path_or_xml: str | Path, gravity: ArrayLike, ignore_mimic: bool = False) -> pin.Model:
    """Return the model of a URDF tree whose root link stands in the world.

    Args:
        path_or_xml: path of a URDF, name of a bundled or example-robot-data robot, or the XML text itself.
        gravity: m/s^2, in world axes, shape (3,).
        ignore_mimic: let joints that mimic others move on their own.

    Raises:
        UrdfError: there is no such file; it has structural defects; MimicJointError: joints mimic others.
        ShapeError, OutOfRangeError: gravity is not three finite numbers.
    """
    along = as_array("gravity", gravity, 3)
    is_text = isinstance(path_or_xml, str) and path_or_xml.lstrip("\ufeff \t\r\n").startswith("<")
    name = "the text" if is_text else Path(path_or_xml).name
    text = text_checked(str(path_or_xml)) if is_text else load_checked(find_urdf(path_or_xml))
    followers = Robot(text).mimics
    if followers and not ignore_mimic:
        raise MimicJointError(name, followers, "mimic")
    model = model_from_text(text, name)
    model.gravity.linear = along
    return model


def configuration_at(model: pin.Model, angles: Mapping[str, float]) -> Array:
    """Return the configuration with some joints at given angles and the others neutral, shape (nq,).

    Args:
        model: the tree.
        angles: rad, or m for a prismatic joint, by joint name.

    Raises:
        NameNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one angle.
    """
    u = velocity_at(model, angles)
    configuration: Array = pin.integrate(model, pin.neutral(model), u)
    return configuration


def velocity_at(model: pin.Model, rates: Mapping[str, float]) -> Array:
    """Return the velocity with some joints at given rates and the others at rest, shape (nv,).

    Args:
        model: the tree.
        rates: rad/s, or m/s for a prismatic joint, by joint name.

    Raises:
        NameNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one rate.
    """
    v = np.zeros(model.nv)
    for name, rate in rates.items():
        joint = model.joints[joint_id(model, name)]
        if joint.nv != 1:
            raise ArgumentError(
                f"joint {name!r} has {joint.nv} degrees of freedom; set its entries of q and v by hand"
            )
        v[joint.idx_v] = as_array(name, rate)
    return v
