"""The Pinocchio model of a mechanism: any URDF tree as it stands, on the ground."""

from __future__ import annotations

from pathlib import Path

import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import as_array
from coop_pin.description.urdf import find_urdf, load_checked, text_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import MimicJointError
from coop_pin.model.pinocchio_model import model_from_text


def mechanism_model(path_or_xml: str | Path, gravity: ArrayLike, ignore_mimic: bool = False) -> pin.Model:
    """Return the model of a URDF tree whose root link stands in the world.

    Args:
        path_or_xml: path of a URDF, name of a bundled or example-robot-data robot, or the XML text itself.
        gravity: m/s^2, in world axes, shape (3,).
        ignore_mimic: let joints that mimic others move on their own.

    Raises:
        UrdfNotFoundError: there is no such file.
        UrdfError: it has structural defects; MimicJointError: joints mimic others.
        ShapeError, NotFiniteError: gravity is not three finite numbers.
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
