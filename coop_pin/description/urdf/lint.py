"""Checks of single links and joints: names, types, axes, limits, units, missing and repeated elements."""

from __future__ import annotations

import math
from collections.abc import Iterator

from coop_pin.description.urdf.loops import loop_findings
from coop_pin.description.urdf.numbers import is_unexpanded, number, number_findings, numbers
from coop_pin.description.urdf.report import UrdfFinding, quoted
from coop_pin.description.urdf.xml import EXPAND, LOOP, Node

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""The joint types of URDF."""

_DEGREES = (45.0, 720.0)
"""Revolute joint limits in this range are probably degrees; larger ones often mean "no limit"."""

_FAR_M = 10.0
"""Distance between two joints beyond any arm, m."""

_PINOCCHIO_ROOT = "universe"
_ONCE = frozenset(
    (
        "inertial",
        "origin",
        "mass",
        "inertia",
        "geometry",
        "parent",
        "child",
        "axis",
        "limit",
        "mimic",
        "dynamics",
    )
)
_REQUIRED = {
    "limit": ("effort", "velocity"),
    "safety_controller": ("k_velocity",),
    "mimic": ("joint",),
    "mesh": ("filename",),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
}
_NOT_NEGATIVE = {
    "limit": ("effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}


def element_findings(robot: Node) -> Iterator[UrdfFinding]:
    """Yield the defects of single links and joints of a robot."""
    if not robot.name:
        yield robot.finding("name", "<robot> has no name; add name=...")
    if robot.child("link") is None:
        yield robot.finding("no_links", "the robot has no links")
    yield from loop_findings(robot)
    robot = robot._replace(children=[node for node in robot.children if node.tag != LOOP])
    yield from _name_findings(robot)
    joint_names = {node.name for node in robot.children if node.tag == "joint"}
    for node in robot.children:
        yield from _content_findings(node)
        yield from number_findings(node)
        if node.tag == "joint":
            yield from _joint_findings(node, joint_names)
            yield from _unit_findings(node)


def _name_findings(robot: Node) -> Iterator[UrdfFinding]:
    first: dict[tuple[str, str], int] = {}
    for node in robot.children:
        key = node.tag, node.name
        if not node.name:
            yield node.finding("name", f"<{node.tag}> has no name; add name=...")
        elif key == ("joint", _PINOCCHIO_ROOT):
            yield node.finding("reserved_name", "Pinocchio's own root joint has this name; choose another")
        elif key in first:
            message = f"the same name is used on line {first[key]}; rename one of them"
            yield node.finding(f"duplicate_{node.tag}", message)
        first.setdefault(key, node.line)


def _content_findings(owner: Node) -> Iterator[UrdfFinding]:
    """Yield repeated elements, missing attributes, and values that Pinocchio reads differently from XML."""
    for node in owner.family():
        seen: set[str] = set()
        for child in node.children:
            if child.tag in seen:
                message = f"<{node.tag}> contains a second <{child.tag}>, which Pinocchio ignores; keep one"
                yield owner.finding("duplicate_element", message, at=child)
            seen |= {child.tag} & _ONCE
        for attribute in _REQUIRED.get(node.tag, ()):
            if attribute not in node.attributes:
                yield owner.finding("missing_attribute", f"<{node.tag}> lacks {attribute}; add it", at=node)
        if node.tag == "dynamics" and not {"damping", "friction"} & node.attributes.keys():
            message = "<dynamics> lacks damping and friction; add one or remove it"
            yield owner.finding("missing_attribute", message, at=node)
        for attribute in _NOT_NEGATIVE.get(node.tag, ()):
            value = min(numbers(node, attribute) or (0.0,))
            if value < 0.0:
                message = f"{attribute} of <{node.tag}> is {value:g}; it must not be negative"
                yield owner.finding("negative", message, at=node)
        if node.broken:
            message = f"a value of <{node.tag}> contains a tab or a line break; use blanks"
            yield owner.finding("line_break", message, at=node)
        for text in filter(is_unexpanded, node.attributes.values()):
            message = f"{quoted(text)} in <{node.tag}> is a xacro expression that is not expanded; {EXPAND}"
            yield owner.finding("xacro", message, at=node)


def _joint_findings(joint: Node, joint_names: set[str]) -> Iterator[UrdfFinding]:
    """Yield defects of a joint's type, axis, limits and mimic."""
    kind = joint.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        message = f"type is {quoted(kind)}; it must be one of {', '.join(JOINT_TYPES)}"
        yield joint.finding("joint_type", message)
    axis, limit, mimic = map(joint.child, ("axis", "limit", "mimic"))
    if kind in ("revolute", "continuous", "prismatic", "planar") and axis is not None:  # default: the x axis
        if "xyz" not in axis.attributes:
            yield joint.finding(
                "axis_zero", "<axis> has no xyz and is read as zero; add a direction", at=axis
            )
        elif numbers(axis, "xyz") == (0.0, 0.0, 0.0):
            yield joint.finding("axis_zero", "the axis is zero; give a direction", at=axis)
    if limit is None and kind in ("revolute", "prismatic"):
        message = "must have <limit lower= upper= effort= velocity=>; the type without limits is continuous"
        yield joint.finding("limit_missing", f"a {kind} joint {message}")
    lower, upper = number(limit, "lower"), number(limit, "upper")
    if lower is not None and upper is not None and lower > upper:
        message = f"lower {lower:g} is greater than upper {upper:g}; exchange them"
        yield joint.finding("limit_inverted", message, at=limit)
    leader = None if mimic is None else mimic.attributes.get("joint")
    if leader == joint.name:
        yield joint.finding("mimic_self", "the joint mimics itself; name another joint", at=mimic)
    elif leader is not None and leader not in joint_names:
        message = f"mimics {quoted(leader)}, which is not a joint of the file"
        yield joint.finding("mimic_unknown", message, at=mimic)


def _unit_findings(joint: Node) -> Iterator[UrdfFinding]:
    """Yield the numbers of a joint that are probably in another unit."""
    limit, origin = joint.child("limit"), joint.child("origin")
    if joint.attributes.get("type") == "revolute":
        largest = max(abs(number(limit, end) or 0.0) for end in ("lower", "upper"))
        if _DEGREES[0] <= largest <= _DEGREES[1]:
            turns = f"{largest / (2.0 * math.pi):.0f} turns"
            message = f"a limit of {largest:g} rad is {turns}; URDF uses radians: is this in degrees?"
            yield joint.finding("limit_degrees", message, at=limit, kind="doubtful")
    far = max(map(abs, numbers(origin, "xyz") or (0.0,)))
    if far > _FAR_M:
        message = f"its origin is {far:g} m from its parent's; URDF uses metres: is this in millimetres?"
        yield joint.finding("origin_far", message, at=origin, kind="doubtful")
