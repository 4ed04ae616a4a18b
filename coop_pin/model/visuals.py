"""Visual geometry of the arms of a cell, and poses of their bodies at given configurations."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, as_array
from coop_pin.description.arm import Arm
from coop_pin.description.cell import Cell
from coop_pin.errors import UrdfWarning
from coop_pin.model.cell_model import CellModel, PayloadAttachment
from coop_pin.model.pinocchio_model import UnreducedArm, joint_id, load_unreduced_arm
from coop_pin.model.shapes import Shape, shape_of


class Visual(NamedTuple):
    """Visual shape on a body.

    Attributes:
        name: its name in the URDF, made unique by Pinocchio.
        shape: box, cylinder, sphere or mesh.
        pose: of the shape in the body's frame, shape (4, 4).
        colour: red, green, blue and opacity, from 0 to 1.
    """

    name: str
    shape: Shape
    pose: Array
    colour: tuple[float, float, float, float]


class Body(NamedTuple):
    """All visual shapes of an arm that move with one joint; the body's frame is the joint's.

    Attributes:
        name: ``<arm>/<joint>``, or ``<arm>/base`` for the fixed part.
        visuals: its shapes.
    """

    name: str
    visuals: tuple[Visual, ...]


class CellVisuals:
    """Bodies of the arms of a cell, and their poses.

    Attributes:
        bodies: those with visual shapes.
        joints: names of the joints of each arm, in the order of its drives.
    """

    def __init__(self, cell: Cell, payload: PayloadAttachment) -> None:
        """Read the visual geometry of every arm.

        Args:
            cell: the description.
            payload: attachment of the payload, as in the scenario's plant options: it determines the layout
                of q.
        """
        cell_model = CellModel(cell, payload)
        self.joints = {place.name: place.joint_names for place in cell_model.arms}
        self._model = cell_model.model
        self._data = self._model.createData()
        self.bodies: tuple[Body, ...] = ()
        self._joints: list[int] = []
        self._base_poses: dict[int, Array] = {}
        by_kind: dict[Hashable, dict[str, tuple[Visual, ...]]] = {}  # equal arms share their meshes
        for name, arm in cell.arms.items():
            kind = (arm.file, *arm.locked.items())
            if kind not in by_kind:
                by_kind[kind] = _visuals_by_joint(arm)
            for joint, visuals in by_kind[kind].items():
                moving = joint != "universe"
                if not moving:
                    self._base_poses[len(self.bodies)] = pin.SE3ToXYZQUAT(pin.SE3(arm.base.matrix))
                self._joints.append(joint_id(self._model, f"{name}/{joint}") if moving else 0)
                self.bodies += (Body(f"{name}/{joint if moving else 'base'}", visuals),)

    def poses(self, configurations: Array) -> Array:
        """Return the pose of every body in the world at every configuration.

        Args:
            configurations: q of the tree, shape (n, nq).

        Returns:
            x, y, z (m) and the quaternion x, y, z, w, shape (n, bodies, 7).
        """
        q = as_array("configurations", configurations, "n", self._model.nq)
        poses = np.empty((len(q), len(self.bodies), 7))
        for sample, configuration in enumerate(q):
            pin.forwardKinematics(self._model, self._data, configuration)
            for body, joint in enumerate(self._joints):
                poses[sample, body] = pin.SE3ToXYZQUAT(self._data.oMi[joint])
        for body, pose in self._base_poses.items():
            poses[:, body] = pose
        return poses


def _visuals_by_joint(arm: Arm) -> dict[str, tuple[Visual, ...]]:
    """Return the shapes of an arm by the joint that moves them; "universe" for the fixed ones."""
    whole = load_unreduced_arm(arm)
    geometry = pin.GeometryModel()
    for part in _geometries(whole, [str(folder) for folder in arm.file.package_dirs], arm.urdf):
        geometry.addGeometryObject(part)
    model = whole.model
    if whole.locked:
        model, geometry = pin.buildReducedModel(model, geometry, whole.locked, whole.configuration)
    visuals: dict[str, tuple[Visual, ...]] = {}
    for part in geometry.geometryObjects:
        shape = shape_of(part.geometry)
        if shape is None:
            _warn(arm.urdf, part.name, f"shapes of kind {type(part.geometry).__name__} are not drawn")
            continue
        red, green, blue, opacity = (float(share) for share in part.meshColor)
        visual = Visual(part.name, shape, np.array(part.placement.homogeneous), (red, green, blue, opacity))
        joint = str(model.names[part.parentJoint])
        visuals[joint] = (*visuals.get(joint, ()), visual)
    return visuals


def _geometries(whole: UnreducedArm, folders: list[str], urdf: str) -> Iterator[Any]:
    """Yield Pinocchio's visual geometry objects; if one cannot be read, those of the other links."""
    try:
        yield from _build(whole.model, whole.text, folders)
    except (ValueError, RuntimeError):  # one bad mesh fails the whole file: read it link by link
        names = [
            link.get("name", "")
            for link in ElementTree.fromstring(whole.text).iter("link")
            if link.find("visual") is not None
        ]
        for name in names:
            try:
                yield from _build(whole.model, _only_visuals_of(name, whole.text), folders)
            except (ValueError, RuntimeError) as error:
                _warn(urdf, f"link {name!r}", str(error))


def _build(model: pin.Model, text: str, folders: list[str]) -> list[Any]:
    # Without the geometry model as an argument, pin 4.1 warns that passing folders is deprecated.
    geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL, pin.GeometryModel(), folders)
    return list(geometry.geometryObjects)


def _only_visuals_of(name: str, text: str) -> str:
    robot = ElementTree.fromstring(text)
    for link in robot.iter("link"):
        if link.get("name") != name:
            for visual in link.findall("visual"):
                link.remove(visual)
    return ElementTree.tostring(robot, encoding="unicode")


def _warn(urdf: str, what: str, why: str) -> None:
    warnings.warn(f"{what} of {urdf!r} is not drawn: {why}", UrdfWarning, stacklevel=2)
