"""The robot of a checked URDF: its joints in Pinocchio's order, the links at its ends, and where a link is at given angles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array
from coop_pin.description.urdf.numbers import number, numbers
from coop_pin.description.urdf.tree import Edge, Tree, read_tree
from coop_pin.description.urdf.xml import Node, read_document
from coop_pin.errors import FrameNotFoundError
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
        joints: type of every joint that is not fixed, by name, in the order of Pinocchio's q: depth first, siblings by name.
        leaves: the links that carry no other.
        mimics: the joints that follow others, by name.
    """

    def __init__(self, text: str) -> None:
        """Read URDF text as load_checked returns it."""
        root = read_document(text.encode()).robot
        assert root is not None
        self._tree = read_tree(root)
        every = [edge.joint for edge in _depth_first(self._tree)]
        self.joints = {joint.name: joint.attributes["type"] for joint in every if joint.attributes["type"] != "fixed"}
        self.leaves = tuple(link for link in self._tree.links if not self._tree.below.get(link))
        self.mimics = {joint.name: _mimic(node) for joint in every if (node := joint.child("mimic")) is not None}
        self._ends = {edge.joint.name: edge.child for edge in _depth_first(self._tree)} | {link: link for link in self._tree.links}

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
            FrameNotFoundError: there is no such link or joint.
        """
        if frame not in self._ends:
            raise FrameNotFoundError("frame", frame, self._ends, "the URDF")
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
    return Mimic(node.attributes["joint"], 1.0 if multiplier is None else multiplier, 0.0 if offset is None else offset)


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
