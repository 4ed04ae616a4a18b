"""Links and joints one by one: names, types, axes, limits, and elements that are missing or given twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from coop_pin.description.urdf.report import EXPAND, UrdfFinding, doubtful, listed, quoted, structural
from coop_pin.description.urdf.xml import Node, is_unexpanded, number, number_findings, numbers

_DEGREES = (45.0, 720.0)
"""Size of a revolute joint's limit that is likely in degrees; larger ones stand for "no limit" in many files."""

_FAR_M = 10.0
"""Distance from one joint to the next beyond which no arm reaches."""

_PACKAGES = ("package://", "model://")


def unit_findings(joint: Node) -> Iterator[UrdfFinding]:
    """Yield the numbers of a joint that look like another unit's."""
    limit = joint.child("limit")
    if joint.attributes.get("type") == "revolute" and limit is not None:
        ends = [value for value in (number(limit, "lower"), number(limit, "upper")) if value is not None]
        largest = max(map(abs, ends), default=0.0)
        if _DEGREES[0] <= largest <= _DEGREES[1]:
            message = f"a limit of {largest:g} rad is {largest / 6.283185307:.0f} turns; URDF counts in radians: are these degrees?"
            yield doubtful("limit_degrees", joint.label, limit.line, message)
    origin = joint.child("origin")
    far = max(map(abs, numbers(origin, "xyz") or (0.0,)))
    if origin is not None and far > _FAR_M:
        message = f"its origin is {far:g} m off its parent's; URDF counts in metres: are these millimetres?"
        yield doubtful("origin_far", joint.label, origin.line, message)


def mesh_findings(robot: Node, package_dirs: Iterable[Path]) -> Iterator[UrdfFinding]:
    """Yield the meshes of visuals that are not there; pictures leave their links out.

    Args:
        robot: the <robot> element.
        package_dirs: folders in which the packages of package:// are looked for.
    """
    folders = tuple(package_dirs)
    for link in robot.children:
        for visual in link.children if link.tag == "link" else ():
            geometry = visual.child("geometry") if visual.tag == "visual" else None
            mesh = geometry.child("mesh") if geometry is not None else None
            name = mesh.attributes.get("filename", "") if mesh is not None else ""
            if mesh is not None and not any(path.is_file() for path in _candidates(name, folders)):
                looked = f" in {listed(map(str, folders))}" if name.startswith(_PACKAGES) else ""
                message = f"there is no mesh {quoted(name)}{looked}; pictures leave the link out, the physics does not need it"
                yield doubtful("mesh_missing", link.label, mesh.line, message)


def _candidates(name: str, folders: tuple[Path, ...]) -> list[Path]:
    """Return where Pinocchio looks for a mesh."""
    if name.startswith(_PACKAGES):
        return [folder / name.partition("://")[2] for folder in folders]
    return [Path(name.removeprefix("file://"))]


JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
"""The joint types of URDF."""

_PINOCCHIO_ROOT = "universe"
_ONCE = frozenset(
    {
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
    }
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
            yield structural(
                "reserved_name",
                node.label,
                node.line,
                "Pinocchio's own first joint has this name; choose another",
            )
        elif key in first:
            yield structural(
                f"duplicate_{node.tag}",
                node.label,
                node.line,
                f"line {first[key]} has the same name; rename one",
            )
        first.setdefault(key, node.line)


def _content_findings(owner: Node) -> Iterator[UrdfFinding]:
    """Yield elements given twice, attributes left out, and values that Pinocchio reads otherwise than XML does."""
    for node in owner.family():
        for repeated in _repeated(node):
            message = f"<{node.tag}> holds a second <{repeated.tag}>, which Pinocchio passes over; keep one"
            yield structural("duplicate_element", owner.label, repeated.line, message)
        for attribute in _REQUIRED.get(node.tag, ()):
            if attribute not in node.attributes:
                yield structural(
                    "missing_attribute", owner.label, node.line, f"<{node.tag}> lacks {attribute}; add it"
                )
        if node.tag == "dynamics" and not {"damping", "friction"} & node.attributes.keys():
            yield structural(
                "missing_attribute",
                owner.label,
                node.line,
                "<dynamics> lacks damping and friction; add one or remove it",
            )
        for attribute in _NOT_NEGATIVE.get(node.tag, ()):
            value = number(node, attribute)
            if value is not None and value < 0.0:
                yield structural(
                    "negative",
                    owner.label,
                    node.line,
                    f"{attribute} of <{node.tag}> is {value:g}; it must not be negative",
                )
        if node.broken:
            yield structural(
                "line_break",
                owner.label,
                node.line,
                f"a value of <{node.tag}> holds a tab or a line break; use blanks",
            )
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
        yield structural(
            "axis_zero", joint.label, axis.line, "<axis> has no xyz and is read as zero; give a direction"
        )
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
        yield structural(
            "mimic_unknown",
            joint.label,
            mimic.line,
            f"mimics {quoted(leader)}, which is no joint of the file",
        )
