"""Checks of single links and joints: names, types, axes, limits, units, missing and repeated elements."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from typing import Any, NamedTuple

from lxml import etree

from coop_pin.description.urdf.report import Kind, UrdfFinding, quoted
from coop_pin.description.urdf.tree import Tree
from coop_pin.description.urdf.xml import COUNTS, EXPAND, Element, finding, number, number_problem, numbers

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")

_DEGREES = (45.0, 720.0)
"""Revolute joint limits in this range are probably degrees; larger ones often mean "no limit"."""

_FAR_M = 10.0
"""Distance between two joints beyond any arm, m."""

_READ = ("link", "joint", "material")
"""Children of <robot> that Pinocchio reads; gazebo, transmission and the like are skipped."""

_ONCE = [
    *("inertial", "origin", "mass", "inertia", "geometry"),
    *("parent", "child", "axis", "limit", "mimic", "dynamics"),
]
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


def _values(attributes: Sequence[Any]) -> list[float]:
    return [value for each in attributes for value in numbers(each.getparent(), each.attrname) or (math.nan,)]


def _problem(_: object, attributes: Sequence[Any], count: float) -> str:
    """Return what is wrong with numbers that are no xacro expression, which is a finding of its own."""
    return next((number_problem(str(each), int(count)) for each in attributes if "$" not in each), "")


_FUNCTIONS = {
    (None, "problem"): _problem,
    (None, "least"): lambda _, attributes: min(_values(attributes), default=math.nan),
    (None, "largest"): lambda _, attributes: max(map(abs, _values(attributes)), default=math.nan),
}
"""XPath functions of numeric attributes; comparisons with NaN, of malformed numbers, are false."""

_HAS_AXIS = "@type='revolute' or @type='continuous' or @type='prismatic' or @type='planar'"
_BLANKS = "'\t\r\n'"


_NUMBERS = {
    "count": "numbers, separated by blanks",
    "number": "plain decimal numbers without trailing blanks",
    "not_finite": "finite numbers within the range of a float",
}


class _Rule(NamedTuple):
    """Defective elements.

    Attributes:
        code: short name of the defect.
        path: their XPath, of one step: libxml2 takes time with the square of the nodes between two steps.
        message: text that says what is wrong, with {tag}, {parent}, {values}, and attributes of the element.
        kind: severity class.
    """

    code: str
    path: str
    message: str
    kind: Kind = "structural"


_RULES = (
    _Rule(
        "name",
        "/robot/*[not(string(@name))] | /robot[not(string(@name))]",
        "<{tag}> has no name; add name=...",
    ),
    _Rule("no_links", "/robot[not(link)]", "the robot has no links"),
    _Rule(
        "reserved_name",
        "/robot/joint[@name='universe']",
        "Pinocchio's own root joint has this name; choose another",
    ),
    *(
        _Rule(
            "duplicate_element",
            f"//{tag}[preceding-sibling::{tag}]",
            "<{parent}> contains a second <{tag}>, which Pinocchio ignores; keep one",
        )
        for tag in _ONCE
    ),
    *(
        _Rule("missing_attribute", f"//{tag}[not(@{name})]", f"<{tag}> lacks {name}; add it")
        for tag, names in _REQUIRED.items()
        for name in names
    ),
    _Rule(
        "missing_attribute",
        "//dynamics[not(@damping or @friction)]",
        "<dynamics> lacks damping and friction; add one or remove it",
    ),
    *(
        _Rule(
            "negative",
            f"//{tag}[least(@{name}) < 0]",
            f"{name} of <{tag}> is {{{name}}}; it must not be negative",
        )
        for tag, names in _NOT_NEGATIVE.items()
        for name in names
    ),
    *(
        # Pinocchio never reads the axis of a joint that has none, and many files have "0 0 0" there.
        _Rule(
            code,
            f"//{tag}[problem(@{name}, {count}) = '{code}']"
            "[not(self::axis/parent::joint[@type='fixed' or @type='floating'])]",
            f"{name} of <{tag}> is {{{name}}}; it must be {count} {what}",
        )
        for code, what in _NUMBERS.items()
        for tag, counts in COUNTS.items()
        for name, count in counts.items()
    ),
    *(
        _Rule("no_" + tag, path, f"the joint names no {tag}; add <{tag} link=...>")
        for tag in ("parent", "child")
        for path in (f"/robot/joint[not({tag})]", f"//{tag}[not(string(@link))][parent::joint]")
    ),
    _Rule(
        "line_break",
        f"//*[@*[translate(., {_BLANKS}, '') != .]]",
        "a value of <{tag}> contains a tab or a line break; use blanks",
    ),
    _Rule(
        "xacro",
        "//*[@*[contains(., '${') or contains(., '$(')]]",
        f"{{values}} of <{{tag}}> has a xacro expression that is not expanded; {EXPAND}",
    ),
    _Rule(
        "joint_type",
        f"/robot/joint[not({' or '.join(f'@type={kind!r}' for kind in _JOINT_TYPES)})]",
        f"type is {{type}}; it must be one of {', '.join(_JOINT_TYPES)}",
    ),
    _Rule(
        "axis_zero",
        f"//axis[not(@xyz)][parent::joint[{_HAS_AXIS}]]",
        "<axis> has no xyz and is read as zero; add a direction",
    ),
    _Rule(
        "axis_zero",
        f"//axis[largest(@xyz) = 0][parent::joint[{_HAS_AXIS}]]",
        "the axis is zero; give a direction",
    ),
    _Rule(
        "limit_missing",
        "/robot/joint[@type='revolute' or @type='prismatic'][not(limit)]",
        "a joint of type {type} must have <limit lower= upper= effort= velocity=>;"
        " the type without limits is continuous",
    ),
    _Rule(
        "limit_inverted",
        "//limit[least(@lower) > least(@upper)]",
        "lower {lower} is greater than upper {upper}; exchange them",
    ),
    _Rule(
        "mimic_self",
        "//mimic[@joint = ../@name]",
        "the joint mimics itself; name another joint",
    ),
    _Rule(
        "limit_degrees",
        f"//limit[largest(@lower | @upper) >= {_DEGREES[0]} and largest(@lower | @upper) <= {_DEGREES[1]}]"
        "[parent::joint[@type='revolute']]",
        "limits {lower} .. {upper} rad are many turns; URDF uses radians: are they in degrees?",
        "doubtful",
    ),
    _Rule(
        "origin_far",
        f"//origin[largest(@xyz) > {_FAR_M}][parent::joint]",
        f"its origin {{xyz}} is more than {_FAR_M:g} m from its parent's; URDF uses metres:"
        " is this in millimetres?",
        "doubtful",
    ),
    _Rule(
        "mass_missing",
        "//inertial[not(mass) and not(preceding-sibling::inertial)] | //mass[not(@value)]",
        "<inertial> has no mass, which is read as zero; add <mass value=...>, kg",
        "physical",
    ),
    _Rule(
        "inertia_missing",
        "//inertial[not(inertia) and not(preceding-sibling::inertial)]"
        f" | //inertia[not({' and '.join(f'@{name}' for name in COUNTS['inertia'])})]",
        f"<inertial> lacks some of {', '.join(COUNTS['inertia'])}, which are read as zero; add them, kg m^2",
        "physical",
    ),
)
_PATHS = [etree.XPath(rule.path, extensions=_FUNCTIONS) for rule in _RULES]


def element_findings(robot: Element) -> Iterator[UrdfFinding]:
    """Yield the defects of single links and joints of a robot, from which all else is removed."""
    for child in list(robot):
        if child.tag not in _READ:
            robot.remove(child)
    for rule, path in zip(_RULES, _PATHS, strict=True):
        for element in path(robot):
            words = defaultdict(lambda: "''", {name: quoted(text) for name, text in element.items()})
            path_up = [element, *element.iterancestors()]
            words |= {"tag": element.tag, "parent": "".join(above.tag for above in path_up[1:2])}
            words["values"] = quoted(" ".join(element.values()))
            yield finding(
                path_up[-2:][0], rule.code, rule.message.format_map(words), at=element, kind=rule.kind
            )
    yield from _name_findings(robot)


def passive_findings(tree: Tree, locked: Collection[str]) -> Iterator[UrdfFinding]:
    """Yield the joints with effort 0 among joints that move, where others have efforts: no drive moves them.

    Args:
        tree: the tree.
        locked: names of the locked joints.
    """
    moving = [
        (edge.joint, number(edge.joint.find("limit"), "effort"))
        for edge in tree.edges()
        if not edge.is_fixed and edge.name not in locked and edge.joint.find("mimic") is None
    ]
    if any(effort for _, effort in moving):
        for joint in (joint for joint, effort in moving if effort == 0.0):
            message = (
                "its effort is 0, and other joints have efforts: no drive moves it in a cell; if one does,"
                " state its effort, or torque_limits in the arm"
            )
            yield finding(joint, "passive_joint", message, at=joint.find("limit"), kind="doubtful")


def _name_findings(robot: Element) -> Iterator[UrdfFinding]:
    """Yield names given twice, and leaders of mimic joints that do not exist."""
    first: dict[tuple[str, str], Element] = {}
    for element in robot:
        other = first.setdefault((element.tag, element.get("name", "")), element)
        if other is not element and element.get("name"):
            message = f"the same name is used on line {other.sourceline}; rename one of them"
            yield finding(element, f"duplicate_{element.tag}", message)
    for mimic in robot.iterfind("joint/mimic[@joint]"):
        if ("joint", mimic.get("joint")) not in first:
            message = f"mimics {quoted(mimic.get('joint'))}, which is not a joint of the file"
            yield finding(mimic.getparent(), "mimic_unknown", message, at=mimic)
