"""Kinematics of a URDF without Pinocchio: joint order, mimic joints, link poses; links as of yourdfpy.

yourdfpy gives the bodies; it is imported only for them, because that takes longer than a model.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array
from coop_pin.base.errors import NameNotFoundError
from coop_pin.description.urdf.tree import Edge, read_tree
from coop_pin.description.urdf.xml import number, read_document

_READABLE = "geometry/*[1][self::box or self::cylinder or self::sphere or self::mesh]"
"""XPath of the shapes of a visual; yourdfpy fails on others and on none."""

_GRIPPER = ("gripper", "finger", "jaw")
"""Words in the names of a gripper's joints."""
_FINGER = 0.2
"""Longest finger, m: two or more joints on one body that move no more are those of a hand."""
_NO_ARM = {"hip", "knee", "ankle", "foot", "wheel", "head", "neck"}
"""Words in the names of joints that move no arm."""
_SENSORS = {"camera", "realsense", "optical", "imu", "laser", "sensor"}
"""Words in the names of links that hold nothing."""
_TOOLS = ("tcp", "tool", "end_effector", "eef", "flange", "gripper")
"""Words in the names of frames made for tools, the best first."""


class Robot:
    """Kinematics of a URDF, without Pinocchio.

    Attributes:
        joints: type of every joint that is not fixed, by name, in the order of Pinocchio's q: depth first,
            siblings by name.
        links: names of the links.
        leaves: the links without child joints.
        mimics: leader, multiplier and offset (rad or m) of the mimic joints by name.
    """

    def __init__(self, text: str) -> None:
        """Read the text of a URDF as load_checked returns it."""
        self._root = read_document(text.encode())
        self._tree = read_tree(self._root)
        self._edges = list(self._tree.edges())
        self.joints = {edge.name: edge.joint.get("type") for edge in self._edges if not edge.is_fixed}
        self.links = tuple(self._tree.links)
        self.leaves = tuple(link for link in self.links if not self._tree.below.get(link))
        self.mimics = self._tree.mimics()

    def locked(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Return the angles of locked joints and of joints that mimic them, directly or through others."""
        return self._tree.locked(joints)

    def unlocked(self, joints: Mapping[str, float]) -> tuple[str, ...]:
        """Return the joints that still move when some are locked."""
        locked = self.locked(joints)
        return tuple(joint for joint in self.joints if joint not in locked)

    def limits(self, joint: str) -> tuple[float, float]:
        """Return the limits of a moving joint, rad or m; those of a continuous one are infinite."""
        (edge,) = (edge for edge in self._edges if edge.name == joint)
        limit = edge.joint.find("limit")
        if edge.joint.get("type") == "continuous":
            return -math.inf, math.inf
        return number(limit, "lower") or 0.0, number(limit, "upper") or 0.0

    def tools(self) -> tuple[str, ...]:
        """Return the links that most joints of an arm move, one for each body; several if names do not tell.

        Joints of grippers, hands, legs and heads are no arm's, and sensors no tools. Of several links those
        whose name has the first of the words tcp, tool, end_effector, eef, flange and gripper, and of those
        on one body the farthest from its joint: of a robot with several arms one for each.
        """
        moved, gripper = dict.fromkeys(self._tree.links, 0), set[str]()  # numbers of joints; its links
        fingers = self._fingers()
        for edge in self._edges:
            name = edge.name.lower()
            if edge.parent in gripper or edge.name in fingers or any(word in name for word in _GRIPPER):
                gripper.add(edge.child)
            is_beyond = not edge.is_fixed and (edge.child in gripper or bool(_words(edge.name) & _NO_ARM))
            if edge.parent in moved and not is_beyond:
                moved[edge.child] = moved[edge.parent] + (not edge.is_fixed)
            else:
                moved.pop(edge.child, None)
        seeing = {link for link in self.leaves if _words(link) & _SENSORS}
        bodies_left = {self.movers(link) for link in moved if link not in seeing}
        moved = {
            link: joints
            for link, joints in moved.items()
            if not (link in seeing and self.movers(link) in bodies_left)
        }
        held = {link: joints for link, joints in moved.items() if link not in gripper or link in self.leaves}
        inner = {edge.parent for edge in self._edges if edge.child in held}
        ends = [link for link in held if link not in inner and held[link] == max(held.values())]
        named = ([link for link in ends if word in link.lower()] for word in _TOOLS)
        bodies = dict[tuple[str, ...], list[str]]()
        for link in next(filter(None, named), ends):
            bodies.setdefault(self.movers(link), []).append(link)
        return tuple(self._farthest(joints, links) for joints, links in bodies.items())

    def _farthest(self, joints: Sequence[str], links: Sequence[str]) -> str:
        """Return the link of a body that is farthest from its joint."""
        origin = self.pose(joints[-1], {})[:3, 3] if joints else np.zeros(3)
        return max(links, key=lambda link: round(math.dist(self.pose(link, {})[:3, 3], origin), 6))

    def _fingers(self) -> set[str]:
        """Return the joints on bodies that have two or more of them, of which none moves anything far."""
        X, body = dict.fromkeys(self._tree.links, np.eye(4)), dict.fromkeys(self._tree.links, "")
        starts, on_body, reach = dict[str, Array](), dict[str, list[str]](), dict.fromkeys(self.joints, 0.0)
        for edge in self._edges:
            X[edge.child] = X[edge.parent] @ edge.pose()
            body[edge.child], starts[edge.name] = body[edge.parent], X[edge.child][:3, 3]
            if not edge.is_fixed:
                on_body.setdefault(body[edge.parent], []).append(edge.name)
                body[edge.child] = edge.child
            for joint in self.movers(edge.child):
                reach[joint] = max(reach[joint], math.dist(X[edge.child][:3, 3], starts[joint]))
        on_body.pop("", None)  # of the root
        hands = [names for names in on_body.values() if len(names) > 1]
        return {name for names in hands if all(reach[each] < _FINGER for each in names) for name in names}

    def movers(self, link: str) -> tuple[str, ...]:
        """Return the joints that move a link, from the root on; empty if there is no such link."""
        joints = []
        while link in self._tree.above:
            edge = self._tree.above[link]
            joints.append(edge.name)
            link = edge.parent
        return tuple(joint for joint in joints[::-1] if joint in self.joints)

    def idle(self, tip: str, others: Sequence[str] = ()) -> dict[str, float]:
        """Return the joints that do not move a link alone, with their angles nearest to zero, rad or m.

        Joints that mimic others are left out.

        Args:
            tip: the link.
            others: links of which none is moved by a joint that is left moving.

        Raises:
            NameNotFoundError: there is no such link.
        """
        for link in (tip, *others):
            if link not in self._tree.links:
                raise NameNotFoundError("link", link, self._tree.links, "the URDF")
        moving = {*self.movers(tip)} - {joint for other in others for joint in self.movers(other)}
        idle = [edge for edge in self._edges if edge.name in self.joints and edge.name not in moving]
        return {edge.name: _nearest_to_zero(edge) for edge in idle if edge.name not in self.mimics}

    def summary(self) -> str:
        """Return links with their masses, joints with their limits, and candidate tips as text."""
        tree, above = self._tree, dict.fromkeys(self._tree.links, 0)
        for edge in self._edges:
            above[edge.child] = above[edge.parent] + (not edge.is_fixed)
        masses = {
            name: number(link.find("inertial/mass"), "value") or 0.0 for name, link in tree.links.items()
        }
        branching = [link for link in tree.above if len(tree.below.get(link, ())) > 1]
        return "\n".join(
            (
                f"{len(tree.links)} links, {sum(masses.values()):.4g} kg: "
                + ", ".join(f"{link} ({mass:.4g} kg)" if mass else link for link, mass in masses.items()),
                f"{len(self.joints)} moving joints:",
                *(f"  {edge.name}: {_joint_text(edge)}" for edge in self._edges if not edge.is_fixed),
                "candidate tips:",
                *(f"  {tip}: {above[tip]} joints from the root" for tip in (*self.leaves, *branching)),
            )
        )

    def pose(self, frame: str, angles: Mapping[str, ArrayLike]) -> Array:
        """Return the pose of a link, or of the child link of a joint, in the root link, shape (..., 4, 4).

        Args:
            frame: name of the link or joint.
            angles: angles of the moving joints, rad or m, shape (...) each; zero when omitted.

        Raises:
            NameNotFoundError: there is no such link or joint.
        """
        ends = {edge.name: edge.child for edge in self._edges} | {link: link for link in self._tree.links}
        if frame not in ends:
            raise NameNotFoundError("frame", frame, ends, "the URDF")
        X, link = np.eye(4), ends[frame]
        while link in self._tree.above:
            edge = self._tree.above[link]
            X, link = edge.pose(angles.get(edge.name, 0.0)) @ X, edge.parent
        return X


def links_of(text: str) -> list[Any]:
    """Return the links of a URDF that load_checked returns, as yourdfpy's."""
    import yourdfpy

    readable = read_document(text.encode())  # without what yourdfpy cannot read
    etree.strip_elements(readable, "collision", "material", with_tail=False)
    for visual in readable.xpath(f"link/visual[not({_READABLE})]"):
        visual.getparent().remove(visual)
    file = io.BytesIO(etree.tostring(readable, encoding="utf-8"))
    return list(yourdfpy.URDF.load(file, build_scene_graph=False, load_meshes=False).robot.links)


def _nearest_to_zero(edge: Edge) -> float:
    limit = edge.joint.find("limit")
    lower, upper = (number(limit, name) or 0.0 for name in ("lower", "upper"))
    return 0.0 if edge.joint.get("type") == "continuous" else min(max(0.0, lower), upper)


def _joint_text(edge: Edge) -> str:
    """Return type, links and limits of a moving joint; Pinocchio reads a missing limit as zero."""
    kind, limit, mimic = edge.joint.get("type"), edge.joint.find("limit"), edge.joint.find("mimic")
    unit, effort_unit = ("m", "N") if kind == "prismatic" else ("rad", "N m")
    lower, upper, velocity, effort = (
        number(limit, name) or 0.0 for name in ("lower", "upper", "velocity", "effort")
    )
    span = "without limits" if kind == "continuous" else f"{lower:.4g} .. {upper:.4g} {unit}"
    speed = f"speed up to {velocity:.4g} {unit}/s" if velocity else "any speed"
    torque = f"torque up to {effort:.4g} {effort_unit}" if effort else "effort not stated"
    leader = "" if mimic is None else f", mimics {mimic.get('joint')}"
    return f"{kind}, {edge.parent} to {edge.child}, {span}, {speed}, {torque}{leader}"


def _words(name: str) -> set[str]:
    """Return the words of a name, such as "left_hip_2", "LHipPitch" or "lhip", in small letters."""
    words = {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}
    return words | {word[1:] for word in words if word[0] in "lr"}
