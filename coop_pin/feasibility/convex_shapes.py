"""Convex shapes of an arm's links for distances, and the pairs that its SRDF exempts."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import CoopPinError
from coop_pin.base.user_files import read_user_file
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.payload import Payload
from coop_pin.description.urdf import UrdfFile
from coop_pin.description.urdf.xml import Element, read_document
from coop_pin.model.geometry import Kind, can_be_read, geometry_objects, with_located_meshes, without_meshes
from coop_pin.model.pinocchio_model import (
    ModelKey,
    load_unreduced_arm,
    model_from_text,
    model_key,
    unreduced_of,
)
from coop_pin.model.shapes import Cylinder, Mesh, payload_shape

_LARGEST_SRDF = 10_000_000
FIXED = "universe"
"""Joint of what does not move."""


class LinkShape(NamedTuple):
    """Convex shape of a link.

    Attributes:
        link: name of the link in the URDF.
        joint: name of the joint that moves it, FIXED if none does.
        pose: pose of the shape in the joint's frame, or in that of the root, shape (4, 4).
        geometry: the shape, of coal.
    """

    link: str
    joint: str
    pose: Array
    geometry: Any


class ArmShapes(NamedTuple):
    """Shapes of an arm.

    Attributes:
        shapes: convex shapes of its links; hulls in place of meshes.
        kind: elements of the URDF that they are of: "collision", or "visual" where it has none of these.
        omitted: links of which a shape cannot be read, with the reason.
    """

    shapes: tuple[LinkShape, ...]
    kind: Kind
    omitted: tuple[str, ...]


def arm_shapes(arm: Arm, without: Collection[str] = ()) -> ArmShapes:
    """Return the shapes of an arm, which are read once.

    Args:
        arm: Description of the arm.
        without: Joints whose links, and those beyond them, are left out: those of the robot's other arms.

    Raises:
        UrdfError: as of ``load_arm_model``.
    """
    return _shapes(model_key(arm), frozenset(without))


@lru_cache(maxsize=64)
def _shapes(key: ModelKey, without: frozenset[str]) -> ArmShapes:
    whole, file = unreduced_of(key), key.file
    kind, text, omitted = _located(whole.text, file)
    objects, problems = geometry_objects(whole.model, text, kind)
    omitted += [f"{link}: {problem}" for link, problem in problems.items()]
    model, geometry = whole.model, pin.GeometryModel()
    for part in objects:
        if not any(model.names[joint] in without for joint in model.supports[part.parentJoint]):
            geometry.addGeometryObject(part)
    if whole.locked:
        model, geometry = pin.buildReducedModel(model, geometry, whole.locked, whole.configuration)
    shapes = []
    for part in geometry.geometryObjects:
        link = part.name.rpartition("_")[0]
        if (convex := _convex(part.geometry, link, omitted)) is not None:
            pose = np.array(part.placement.homogeneous)
            shapes.append(LinkShape(link, str(model.names[part.parentJoint]), pose, convex))
    return ArmShapes(tuple(shapes), kind, tuple(omitted))


def _located(text: str, file: UrdfFile) -> tuple[Kind, str, list[str]]:
    """Return the kind of a URDF's shapes, its text with the paths of their meshes, and what was left out."""
    kind: Kind = "collision" if "<collision" in text else "visual"
    text, files = with_located_meshes(text, file, kind)
    is_tried = file.origin == "user" and files  # those of packages were
    if is_tried and not can_be_read(text, sum(path.stat().st_size for path in files), kind):
        return (
            kind,
            without_meshes(text, kind),
            ["all meshes: reading one ends the process or takes too long"],
        )
    return kind, text, []


def _convex(geometry: Any, link: str, omitted: list[str]) -> Any:
    """Return the convex hull of a mesh; other shapes are convex. A flat one is left out with its reason."""
    try:
        if hasattr(geometry, "buildConvexHull"):
            geometry.buildConvexHull(True, "Qt")
            return geometry.convex
    except (RuntimeError, ValueError) as error:
        omitted.append(f"{link}: {error}")
        return None
    return geometry


def payload_geometry(payload: Payload) -> Any:
    """Return the convex shape of a payload, centred at its ``shape_pose``; its box if a mesh is flat."""
    match payload_shape(payload):
        case Cylinder(radius, length):
            return pin.coal.Cylinder(radius, length)
        case Mesh(vertices, faces):
            mesh = pin.coal.BVHModelOBBRSS()
            mesh.beginModel(len(faces), len(vertices))
            mesh.addVertices(np.asarray(vertices, dtype=float))
            mesh.addTriangles(np.asarray(faces, dtype=np.int64))
            mesh.endModel()
            if (convex := _convex(mesh, "", [])) is not None:
                return convex
    return pin.coal.Box(*payload.size)


@lru_cache(maxsize=16)
def link_shapes(text: str, file: UrdfFile | None) -> tuple[tuple[LinkShape, ...], tuple[str, ...]]:
    """Return the shapes of a payload of several links in axes of the links, and which are left out, and why.

    Args:
        text: the URDF; where it has no collision elements, those to draw count.
        file: file of the URDF, beside which its meshes are; None without.
    """
    kind, located, omitted = _located(text, file or UrdfFile(Path("text"), ()))
    model = model_from_text(located, "the payload")
    objects, problems = geometry_objects(model, located, kind)
    omitted += [f"{link}: {problem}" for link, problem in problems.items()]
    shapes = []
    for part in objects:
        link = model.frames[part.parentFrame]
        if (convex := _convex(part.geometry, link.name, omitted)) is not None:
            pose = np.array(link.placement.actInv(part.placement).homogeneous)
            shapes.append(LinkShape(link.name, str(model.names[part.parentJoint]), pose, convex))
    return tuple(shapes), tuple(omitted)


def srdf_of(arm: Arm) -> Path | None:
    """Return the SRDF of an arm's robot, in the folder of the URDF or in ../srdf; None without any.

    It has the URDF's name or the robot's, or it is the only one there that is for a robot of this name.
    """
    file = arm.file
    robot = read_document(load_unreduced_arm(arm).text.encode()).get("name", "")
    folders = file.path.parent, file.path.parent.parent / "srdf"
    paths = (folder / f"{name}.srdf" for name in (file.path.stem, robot) for folder in folders if name)
    if named := next((path for path in paths if path.is_file()), None):
        return named
    others = [
        path for folder in folders for path in sorted(folder.glob("*.srdf")) if _robot_of(path) == robot
    ]
    return others[0] if len(others) == 1 else None


def _robot_of(srdf: Path) -> str | None:
    """Return the name of the robot that an SRDF is for; None where it cannot be read."""
    root = _root(srdf)
    return None if root is None else root.get("name")


def _root(srdf: Path) -> Element | None:
    try:
        return read_document(read_user_file(srdf, limit=_LARGEST_SRDF, kind="an SRDF"))
    except CoopPinError:
        return None


def disabled_pairs(srdf: Path) -> frozenset[frozenset[str]]:
    """Return the pairs of links whose collisions an SRDF disables; none where it cannot be read."""
    root = _root(srdf)
    pairs = () if root is None else root.iter("disable_collisions")
    return frozenset(frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs)
