"""The kinematic tree of a URDF: one root, one parent for each link, no cycle, not too deep."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

from coop_pin.description.urdf.report import UrdfFinding, listed, quoted, structural
from coop_pin.description.urdf.xml import Node

MAX_DEPTH = 1000
"""Most joints between the root and a link. Pinocchio's reader recurses: 20 000 of them end the process."""


class Edge(NamedTuple):
    """A joint between two links of the file.

    Attributes:
        joint: its element.
        parent: name of the link above, empty where the joint names none that exists.
        child: name of the link below.
    """

    joint: Node
    parent: str
    child: str


class Tree(NamedTuple):
    """Links and the joints between them.

    Attributes:
        links: the link elements that have a name, by name; of two with one name the first.
        above: for each link that has one, its first parent joint.
        below: for each link that has them, the joints that lead on from it.
        findings: what is wrong with it.
    """

    links: dict[str, Node]
    above: dict[str, Edge]
    below: dict[str, list[Edge]]
    findings: tuple[UrdfFinding, ...]


def read_tree(robot: Node) -> Tree:
    """Return the kinematic tree of a robot, with everything that makes it none."""
    findings: list[UrdfFinding] = []
    links: dict[str, Node] = {}
    for node in robot.children:
        if node.tag == "link" and node.name:
            links.setdefault(node.name, node)
    above: dict[str, Edge] = {}
    below: dict[str, list[Edge]] = defaultdict(list)
    for joint in (node for node in robot.children if node.tag == "joint"):
        ends = [_end(joint, tag, links, findings) for tag in ("parent", "child")]
        if ends[1] is None:
            continue
        edge = Edge(joint, ends[0] or "", ends[1])
        first = above.setdefault(edge.child, edge)
        if first is not edge:
            message = f"two joints end at it, {quoted(first.joint.name)} (line {first.joint.line}) and {quoted(joint.name)}; remove one"
            findings.append(structural("two_parents", links[edge.child].label, joint.line, message))
        elif edge.parent in links:
            below[edge.parent].append(edge)
    findings += _root_findings(robot, links, above)
    findings += _cycle_findings(links, above)
    findings += _depth_findings(links, above, below)
    return Tree(links, above, dict(below), tuple(findings))


def _end(joint: Node, tag: str, links: dict[str, Node], findings: list[UrdfFinding]) -> str | None:
    """Return the link at one end of a joint, or None, and record what is wrong with it."""
    node = joint.child(tag)
    name = None if node is None else node.attributes.get("link")
    if not name:
        line = joint.line if node is None else node.line
        findings.append(
            structural(f"no_{tag}", joint.label, line, f"the joint names no {tag}; add <{tag} link=...>")
        )
        return None
    if name not in links:
        line = joint.line if node is None else node.line
        message = f"its {tag} {quoted(name)} is no link of the file; links: {listed(links)}"
        findings.append(structural(f"unknown_{tag}", joint.label, line, message))
        return None
    return name


def _root_findings(robot: Node, links: dict[str, Node], above: dict[str, Edge]) -> Iterator[UrdfFinding]:
    roots = [name for name in links if name not in above]
    if links and not roots:
        yield structural(
            "no_root",
            robot.label,
            robot.line,
            "every link is the child of a joint; one link must be the root",
        )
    for name in roots[1:]:
        node = links[name]
        message = f"a second root beside {quoted(roots[0])}: no joint leads to it; join it to the tree"
        yield structural("two_roots", node.label, node.line, message)


def _cycle_findings(links: dict[str, Node], above: dict[str, Edge]) -> Iterator[UrdfFinding]:
    """Follow the parents of each link; a walk that meets itself has gone around a cycle."""
    walk_of: dict[str, int] = {}
    for walk, start in enumerate(links):
        path: list[str] = []
        name = start
        while name in links and name not in walk_of:
            walk_of[name] = walk
            path.append(name)
            name = above[name].parent if name in above else ""
        if name in links and walk_of[name] == walk:
            cycle = path[path.index(name) :]
            joint = above[name].joint
            message = f"the joints go in a cycle through the links {listed(cycle)}; a closed chain is made by the cell, not by the URDF"
            yield structural("cycle", joint.label, joint.line, message)


def _depth_findings(
    links: dict[str, Node], above: dict[str, Edge], below: dict[str, list[Edge]]
) -> Iterator[UrdfFinding]:
    level = [name for name in links if name not in above]
    for _ in range(MAX_DEPTH):
        level = [edge.child for name in level for edge in below.get(name, ())]
    for edge in (edge for name in level for edge in below.get(name, ())):
        message = f"more than {MAX_DEPTH} joints lie between the root and this one; Pinocchio would overflow its stack"
        yield structural("depth", edge.joint.label, edge.joint.line, message)
