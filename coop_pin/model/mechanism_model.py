"""Pinocchio models of mechanisms from URDF: trees whose joints need no drives, with the loops of the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_number, require_path, require_type
from coop_pin.base.errors import ArgumentError, MimicJointError
from coop_pin.description.cell.closure import Closure
from coop_pin.description.urdf import find_urdf, load_checked, text_checked
from coop_pin.description.urdf.loops import read_loops
from coop_pin.description.urdf.robot import Robot
from coop_pin.model.pinocchio_model import joint_id, model_from_text


def mechanism_model(
    path_or_xml: str | Path,
    gravity: ArrayLike,
    ignore_mimic: bool = False,
    package_dirs: Sequence[str] = (),
    xacro_args: Mapping[str, str] = MappingProxyType({}),
) -> tuple[pin.Model, tuple[Closure, ...]]:
    """Return the model of a URDF tree whose root link is fixed in the world, and the loops of the file.

    Args:
        path_or_xml: path of a URDF, name of a bundled or example-robot-data robot, or the XML text itself.
        gravity: m/s^2, in world axes, shape (3,).
        ignore_mimic: let mimic joints move independently.
        package_dirs: package folders, as for find_urdf.
        xacro_args: xacro arguments, as for find_urdf.

    Raises:
        UrdfError: there is no such file; it has structural defects, or loops that cannot be read;
            MimicJointError: it has mimic joints.
        ShapeError, OutOfRangeError: gravity is not three finite numbers.
    """
    along = as_array("gravity", gravity, 3)
    require_type("path_or_xml", path_or_xml, str, Path)
    require_type("package_dirs", package_dirs, Sequence)
    for folder in package_dirs:
        require_path("package_dirs", folder)
    require_type("xacro_args", xacro_args, Mapping)
    is_text = isinstance(path_or_xml, str) and path_or_xml.lstrip("\ufeff \t\r\n").startswith("<")
    name = "the text" if is_text else Path(path_or_xml).name
    if is_text:
        text = text_checked(str(path_or_xml), loops=True)
    else:
        text = load_checked(
            find_urdf(path_or_xml, package_dirs=package_dirs, xacro_args=xacro_args), loops=True
        )
    followers = Robot(text).mimics
    if followers and not ignore_mimic:
        raise MimicJointError(name, followers, "mimic")
    model = model_from_text(text, name)
    model.gravity.linear = along
    return model, read_loops(text)


def velocity_at(model: pin.Model, rates: Mapping[str, float]) -> Array:
    """Return the velocity with named joints at given rates and the others at rest, shape (nv,).

    Args:
        model: the tree.
        rates: joint velocities by joint name, rad/s, or m/s for a prismatic joint.

    Raises:
        NameNotFoundError: a joint does not exist.
        ArgumentError: a joint has more than one degree of freedom.
    """
    require_type("rates", rates, Mapping)
    v = np.zeros(model.nv)
    for name, rate in rates.items():
        joint = model.joints[joint_id(model, name)]
        if joint.nv != 1:
            raise ArgumentError(
                f"joint {name!r} has {joint.nv} degrees of freedom; set its entries of q and v directly"
            )
        v[joint.idx_v] = as_number(f"the value of joint {name!r}", rate)
    return v
