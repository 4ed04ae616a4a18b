"""Links and joints one by one: names, types, axes, limits, and elements that are missing or given twice."""

from __future__ import annotations

from collections.abc import Iterator

from coop_pin.description.urdf.doubtful import unit_findings
from coop_pin.description.urdf.numbers import is_unexpanded, number, number_findings, numbers
from coop_pin.description.urdf.report import EXPAND, UrdfFinding, quoted, structural
from coop_pin.description.urdf.xml import Node

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""The joint types of URDF."""

_PINOCCHIO_ROOT = "universe"
_ONCE = frozenset({"inertial", "origin", "mass", "inertia", "geometry", "parent", "child", "axis", "limit", "mimic", "dynamics"})
_REQUIRED = {
    "limit": ("effort", "velocity"),
    "safety_controller": ("k_velocity",),
    "mimic": ("joint",),
    "mesh": ("filename",),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
}
_NOT_NEGATIVE = {"limit": ("effort", "velocity"), "dynamics": ("damping", "friction")}


def element_findings(robot: Node) -> Iterator[UrdfFinding]:
    """Yield what is wrong within the single links and joints of a robot."""
    if not robot.name:
        yield structural("name", robot.label, robot.line, "<robot> has no name; add name=...")
    if robot.child("link") is None:
        yield structural("no_links", robot.label, robot.line, "the robot has no links")
    yield from _name_findings(robot)
    joint_names = {node.name for node in robot.children if node.tag == "joint"}
    for node in robot.children:
        yield from _content_findings(node)
        yield from number_findings(node)
        if node.tag == "joint":
            yield from _joint_findings(node)
            yield from _mimic_findings(node, joint_names)
            yield from unit_findings(node)


def _name_findings(robot: Node) -> Iterator[UrdfFinding]:
    first: dict[tuple[str, str], int] = {}
    for node in robot.children:
        key = node.tag, node.name
        if not node.name:
            yield structural("name", node.label, node.line, f"<{node.tag}> has no name; add name=...")
        elif key == ("joint", _PINOCCHIO_ROOT):
            yield structural("reserved_name", node.label, node.line, "Pinocchio's own first joint has this name; choose another")
        elif key in first:
            yield structural(f"duplicate_{node.tag}", node.label, node.line, f"line {first[key]} has the same name; rename one")
        first.setdefault(key, node.line)


def _content_findings(owner: Node) -> Iterator[UrdfFinding]:
    """Yield elements given twice, attributes left out, and values that Pinocchio reads otherwise than XML does."""
    for node in owner.family():
        for repeated in _repeated(node):
            message = f"<{node.tag}> holds a second <{repeated.tag}>, which Pinocchio passes over; keep one"
            yield structural("duplicate_element", owner.label, repeated.line, message)
        for attribute in _REQUIRED.get(node.tag, ()):
            if attribute not in node.attributes:
                yield structural("missing_attribute", owner.label, node.line, f"<{node.tag}> lacks {attribute}; add it")
        if node.tag == "dynamics" and not {"damping", "friction"} & node.attributes.keys():
            yield structural("missing_attribute", owner.label, node.line, "<dynamics> lacks damping and friction; add one or remove it")
        for attribute in _NOT_NEGATIVE.get(node.tag, ()):
            value = number(node, attribute)
            if value is not None and value < 0.0:
                yield structural("negative", owner.label, node.line, f"{attribute} of <{node.tag}> is {value:g}; it must not be negative")
        if node.broken:
            yield structural("line_break", owner.label, node.line, f"a value of <{node.tag}> holds a tab or a line break; use blanks")
        for text in filter(is_unexpanded, node.attributes.values()):
            message = f"{quoted(text)} in <{node.tag}> is a xacro expression that is not expanded; {EXPAND}"
            yield structural("xacro", owner.label, node.line, message)


def _repeated(node: Node) -> Iterator[Node]:
    seen = set()
    for child in node.children:
        if child.tag in seen:
            yield child
        if child.tag in _ONCE:
            seen.add(child.tag)


def _joint_findings(joint: Node) -> Iterator[UrdfFinding]:
    kind = joint.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        message = f"type is {quoted(kind)}; it must be one of {', '.join(JOINT_TYPES)}"
        yield structural("joint_type", joint.label, joint.line, message)
    if kind in ("revolute", "continuous", "prismatic", "planar"):
        yield from _axis_findings(joint)
    limit = joint.child("limit")
    if limit is not None:
        yield from _limit_findings(joint, limit)
    elif kind in ("revolute", "prismatic"):
        message = f"a {kind} joint must have <limit lower= upper= effort= velocity=>; a joint without stops is of type continuous"
        yield structural("limit_missing", joint.label, joint.line, message)


def _axis_findings(joint: Node) -> Iterator[UrdfFinding]:
    axis = joint.child("axis")
    if axis is None:  # x by the rules of URDF
        return
    if "xyz" not in axis.attributes:
        yield structural("axis_zero", joint.label, axis.line, "<axis> has no xyz and is read as zero; give a direction")
    direction = numbers(axis, "xyz")
    if direction is not None and not any(direction):
        yield structural("axis_zero", joint.label, axis.line, "the axis is zero; give a direction")


def _limit_findings(joint: Node, limit: Node) -> Iterator[UrdfFinding]:
    lower, upper = number(limit, "lower"), number(limit, "upper")
    if lower is not None and upper is not None and lower > upper:
        message = f"lower {lower:g} is above upper {upper:g}; exchange them"
        yield structural("limit_inverted", joint.label, limit.line, message)


def _mimic_findings(joint: Node, names: set[str]) -> Iterator[UrdfFinding]:
    mimic = joint.child("mimic")
    if mimic is None or "joint" not in mimic.attributes:
        return
    leader = mimic.attributes["joint"]
    if leader == joint.name:
        yield structural("mimic_self", joint.label, mimic.line, "the joint mimics itself; name another joint")
    elif leader not in names:
        yield structural("mimic_unknown", joint.label, mimic.line, f"mimics {quoted(leader)}, which is no joint of the file")
