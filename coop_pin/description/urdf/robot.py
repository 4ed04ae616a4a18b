"""The robot of a checked URDF: its joints in Pinocchio's order, the links at its ends, and where a link is at given angles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.urdf.report import listed
from coop_pin.description.urdf.tree import Edge, Tree, read_tree
from coop_pin.description.urdf.xml import Node, number, numbers, read_document
from coop_pin.errors import NameNotFoundError, UrdfError
from coop_pin.spatial import make_pose

_ZERO = (0.0, 0.0, 0.0)
_X_AXIS = (1.0, 0.0, 0.0)


class Mimic(NamedTuple):
    """A joint that follows another one: angle = multiplier * leader's angle + offset.

    Attributes:
        leader: the joint that it follows.
        multiplier: of the leader's angle.
        offset: rad or m.
    """

    leader: str
    multiplier: float
    offset: float


class Robot:
    """The kinematics of a URDF, without Pinocchio.

    Attributes:
        joints: type of every joint that is not fixed, by name, in the order of Pinocchio's q: depth first,
            siblings by name.
        leaves: the links that carry no other.
        mimics: the joints that follow others, by name.
    """

    def __init__(self, text: str) -> None:
        """Read URDF text as load_checked returns it."""
        root = read_document(text.encode()).robot
        assert root is not None
        self._tree = read_tree(root)
        every = [edge.joint for edge in _depth_first(self._tree)]
        self.joints = {
            joint.name: joint.attributes["type"] for joint in every if joint.attributes["type"] != "fixed"
        }
        self.leaves = tuple(link for link in self._tree.links if not self._tree.below.get(link))
        self.mimics = {
            joint.name: _mimic(node) for joint in every if (node := joint.child("mimic")) is not None
        }
        self._ends = {edge.joint.name: edge.child for edge in _depth_first(self._tree)} | {
            link: link for link in self._tree.links
        }

    def locked(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of locked joints and of those that mimic them, directly or along a chain of others."""
        angles = dict(joints)
        for _ in self.mimics:
            for joint, mimic in self.mimics.items():
                if mimic.leader in angles and joint not in angles:
                    angles[joint] = mimic.multiplier * angles[mimic.leader] + mimic.offset
        return angles

    def unlocked(self, joints: Mapping[str, float]) -> tuple[str, ...]:
        """Return the joints that move when some are locked."""
        locked = self.locked(joints)
        return tuple(joint for joint in self.joints if joint not in locked)

    def pose(self, frame: str, angles: Mapping[str, float]) -> Array:
        """Return the pose of a link, or of the link behind a joint, in the root link, shape (4, 4).

        Args:
            frame: name of the link or joint.
            angles: of the moving joints between the root and it, rad or m.

        Raises:
            NameNotFoundError: there is no such link or joint.
        """
        if frame not in self._ends:
            raise NameNotFoundError("frame", frame, self._ends, "the URDF")
        X, link = np.eye(4), self._ends[frame]
        while link in self._tree.above:
            edge = self._tree.above[link]
            X = _origin(edge.joint) @ _motion(edge.joint, angles) @ X
            link = edge.parent
        return X


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
    multiplier, offset = number(node, "multiplier"), number(node, "offset")
    return Mimic(
        node.attributes["joint"], 1.0 if multiplier is None else multiplier, 0.0 if offset is None else offset
    )


def _origin(joint: Node) -> Array:
    origin = joint.child("origin")
    return make_pose(numbers(origin, "xyz") or _ZERO, numbers(origin, "rpy") or _ZERO)


def _motion(joint: Node, angles: Mapping[str, float]) -> Array:
    """Return the pose of a joint's child at its angle, seen from where the child is at zero."""
    X, kind = np.eye(4), joint.attributes["type"]
    if kind == "fixed":
        return X
    axis = np.array(numbers(joint.child("axis"), "xyz") or _X_AXIS)
    along = angles[joint.name] * axis / np.linalg.norm(axis)
    if kind == "prismatic":
        X[:3, 3] = along
    else:
        X[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    return X


_ORIGIN = (0.0, 0.0, 0.0)


class LinkBody(NamedTuple):
    """A link seen from its centre of mass, in the link's axes.

    Attributes:
        mass: kg.
        inertia: ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, kg m^2.
        size: edges of the box around its shape, m.
        shape: what its first visual is.
        X_PS: pose of the shape in the frame at the centre of mass, shape (4, 4).
    """

    mass: float
    inertia: tuple[float, ...]
    size: tuple[float, float, float]
    shape: Literal["box", "cylinder"]
    X_PS: Array


def link_body(text: str, source: str) -> LinkBody:
    """Return the body of a URDF's only link.

    Args:
        text: checked URDF.
        source: its name, for messages.

    Raises:
        UrdfError: it has more than one link, or the link has no mass.
    """
    robot = read_document(text.encode()).robot
    assert robot is not None
    links = [node for node in robot.children if node.tag == "link"]
    if len(links) != 1:
        raise UrdfError(
            f"{source} has {len(links)} links, {listed(link.name for link in links)}; a payload is a single one"
        )
    inertial = links[0].child("inertial")
    mass = None if inertial is None else number(inertial.child("mass"), "value")
    if inertial is None or not mass:
        raise UrdfError(f"link {links[0].name!r} of {source} has no mass; a payload must have one")
    X_LI = _pose(inertial)
    return LinkBody(mass, _inertia(inertial, X_LI), *_shape(links[0], X_LI[:3, 3]))


def _inertia(inertial: Node, X_LI: Array) -> tuple[float, ...]:
    """Return the inertia turned into the link's axes."""
    node = inertial.child("inertia")
    xx, yy, zz, xy, xz, yz = (
        number(node, name) or 0.0 for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    R = X_LI[:3, :3]
    M = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return (M[0, 0], M[1, 1], M[2, 2], M[0, 1], M[0, 2], M[1, 2])


def _shape(link: Node, centre: Array) -> tuple[tuple[float, float, float], Literal["box", "cylinder"], Array]:
    """Return size, kind and pose of the first visual; a small box at the centre of mass where it is neither box nor cylinder."""
    visual = link.child("visual")
    geometry = None if visual is None else visual.child("geometry")
    X_PS = np.eye(4) if visual is None else _pose(visual)
    X_PS[:3, 3] -= centre if visual is not None else 0.0
    box, cylinder = (None, None) if geometry is None else (geometry.child("box"), geometry.child("cylinder"))
    edges, radius, length = numbers(box, "size"), number(cylinder, "radius"), number(cylinder, "length")
    if edges is not None:
        return (edges[0], edges[1], edges[2]), "box", X_PS
    if radius is not None and length is not None:
        return (2.0 * radius, 2.0 * radius, length), "cylinder", X_PS
    return (0.1, 0.1, 0.1), "box", np.eye(4)


def _pose(owner: Node) -> Array:
    origin = owner.child("origin")
    return make_pose(numbers(origin, "xyz") or _ORIGIN, numbers(origin, "rpy") or _ORIGIN)
