"""Visual geometry of the arms of a cell, and poses of their bodies at given configurations."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Collection, Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, as_array
from coop_pin.base.errors import FileReadError, UrdfWarning
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.linkage import Linkage
from coop_pin.model.cell_model import CellModel, PayloadAttachment, carried_robot
from coop_pin.model.geometry import (
    can_be_read,
    geometry_objects,
    with_located_meshes,
    without_mesh_files,
    without_meshes,
)
from coop_pin.model.mechanism_model import ROOT
from coop_pin.model.meshes import Colour, MeshFile, colour_of, coloured_meshes
from coop_pin.model.pinocchio_model import UnreducedArm, joint_id, load_unreduced_arm, model_from_text
from coop_pin.model.shapes import Shape, half_extents, joined, shape_of


class Visual(NamedTuple):
    """Visual shape on a body.

    Attributes:
        name: name in the URDF, made unique by Pinocchio; the pieces of a mesh share it.
        shape: box, cylinder, sphere or mesh.
        pose: pose of the shape in the body's frame, shape (4, 4).
        colour: red, green, blue and opacity, from 0 to 1.
    """

    name: str
    shape: Shape
    pose: Array
    colour: Colour


class Body(NamedTuple):
    """All visual shapes of an arm or a payload that move with one joint; the body's frame is the joint's.

    Attributes:
        name: ``<arm>/<joint>``, or ``<arm>/base`` for the fixed part; ``payload/links.<joint>``.
        visuals: shapes of the body.
    """

    name: str
    visuals: tuple[Visual, ...]


class CellVisuals:
    """Bodies of the arms of a cell, and their poses.

    Attributes:
        bodies: bodies with visual shapes.
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
        self.joints = {slot.name: slot.joint_names for slot in cell_model.arms}
        self._model = cell_model.model
        self._data = self._model.createData()
        self.bodies: tuple[Body, ...] = ()
        self._joints: list[int] = []
        self._base_poses: dict[int, Array] = {}
        by_kind: dict[Hashable, dict[str, tuple[Visual, ...]]] = {}  # equal arms share their meshes
        drawn, carrier = set[str](), cell.carrier
        carried = () if carrier is None else carrier.arms
        self._draw_carried(cell, carried)
        for name, arm in cell.arms.items():
            if name in carried:
                continue
            siblings = {other: self.joints[other] for other in cell.siblings(name)}
            kind = (arm.file, *arm.locked.items(), *itertools.chain(*siblings.values()))
            if kind not in by_kind:
                by_kind[kind] = _visuals_by_joint(arm, {*itertools.chain(*siblings.values())})
            for joint, visuals in by_kind[kind].items():
                moving, root = joint != "universe", cell_model.root_joint(name)
                if not moving and any(f"{other}/base" in drawn for other in siblings):
                    continue  # the robot's fixed part
                if not moving and root == 0:
                    self._base_poses[len(self.bodies)] = pin.SE3ToXYZQUAT(pin.SE3(arm.base.matrix))
                self._joints.append(joint_id(self._model, f"{name}/{joint}") if moving else root)
                self.bodies += (Body(f"{name}/{joint if moving else 'base'}", visuals),)
                drawn.add(self.bodies[-1].name)
        if cell.payload.links is not None:
            self._draw_links(cell.payload.links)

    def _draw_links(self, links: Linkage) -> None:
        """Add the links of a payload of several, but that of P, which is drawn as the payload.

        Meshes of its URDF are not read.
        """
        text, _ = without_mesh_files(links.text)
        model = model_from_text(text, "the payload")
        shapes: dict[str, tuple[Visual, ...]] = {}
        for part in geometry_objects(model, text)[0]:
            shape, joint = shape_of(part.geometry), str(model.names[part.parentJoint])
            if shape is not None and model.frames[part.parentFrame].name != links.link:
                pose = np.array(part.placement.homogeneous)
                drawn = Visual(part.name, shape, pose, colour_of(part.meshColor))
                shapes[joint] = (*shapes.get(joint, ()), drawn)
        for joint, visuals in shapes.items():
            is_fixed = joint == "universe" and links.base is not None
            if is_fixed and links.base is not None:
                self._base_poses[len(self.bodies)] = pin.SE3ToXYZQUAT(pin.SE3(links.base.matrix))
            in_tree = ROOT if joint == "universe" else f"payload.{joint}"
            self._joints.append(0 if is_fixed else joint_id(self._model, in_tree))
            self.bodies += (Body(f"payload/links.{joint}", visuals),)

    def _draw_carried(self, cell: Cell, names: Sequence[str]) -> None:
        """Add the bodies of a robot on shared joints, if there are any: each link once."""
        if not names:
            return
        arm, fixed = carried_robot(cell, names), f"{names[0]}/base"
        owners = {joint: f"{name}/{joint}" for name in names for joint in self.joints[name]}
        for joint, visuals in _visuals_by_joint(arm, ()).items():
            if joint == "universe":
                self._base_poses[len(self.bodies)] = pin.SE3ToXYZQUAT(pin.SE3(arm.base.matrix))
            in_tree = owners.get(joint, f"shared.{joint}")
            self._joints.append(0 if joint == "universe" else joint_id(self._model, in_tree))
            shown = owners.get(joint, f"{fixed}.{joint}")
            self.bodies += (Body(fixed if joint == "universe" else shown, visuals),)

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


def _visuals_by_joint(arm: Arm, without: Collection[str]) -> dict[str, tuple[Visual, ...]]:
    """Return the shapes of an arm by the joint that moves them; "universe" for the fixed ones.

    Args:
        arm: the arm.
        without: joints whose links, and those beyond them, are left out: those of the robot's other arms.
    """
    whole = load_unreduced_arm(arm)
    model, geometry = whole.model, pin.GeometryModel()
    parts, files = _geometries(whole, arm)
    for part in parts:
        if not any(model.names[joint] in without for joint in model.supports[part.parentJoint]):
            geometry.addGeometryObject(part)
    if whole.locked:
        model, geometry = pin.buildReducedModel(model, geometry, whole.locked, whole.configuration)
    visuals: dict[str, tuple[Visual, ...]] = {}
    for part in geometry.geometryObjects:
        pose, joint = np.array(part.placement.homogeneous), str(model.names[part.parentJoint])
        drawn = (Visual(part.name, shape, pose, colour) for shape, colour in _pieces(part, arm, files))
        visuals[joint] = (*visuals.get(joint, ()), *drawn)
    return visuals


def _pieces(part: Any, arm: Arm, files: Mapping[str, MeshFile]) -> Sequence[tuple[Shape, Colour]]:
    """Return the shapes of a geometry object with their colours; none, with a warning, if it is not drawn."""
    if part.name in files:
        path, scale, is_coloured = files[part.name]
        try:
            pieces = coloured_meshes(path, scale)
        except FileReadError as error:
            _warn(arm.urdf, part.name, str(error))
            return []
        if not pieces:
            _warn(arm.urdf, part.name, "the materials of its mesh cannot be read")
        elif not is_coloured:
            return [(joined([mesh for mesh, _ in pieces]), colour_of(part.meshColor))]
        return pieces
    shape = shape_of(part.geometry)
    if shape is None:
        _warn(arm.urdf, part.name, f"shapes of kind {type(part.geometry).__name__} are not drawn")
    elif not np.isfinite(half_extents(shape)).all():
        _warn(arm.urdf, part.name, "its size is not finite")
    else:
        return [(shape, colour_of(part.meshColor))]
    return []


def _geometries(whole: UnreducedArm, arm: Arm) -> tuple[list[Any], dict[str, MeshFile]]:
    """Return Pinocchio's visual geometry objects that can be read, and meshes that it does not read."""
    text, paths = with_located_meshes(whole.text, arm.file)
    size = sum(path.stat().st_size for path in paths)
    if arm.file.origin == "user" and paths and not can_be_read(text, size):
        names = ", ".join(sorted({path.name for path in paths}))
        _warn(
            arm.urdf,
            names,
            "reading one of these meshes ends the process or takes too long or too much memory",
        )
        text = without_meshes(text)
    text, files = without_mesh_files(text)
    objects, problems = geometry_objects(whole.model, text)
    for link, problem in problems.items():
        _warn(arm.urdf, f"link {link!r}", problem)
    return objects, files


def _warn(urdf: str, what: str, why: str) -> None:
    warnings.warn(f"{what} of {urdf!r} is not drawn: {why}", UrdfWarning, stacklevel=2)
