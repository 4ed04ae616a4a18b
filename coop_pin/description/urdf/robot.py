"""Kinematics of a URDF without Pinocchio: joint order, mimic joints, link poses; body of a single link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.urdf.inertia import inertia_matrix
from coop_pin.description.urdf.meshes import meshes
from coop_pin.description.urdf.numbers import number, numbers
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.tree import Edge, Tree, read_tree
from coop_pin.description.urdf.xml import Node, read_document
from coop_pin.errors import NameNotFoundError, UrdfError
from coop_pin.spatial import make_pose

_ZERO = (0.0, 0.0, 0.0)
_X_AXIS = (1.0, 0.0, 0.0)


class Mimic(NamedTuple):
    """A mimic joint: angle = multiplier * (angle of the leader) + offset.

    Attributes:
        leader: name of the joint that it follows.
        multiplier: factor of the leader's angle.
        offset: rad or m.
    """

    leader: str
    multiplier: float
    offset: float


class Robot:
    """Kinematics of a URDF, without Pinocchio.

    Attributes:
        joints: type of every joint that is not fixed, by name, in the order of Pinocchio's q: depth first,
            siblings by name.
        leaves: the links without child joints.
        mimics: the mimic joints by name.
    """

    def __init__(self, text: str) -> None:
        """Read the text of a URDF as load_checked returns it."""
        self._root = _root(text)
        self._tree = read_tree(self._root)
        edges = _depth_first(self._tree)
        self.joints = {edge.joint.name: edge.joint.attributes["type"] for edge in edges if not edge.is_fixed}
        self.leaves = tuple(link for link in self._tree.links if not self._tree.below.get(link))
        self.mimics = {edge.joint.name: _mimic(node) for edge in edges if (node := edge.joint.child("mimic"))}
        self._ends = {edge.joint.name: edge.child for edge in edges} | {
            link: link for link in self._tree.links
        }

    def mesh_files(self, package_dirs: Sequence[Path]) -> list[Path]:
        """Return the files of the visuals that are meshes, those that exist."""
        return [path for _, _, path in meshes(self._root, package_dirs) if path is not None]

    def locked(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of locked joints and of joints that mimic them, directly or through others."""
        angles = dict(joints)
        for _ in self.mimics:
            for joint, mimic in self.mimics.items():
                if mimic.leader in angles and joint not in angles:
                    angles[joint] = mimic.multiplier * angles[mimic.leader] + mimic.offset
        return angles

    def unlocked(self, joints: Mapping[str, float]) -> tuple[str, ...]:
        """Return the joints that still move when some are locked."""
        locked = self.locked(joints)
        return tuple(joint for joint in self.joints if joint not in locked)

    def summary(self) -> str:
        """Return links, joints with their limits, and candidate tips as text."""
        links, edges = list(self._tree.links), _depth_first(self._tree)
        moving = [edge for edge in edges if not edge.is_fixed]
        return "\n".join(
            (
                f"{len(links)} links: {', '.join(links)}",
                f"{len(moving)} moving joints:",
                *(f"  {edge.joint.name}: {_joint_text(edge)}" for edge in moving),
                "candidate tips:",
                *(f"  {tip}: {self._joints_above(tip)} joints from the root" for tip in self._tips()),
            )
        )

    def _tips(self) -> list[str]:
        """Return the links at which the tree ends, and those below a joint at which it branches."""
        branching = [link for link in self._tree.above if len(self._tree.below.get(link, ())) > 1]
        return [*self.leaves, *branching]

    def _joints_above(self, link: str) -> int:
        count = 0
        while link in self._tree.above:
            edge = self._tree.above[link]
            count, link = count + (not edge.is_fixed), edge.parent
        return count

    def pose(self, frame: str, angles: Mapping[str, float]) -> Array:
        """Return the pose of a link, or of the child link of a joint, in the root link, shape (4, 4).

        Args:
            frame: name of the link or joint.
            angles: angles of the moving joints between the root and it, rad or m.

        Raises:
            NameNotFoundError: there is no such link or joint.
        """
        if frame not in self._ends:
            raise NameNotFoundError("frame", frame, self._ends, "the URDF")
        X, link = np.eye(4), self._ends[frame]
        while link in self._tree.above:
            edge = self._tree.above[link]
            X = _origin(edge.joint) @ _motion(edge, angles) @ X
            link = edge.parent
        return X


def _root(text: str) -> Node:
    root = read_document(text.encode())
    assert isinstance(root, Node)
    return root


def _depth_first(tree: Tree) -> list[Edge]:
    found: list[Edge] = []
    waiting = [edge for link in tree.links if link not in tree.above for edge in _last_name_first(tree, link)]
    while waiting:
        found.append(waiting.pop())
        waiting += _last_name_first(tree, found[-1].child)
    return found


def _last_name_first(tree: Tree, link: str) -> list[Edge]:
    return sorted(tree.below.get(link, ()), key=lambda edge: edge.joint.name, reverse=True)


def _mimic(node: Node) -> Mimic:
    multiplier = number(node, "multiplier")
    return Mimic(
        node.attributes["joint"], 1.0 if multiplier is None else multiplier, number(node, "offset") or 0.0
    )


def _joint_text(edge: Edge) -> str:
    """Return type, links and limits of a moving joint; Pinocchio reads a missing limit as zero."""
    kind, limit = edge.joint.attributes["type"], edge.joint.child("limit")
    unit, effort_unit = ("m", "N") if kind == "prismatic" else ("rad", "N m")
    lower, upper, velocity, effort = (
        number(limit, name) or 0.0 for name in ("lower", "upper", "velocity", "effort")
    )
    span = "without limits" if kind == "continuous" else f"{lower:.4g} .. {upper:.4g} {unit}"
    speed = f"speed up to {velocity:.4g} {unit}/s" if velocity else "any speed"
    torque = f"torque up to {effort:.4g} {effort_unit}" if effort else "any torque"
    mimic = edge.joint.child("mimic")
    leader = "" if mimic is None else f", mimics {mimic.attributes['joint']}"
    return f"{kind}, {edge.parent} to {edge.child}, {span}, {speed}, {torque}{leader}"


def _origin(owner: Node) -> Array:
    origin = owner.child("origin")
    return make_pose(numbers(origin, "xyz") or _ZERO, numbers(origin, "rpy") or _ZERO)


def _motion(edge: Edge, angles: Mapping[str, float]) -> Array:
    """Return the pose of a joint's child at its angle in the child's frame at angle zero, shape (4, 4)."""
    X = np.eye(4)
    if edge.is_fixed:
        return X
    axis = np.array(numbers(edge.joint.child("axis"), "xyz") or _X_AXIS)
    along = angles[edge.joint.name] * axis / np.linalg.norm(axis)
    if edge.joint.attributes["type"] == "prismatic":
        X[:3, 3] = along
    else:
        X[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    return X


class LinkBody(NamedTuple):
    """Mass, inertia and shape of a link about its centre of mass, in the axes of the link.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, kg m^2.
        size: edges of the box around its shape, m.
        shape: shape of its first visual.
        X_PS: pose of the shape in the frame at the centre of mass, shape (4, 4).
    """

    mass: float
    inertia: tuple[float, ...]
    size: tuple[float, float, float]
    shape: Literal["box", "cylinder"]
    X_PS: Array


def link_body(text: str, source: str) -> LinkBody:
    """Return the body of the only link of a URDF.

    Args:
        text: the URDF, as ``load_checked(..., strict=True)`` returns it.
        source: its name, for messages.

    Raises:
        UrdfError: it has more than one link, or the link has no mass.
    """
    links = [node for node in _root(text).children if node.tag == "link"]
    if len(links) != 1:
        names = listed(link.name for link in links)
        raise UrdfError(f"{source} has {len(links)} links, {names}; a payload must be a single link")
    inertial = links[0].child("inertial")
    mass = None if inertial is None else number(inertial.child("mass"), "value")
    if inertial is None or not mass:
        raise UrdfError(f"link {links[0].name!r} of {source} has no mass; a payload must have one")
    X_LI = _origin(inertial)
    R = X_LI[:3, :3]
    M = R @ inertia_matrix(inertial.child("inertia")) @ R.T
    inertia = (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])
    return LinkBody(mass, inertia, *_shape(links[0], X_LI[:3, 3]))


def _shape(link: Node, centre: Array) -> tuple[tuple[float, float, float], Literal["box", "cylinder"], Array]:
    """Return size, kind and pose of the first visual; a small box at the centre of mass for other shapes."""
    visual = link.child("visual")
    geometry = None if visual is None else visual.child("geometry")
    if visual is None or geometry is None:
        return (0.1, 0.1, 0.1), "box", np.eye(4)
    X_PS = _origin(visual)
    X_PS[:3, 3] -= centre
    edges, cylinder = numbers(geometry.child("box"), "size"), geometry.child("cylinder")
    radius, length = number(cylinder, "radius"), number(cylinder, "length")
    if edges is not None:
        return (edges[0], edges[1], edges[2]), "box", X_PS
    if radius is not None and length is not None:
        return (2.0 * radius, 2.0 * radius, length), "cylinder", X_PS
    return (0.1, 0.1, 0.1), "box", np.eye(4)
