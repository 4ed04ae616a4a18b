"""Kinematic tree of a URDF: one root, one parent for each link, no cycle, limited depth; poses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import make_pose
from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Element, finding, number, numbers

MAX_DEPTH = 1000
"""Limit of joints between the root and a link. Pinocchio's parser recurses; 20 000 joints crash it."""


class Edge(NamedTuple):
    """A joint between two links of the file.

    Attributes:
        joint: element of the joint.
        parent: name of its parent link, empty if the joint names none that exists.
        child: name of its child link.
        name: name of the joint.
        is_fixed: whether the joint is of type fixed.
    """

    joint: Element
    parent: str
    child: str
    name: str
    is_fixed: bool

    def pose(self, position: ArrayLike = 0.0) -> Array:
        """Return the pose of the child link in the parent link, shape (..., 4, 4).

        Args:
            position: position of the joint, rad or m, shape (...).
        """
        x, kind = np.asarray(position, dtype=np.float64), self.joint.get("type")
        X_motion = np.broadcast_to(np.eye(4), (*x.shape, 4, 4)).copy()
        if kind in ("revolute", "continuous", "prismatic"):
            e = np.array(numbers(self.joint.find("axis"), "xyz") or (1.0, 0.0, 0.0))
            e /= np.linalg.norm(e) or 1.0  # a zero axis is a finding of another check
            if kind == "prismatic":
                X_motion[..., :3, 3] = x[..., None] * e
            else:
                cross, x = np.cross(e, np.eye(3)).T, x[..., None, None]
                X_motion[..., :3, :3] += np.sin(x) * cross + (1.0 - np.cos(x)) * (cross @ cross)
        origin_pose: Array = pose_of(self.joint) @ X_motion
        return origin_pose


def pose_of(element: Element | None) -> Array:
    """Return the pose that the <origin> of an element states, shape (4, 4)."""
    origin = None if element is None else element.find("origin")
    return make_pose(*(numbers(origin, name) or np.zeros(3) for name in ("xyz", "rpy")))


class Mimic(NamedTuple):
    """Coupling of a joint to another: position = multiplier leader + offset.

    Attributes:
        leader: name of the joint that it follows.
        multiplier: factor.
        offset: rad or m.
    """

    leader: str
    multiplier: float
    offset: float


class Tree(NamedTuple):
    """Links and the joints between them.

    Attributes:
        links: the link elements that have a name, by name; the first of two with one name.
        above: the first parent joint of each link that has one.
        below: the child joints of each link that has any.
        findings: the defects of the tree.
    """

    links: dict[str, Element]
    above: dict[str, Edge]
    below: dict[str, list[Edge]]
    findings: list[UrdfFinding]

    def edges(self) -> Iterator[Edge]:
        """Yield the joints from the roots on as in Pinocchio's q: depth first, siblings by name."""
        waiting = [name for name in self.links if name not in self.above][::-1]
        while waiting:
            name = waiting.pop()
            if name in self.above:
                yield self.above[name]
            edges = sorted(self.below.get(name, ()), key=lambda edge: edge.name, reverse=True)
            waiting += [edge.child for edge in edges]

    def mimics(self) -> dict[str, Mimic]:
        """Return the couplings of the joints that follow others, by name."""
        couplings = {}
        for edge in self.edges():
            mimic = edge.joint.find("mimic")
            if not edge.is_fixed and mimic is not None:
                multiplier, offset = number(mimic, "multiplier"), number(mimic, "offset") or 0.0
                factor = 1.0 if multiplier is None else multiplier
                couplings[edge.name] = Mimic(str(mimic.get("joint")), factor, offset)
        return couplings

    def locked(self, joints: Mapping[str, float]) -> dict[str, float]:
        """Return the positions of locked joints and of joints that mimic them, directly or through others."""
        positions, mimics = dict(joints), self.mimics()
        for _ in mimics:
            for joint, (leader, multiplier, offset) in mimics.items():
                if leader in positions and joint not in positions:
                    positions[joint] = multiplier * positions[leader] + offset
        return positions

    def bodies(self, locked: Collection[str]) -> dict[str, str]:
        """Return the first link of the body that each link is part of, by link.

        Fixed and locked joints join links to one body.

        Args:
            locked: names of the locked joints.
        """
        first = {name: name for name in self.links}
        for edge in self.edges():
            if edge.is_fixed or edge.name in locked:
                first[edge.child] = first.get(edge.parent, edge.child)
        return first


def read_tree(robot: Element) -> Tree:
    """Return the kinematic tree of a robot, with its defects."""
    tree = Tree({}, {}, defaultdict(list), [])
    for link in robot.iterchildren("link"):
        if name := link.get("name"):
            tree.links.setdefault(name, link)
    for joint in robot.iterchildren("joint"):
        parent, child = (_end(joint, tag, tree) for tag in ("parent", "child"))
        edge = Edge(joint, parent, child, joint.get("name", ""), joint.get("type") == "fixed")
        if not edge.child:
            continue
        first = tree.above.setdefault(edge.child, edge)
        if first is not edge:
            names = f"{quoted(first.name)} (line {first.joint.sourceline}) and {quoted(edge.name)}"
            message = f"it is the child of two joints, {names}; remove one"
            tree.findings.append(finding(tree.links[edge.child], "two_parents", message, at=joint))
        elif edge.parent:
            tree.below[edge.parent].append(edge)
    tree.findings.extend((*_root_findings(robot, tree), *_cycle_findings(tree), *_depth_findings(tree)))
    return tree


def _end(joint: Element, tag: str, tree: Tree) -> str:
    """Return the link at one end of a joint; record a finding and return "" if it does not exist."""
    name = str(joint.xpath(f"string({tag}/@link)"))
    if name and name not in tree.links:
        message = f"its {tag} {quoted(name)} is not a link of the file; links: {listed(tree.links)}"
        tree.findings.append(finding(joint, f"unknown_{tag}", message, at=joint.find(tag)))
    return name if name in tree.links else ""


def _root_findings(robot: Element, tree: Tree) -> Iterator[UrdfFinding]:
    roots = [name for name in tree.links if name not in tree.above]
    if tree.links and not roots:
        message = "every link is the child of a joint; one link must be the root"
        yield finding(robot, "no_root", message)
    for name in roots[1:]:
        message = f"a second root besides {quoted(roots[0])}: no joint leads to it; connect it to the tree"
        yield finding(tree.links[name], "two_roots", message)


def _cycle_findings(tree: Tree) -> Iterator[UrdfFinding]:
    """Follow the parents of each link; a path that returns to one of its own links is a cycle."""
    path_of: dict[str, int] = {}
    for index, name in enumerate(tree.links):
        path: list[str] = []
        while name in tree.links and name not in path_of:
            path_of[name] = index
            path.append(name)
            name = tree.above[name].parent if name in tree.above else ""
        if path_of.get(name) == index:
            links = listed(path[path.index(name) :])
            message = f"the joints form a cycle through the links {links}; closed chains are made by the cell"
            yield finding(tree.above[name].joint, "cycle", message)


def _depth_findings(tree: Tree) -> Iterator[UrdfFinding]:
    depth: dict[str, int] = {}
    for edge in tree.edges():
        depth[edge.child] = depth.get(edge.parent, 0) + 1
        if depth[edge.child] == MAX_DEPTH + 1:
            message = f"more than {MAX_DEPTH} joints lie between the root and this one; Pinocchio would crash"
            yield finding(edge.joint, "depth", message)
