"""What a cell's arms look like, and where their bodies are at given configurations."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterator
from typing import Any, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, as_array
from coop_pin.description.arm import Arm
from coop_pin.description.cell import Cell
from coop_pin.errors import UrdfWarning
from coop_pin.model.arm_model import UnreducedArm, load_unreduced_arm
from coop_pin.model.cell_model import CELL_MODELS
from coop_pin.model.pinocchio_model import joint_id
from coop_pin.model.shapes import Shape, shape_of


class Visual(NamedTuple):
    """One shape on a body.

    Attributes:
        name: its name in the URDF, made unique by Pinocchio.
        shape: the shape.
        pose: of the shape in the body, shape (4, 4).
        colour: red, green, blue and opacity, from 0 to 1.
    """

    name: str
    shape: Shape
    pose: Array
    colour: tuple[float, float, float, float]


class Body(NamedTuple):
    """Everything of an arm that moves with one joint; its frame is the joint's.

    Attributes:
        name: ``<arm>/<joint>``, or ``<arm>/base`` for what stands still.
        visuals: its shapes.
    """

    name: str
    visuals: tuple[Visual, ...]


class CellVisuals:
    """The bodies of a cell's arms.

    Attributes:
        bodies: those that have something to draw.
        joints: names of the joints of each arm, in the order of its drives.
    """

    def __init__(self, cell: Cell, payload: Literal["welded", "free"]) -> None:
        """Read the visual geometry of every arm.

        Args:
            cell: the description.
            payload: how the tree holds the payload, as in the scenario's plant: it fixes the layout of q.
        """
        tree = CELL_MODELS[payload](cell)
        self.joints = {
            place.name: tuple(name.removeprefix(f"{place.name}/") for name in place.angles.names)
            for place in tree.arms
        }
        self._model = tree.model
        self._data = self._model.createData()
        self.bodies: tuple[Body, ...] = ()
        self._joints: list[int] = []
        self._base_poses: dict[int, Array] = {}
        alike: dict[
            Hashable, dict[str, tuple[Visual, ...]]
        ] = {}  # arms of one kind are read once: meshes take their time
        for name, arm in cell.arms.items():
            kind = (arm.file, *arm.locked.items())
            if kind not in alike:
                alike[kind] = _visuals_by_joint(arm)
            for joint, visuals in alike[kind].items():
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
    """Return the shapes of an arm by the joint that moves them; "universe" for what stands still."""
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
    """Yield Pinocchio's visual geometry objects; where one cannot be read, those of the other links."""
    try:
        yield from _build(whole.model, whole.text, folders)
    except (
        ValueError,
        RuntimeError,
    ):  # Pinocchio gives up on the whole file at the first bad mesh: go link by link
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
    # Handing in the geometry model is the only way to hand in folders without a deprecation warning of pin
    # 4.1.
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
    warnings.warn(f"{what} of {urdf!r} is left out of the picture: {why}", UrdfWarning, stacklevel=2)
