"""Kinematic tree of a URDF: one root, one parent for each link, no cycle, limited depth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.xml import Node

MAX_DEPTH = 1000
"""Limit of joints between the root and a link. Pinocchio's parser recurses; 20 000 joints crash it."""


class Edge(NamedTuple):
    """A joint between two links of the file.

    Attributes:
        joint: its element.
        parent: name of its parent link, empty if the joint names none that exists.
        child: name of its child link.
    """

    joint: Node
    parent: str
    child: str

    @property
    def is_fixed(self) -> bool:
        """Whether the joint is of type fixed."""
        return self.joint.attributes.get("type") == "fixed"


class Tree(NamedTuple):
    """Links and the joints between them.

    Attributes:
        links: the link elements that have a name, by name; the first of two with one name.
        above: the first parent joint of each link that has one.
        below: the child joints of each link that has any.
        findings: the defects of the tree.
    """

    links: dict[str, Node]
    above: dict[str, Edge]
    below: dict[str, list[Edge]]
    findings: tuple[UrdfFinding, ...]


def read_tree(robot: Node) -> Tree:
    """Return the kinematic tree of a robot, with its defects."""
    links: dict[str, Node] = {}
    for node in robot.children:
        if node.tag == "link" and node.name:
            links.setdefault(node.name, node)
    tree = Tree(links, {}, defaultdict(list), ())
    findings: list[UrdfFinding] = []
    for joint in (node for node in robot.children if node.tag == "joint"):
        parent, child = (_end(joint, tag, links, findings) for tag in ("parent", "child"))
        if not child:
            continue
        edge = Edge(joint, parent, child)
        first = tree.above.setdefault(child, edge)
        if first is not edge:
            names = f"{quoted(first.joint.name)} (line {first.joint.line}) and {quoted(joint.name)}"
            message = f"it is the child of two joints, {names}; remove one"
            findings.append(links[child].finding("two_parents", message, at=joint))
        elif parent:
            tree.below[parent].append(edge)
    findings += [*_root_findings(robot, tree), *_cycle_findings(tree), *_depth_findings(tree)]
    return tree._replace(findings=tuple(findings))


def _end(joint: Node, tag: str, links: dict[str, Node], findings: list[UrdfFinding]) -> str:
    """Return the link at one end of a joint; record a finding and return "" if there is none."""
    node = joint.child(tag)
    name = "" if node is None else node.attributes.get("link", "")
    if name in links:
        return name
    code, message = f"no_{tag}", f"the joint names no {tag}; add <{tag} link=...>"
    if name:
        code = f"unknown_{tag}"
        message = f"its {tag} {quoted(name)} is not a link of the file; links: {listed(links)}"
    findings.append(joint.finding(code, message, at=node))
    return ""


def _root_findings(robot: Node, tree: Tree) -> Iterator[UrdfFinding]:
    roots = [name for name in tree.links if name not in tree.above]
    if tree.links and not roots:
        yield robot.finding("no_root", "every link is the child of a joint; one link must be the root")
    for name in roots[1:]:
        message = f"a second root besides {quoted(roots[0])}: no joint leads to it; connect it to the tree"
        yield tree.links[name].finding("two_roots", message)


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
            yield tree.above[name].joint.finding("cycle", message)


def _depth_findings(tree: Tree) -> Iterator[UrdfFinding]:
    level = [name for name in tree.links if name not in tree.above]
    for _ in range(MAX_DEPTH):
        level = [edge.child for name in level for edge in tree.below.get(name, ())]
    for edge in (edge for name in level for edge in tree.below.get(name, ())):
        message = f"more than {MAX_DEPTH} joints lie between the root and this one; Pinocchio would crash"
        yield edge.joint.finding("depth", message)
