"""Kinematic tree of a URDF: one root, one parent for each link, no cycle, limited depth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Element, finding

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
