"""Malformed URDFs by name: a sound two-joint arm with one defect each, and the expected finding."""

from __future__ import annotations

from typing import NamedTuple

HERE = "<!--here-->"
"""Marks the line that the finding must name."""


class Malformed(NamedTuple):
    """A document and the finding it must end in.

    Attributes:
        text: the document.
        code: the finding's code.
        element: the finding's element.
        line: the finding's line.
        physical: whether it is a warning only.
        besides: codes of the findings that follow from the same defect.
    """

    text: str | bytes
    code: str
    element: str
    line: int
    physical: bool = False
    besides: frozenset[str] = frozenset()


PARTS = {
    "declaration": '<?xml version="1.0"?>',
    "robot": '<robot name="arm">',
    "link_a": '<link name="a"/>',
    "link_b": '<link name="b"><inertial>',
    "inertial_origin": '<origin xyz="0.1 0 0" rpy="0 0 0"/>',
    "mass": '<mass value="2.5"/>',
    "inertia": '<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.04"/>',
    "inertial_end": "</inertial>",
    "visual": '<visual><origin xyz="0 0 0"/><geometry><sphere radius="0.1"/></geometry></visual>',
    "link_end": "</link>",
    "link_c": '<link name="c"><inertial><mass value="1"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>',
    "joint_1": '<joint name="one" type="revolute">',
    "ends_1": '<parent link="a"/><child link="b"/>',
    "origin_1": '<origin xyz="0 0 0.5" rpy="0 0 1.5"/>',
    "axis_1": '<axis xyz="0 0 1"/>',
    "limit_1": '<limit lower="-1" upper="1" effort="10" velocity="2"/>',
    "more_1": '<dynamics damping="0.1" friction="0.2"/>',
    "joint_1_end": "</joint>",
    "joint_2": '<joint name="two" type="prismatic">',
    "rest_2": '<parent link="b"/><child link="c"/><axis xyz="0 1 0"/>'
    '<limit lower="0" upper="1" effort="1" velocity="1"/>',
    "joint_2_end": "</joint>",
    "more": "",
    "robot_end": "</robot>",
}
"""The lines of the sound arm."""


def arm(**parts: str) -> str:
    """Return the sound arm with some of its lines replaced."""
    assert parts.keys() <= PARTS.keys()
    return "\n".join((PARTS | parts).values()) + "\n"


def _line(text: str) -> int:
    assert text.count(HERE) == 1
    return text.count("\n", 0, text.index(HERE)) + 1


def _bad(code: str, element: str, *besides: str, physical: bool = False, **parts: str) -> Malformed:
    """Return the arm with a defect in one or more of its parts; the finding must name the first one given."""
    first = next(iter(parts))
    parts[first] += HERE
    text = arm(**parts)
    return Malformed(text, code, element, _line(text), physical, frozenset(besides))


def _document(text: str | bytes, code: str, line: int) -> Malformed:
    return Malformed(text, code, "document", line)


def chain(joints: int, kind: str = "fixed") -> str:
    """Return a chain of links on as many joints, each element on a line of its own."""
    links = [f'<link name="l{i}"/>' for i in range(joints + 1)]
    limit = "" if kind == "fixed" else '<limit lower="0" upper="1" effort="1" velocity="1"/>'
    edges = [
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>{limit}</joint>'
        for i in range(joints)
    ]
    return "\n".join(['<robot name="chain">', *links, *edges, "</robot>"])


def _inertia(**entries: str) -> str:
    values = {"ixx": "0.02", "ixy": "0", "ixz": "0", "iyy": "0.03", "iyz": "0", "izz": "0.04"} | entries
    return "<inertia " + " ".join(f'{name}="{value}"' for name, value in values.items()) + "/>"


def _joint(name: str, parent: str, child: str) -> str:
    return f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'


_LAUGHS = (
    '<?xml version="1.0"?>\n<!DOCTYPE robot [\n<!ENTITY l0 "ha">\n'
    + "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">\n' for i in range(1, 10))
    + ']>\n<robot name="&l9;"><link name="a"/></robot>'
)
_LIMIT = '<limit lower="{}" upper="{}" effort="{}" velocity="{}"/>'

DOCUMENTS: dict[str, Malformed] = {
    "empty": _document("", "empty", 0),
    "blank": _document(" \n\t\n", "empty", 0),
    "truncated in an element": _document(arm()[: arm().index("<axis") + 8], "not_xml", 15),
    "truncated between elements": _document(arm()[: arm().index("<axis")], "not_xml", 15),
    "no XML": _document("robot: arm\nlinks: [a, b]\n", "not_xml", 1),
    "binary": _document(bytes(range(256)) * 4, "encoding", 2),
    "a picture": _document(b"\x89PNG\r\n\x1a\n" + b"\0" * 64, "encoding", 1),
    "NUL bytes": _document(arm().replace("0.5", "0\0.5"), "encoding", 14),
    "latin-1": _document(
        arm(joint_2='<joint name="zwölf" type="prismatic">').encode("latin-1"), "encoding", 19
    ),
    "utf-16": _document(arm().encode("utf-16"), "encoding", 1),
    "lone surrogate": _document(arm(link_a='<link name="\ud800"/>'), "encoding", 3),
    "wrong root": _document(f"<sdf>\n{arm(declaration='')}</sdf>", "root", 1),
    "two documents": _document(arm() + '<robot name="more"/>', "not_xml", 24),
    "billion laughs": _document(_LAUGHS, "doctype", 2),
    "external entity": _document(
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>\n<robot name="&x;"/>', "doctype", 1
    ),
    "external DTD": _document(
        '<!DOCTYPE robot SYSTEM "http://localhost/robot.dtd">\n<robot name="r"/>', "doctype", 1
    ),
    "undefined entity": _document(arm(mass='<mass value="&mass;"/>'), "not_xml", 6),
    "attribute twice": _document(arm(mass='<mass value="1" value="2"/>'), "not_xml", 6),
    "attribute without value": _document(arm(mass="<mass value/>"), "not_xml", 6),
    "20000 nested elements": _document(
        '<robot name="r">\n' + "<a>" * 20_000 + "</a>" * 20_000 + "</robot>", "nesting", 2
    ),
    "20000 nested links": _document(
        '<robot name="r">' + "<link>" * 20_000 + "</link>" * 20_000 + "</robot>", "nesting", 1
    ),
    "too many elements": _document('<robot name="r">\n' + "<a/>" * 100_001 + "</robot>", "elements", 2),
    "too large": _document(arm(more="<!--" + "x" * 5_000_000 + "-->"), "size", 0),
    "xacro element": _document(arm(more='<xacro:include filename="gripper.xacro"/>'), "xacro", 22),
}
"""Those that are no URDF at all."""

NAMES: dict[str, Malformed] = {
    "robot without name": _bad("name", "robot", robot="<robot>"),
    "no links": Malformed('<robot name="r">\n</robot>', "no_links", "robot", 1),
    "link without name": _bad("name", "link (unnamed)", more="<link/>"),
    "link with empty name": _bad("name", "link (unnamed)", more='<link name=""/>'),
    "joint without name": _bad("name", "joint (unnamed)", joint_1='<joint type="revolute">'),
    "joint with Pinocchio's name": _bad(
        "reserved_name", "joint 'universe'", joint_1='<joint name="universe" type="revolute">'
    ),
    "link twice": _bad("duplicate_link", "link 'c'", more='<link name="c"/>'),
    "joint twice": _bad("duplicate_joint", "joint 'one'", joint_2='<joint name="one" type="prismatic">'),
    "material twice": _bad(
        "duplicate_material", "material 'red'", more='<material name="red"/>\n<material name="red"/>'
    ),
    "name as xacro expression": _bad(
        "xacro", "joint '${prefix}one'", joint_1='<joint name="${prefix}one" type="revolute">'
    ),
}
"""Names missing, taken or given twice."""

VALUES: dict[str, Malformed] = {
    "mass nan": _bad("not_finite", "link 'b'", mass='<mass value="nan"/>'),
    "mass abc": _bad("number", "link 'b'", mass='<mass value="abc"/>'),
    "mass empty": _bad("number", "link 'b'", mass='<mass value=""/>'),
    "mass as xacro expression": _bad("xacro", "link 'b'", mass='<mass value="${mass}"/>'),
    "mass with trailing blank": _bad("number", "link 'b'", mass='<mass value="2.5 "/>'),
    "mass with decimal comma": _bad("number", "link 'b'", mass='<mass value="2,5"/>'),
    "mass with underscore": _bad("number", "link 'b'", mass='<mass value="1_0"/>'),
    "mass hexadecimal": _bad("number", "link 'b'", mass='<mass value="0x10"/>'),
    "mass overflowing": _bad("not_finite", "link 'b'", mass='<mass value="1e999"/>'),
    "mass on two lines": Malformed(
        arm(mass='<mass value="2.5\n"/>'), "line_break", "link 'b'", 6, besides=frozenset({"number"})
    ),
    "two masses": _bad("duplicate_element", "link 'b'", mass='<mass value="1"/>\n<mass value="2"/>'),
    "two inertials": _bad("duplicate_element", "link 'b'", inertial_end="</inertial>\n<inertial/>"),
    "inertia nan": _bad("not_finite", "link 'b'", inertia=_inertia(ixy="nan")),
    "inertia abc": _bad("number", "link 'b'", inertia=_inertia(izz="abc")),
    "inertial origin inf": _bad("not_finite", "link 'b'", inertial_origin='<origin xyz="inf 0 0"/>'),
    "joint origin nan": _bad("not_finite", "joint 'one'", origin_1='<origin xyz="0 0 NaN"/>'),
    "joint origin of two numbers": _bad("count", "joint 'one'", origin_1='<origin xyz="0 0"/>'),
    "joint origin of four numbers": _bad("count", "joint 'one'", origin_1='<origin xyz="0 0 0 1"/>'),
    "joint origin with commas": _bad("count", "joint 'one'", origin_1='<origin xyz="0,0,1"/>'),
    "joint rpy of one number": _bad("count", "joint 'one'", origin_1='<origin rpy="1.57"/>'),
    "joint rpy empty": _bad("count", "joint 'one'", origin_1='<origin rpy=""/>'),
    "joint rpy in words": _bad("number", "joint 'one'", origin_1='<origin rpy="0 0 pi/2"/>'),
    "joint origin with tabs": _bad("line_break", "joint 'one'", origin_1='<origin xyz="0\t0\t1"/>'),
    "visual origin nan": _bad("not_finite", "link 'b'", visual='<visual><origin xyz="nan 0 0"/></visual>'),
    "box of two numbers": _bad(
        "count", "link 'b'", visual='<collision><geometry><box size="1 1"/></geometry></collision>'
    ),
    "mesh without file": _bad(
        "missing_attribute", "link 'b'", visual="<visual><geometry><mesh/></geometry></visual>"
    ),
    "mesh in a xacro package": _bad(
        "xacro",
        "link 'b'",
        visual='<visual><geometry><mesh filename="$(find arm)/b.stl"/></geometry></visual>',
    ),
    "axis inf": _bad("not_finite", "joint 'one'", axis_1='<axis xyz="0 0 inf"/>'),
    "axis of two numbers": _bad("count", "joint 'one'", axis_1='<axis xyz="0 1"/>'),
    "limit nan": _bad("not_finite", "joint 'one'", limit_1=_LIMIT.format("nan", 1, 1, 1)),
    "limit inf": _bad("not_finite", "joint 'one'", limit_1=_LIMIT.format(-1, "inf", 1, 1)),
    "limit abc": _bad("number", "joint 'one'", limit_1=_LIMIT.format(-1, "abc", 1, 1)),
    "limit without effort": _bad(
        "missing_attribute", "joint 'one'", limit_1='<limit lower="-1" upper="1" velocity="1"/>'
    ),
    "effort negative": _bad("negative", "joint 'one'", limit_1=_LIMIT.format(-1, 1, -5, 1)),
    "friction negative": _bad("negative", "joint 'one'", more_1='<dynamics friction="-1"/>'),
    "dynamics empty": _bad("missing_attribute", "joint 'one'", more_1="<dynamics/>"),
    "mimic factor nan": _bad("not_finite", "joint 'one'", more_1='<mimic joint="two" multiplier="nan"/>'),
}
"""Numbers that are none, too many or too few."""

JOINTS: dict[str, Malformed] = {
    "unknown type": _bad("joint_type", "joint 'one'", joint_1='<joint name="one" type="hinge">'),
    "type in capitals": _bad("joint_type", "joint 'one'", joint_1='<joint name="one" type="Revolute">'),
    "no type": _bad("joint_type", "joint 'one'", joint_1='<joint name="one">'),
    "axis zero": _bad("axis_zero", "joint 'one'", axis_1='<axis xyz="0 0 0"/>'),
    "axis without xyz": _bad("axis_zero", "joint 'one'", axis_1='<axis rpy="0 0 1"/>'),
    "limits inverted": _bad("limit_inverted", "joint 'one'", limit_1=_LIMIT.format(1, -1, 1, 1)),
    "revolute without limit": _bad("limit_missing", "joint 'one'", joint_1=PARTS["joint_1"], limit_1=""),
    "prismatic without limit": _bad(
        "limit_missing", "joint 'two'", joint_2=PARTS["joint_2"], rest_2='<parent link="b"/><child link="c"/>'
    ),
    "mimics an unknown joint": _bad("mimic_unknown", "joint 'one'", more_1='<mimic joint="three"/>'),
    "mimics itself": _bad("mimic_self", "joint 'one'", more_1='<mimic joint="one"/>'),
    "mimics nothing": _bad("missing_attribute", "joint 'one'", more_1="<mimic/>"),
}
"""Joints that cannot be."""

TREES: dict[str, Malformed] = {
    "no parent": _bad("no_parent", "joint 'one'", joint_1=PARTS["joint_1"], ends_1='<child link="b"/>'),
    "no child": _bad(
        "no_child", "joint 'one'", "two_roots", joint_1=PARTS["joint_1"], ends_1='<parent link="a"/>'
    ),
    "parent without link": _bad("no_parent", "joint 'one'", ends_1='<parent/><child link="b"/>'),
    "child with empty link": _bad(
        "no_child", "joint 'one'", "two_roots", ends_1='<parent link="a"/><child link=""/>'
    ),
    "unknown parent": _bad("unknown_parent", "joint 'one'", ends_1='<parent link="z"/><child link="b"/>'),
    "unknown child": _bad(
        "unknown_child", "joint 'one'", "two_roots", ends_1='<parent link="a"/><child link="z"/>'
    ),
    "two parents": _bad("two_parents", "link 'c'", more=_joint("three", "a", "c")),
    "the same joint twice": _bad("two_parents", "link 'c'", "duplicate_joint", more=_joint("two", "b", "c")),
    "two roots": _bad("two_roots", "link 'd'", more='<link name="d"/>'),
    "all in a cycle": _bad("no_root", "robot", "cycle", robot=PARTS["robot"], more=_joint("three", "c", "a")),
    "cycle beside the tree": _bad(
        "cycle",
        "joint 'four'",
        more=f'<link name="d"/><link name="e"/>{_joint("three", "d", "e")}\n{_joint("four", "e", "d")}',
    ),
    "its own parent": _bad("cycle", "joint 'three'", more=f'<link name="d"/>{_joint("three", "d", "d")}'),
    "chain of 5000 fixed links": Malformed(chain(5_000), "depth", "joint 'j1000'", 6_003),
    "chain of 1001 moved links": Malformed(
        chain(1001, "revolute"), "depth", "joint 'j1000'", 2004, besides=frozenset({"massless_body"})
    ),
}
"""Trees that are none."""

BODIES: dict[str, Malformed] = {
    "mass missing": _bad("mass_missing", "link 'b'", physical=True, link_b=PARTS["link_b"], mass=""),
    "mass without value": _bad("mass_missing", "link 'b'", physical=True, mass="<mass/>"),
    "mass zero": _bad("mass_zero", "link 'b'", physical=True, mass='<mass value="0"/>'),
    "mass underflowing": _bad("mass_zero", "link 'b'", physical=True, mass='<mass value="1e-999"/>'),
    "mass and inertia zero": _bad(
        "mass_zero",
        "link 'b'",
        physical=True,
        mass='<mass value="0.0"/>',
        inertia=_inertia(ixx="0", iyy="0", izz="0"),
    ),
    "mass negative": _bad("mass_negative", "link 'b'", physical=True, mass='<mass value="-2.5"/>'),
    "moved link without inertial": _bad(
        "massless_body", "link 'c'", physical=True, link_c='<link name="c"/>'
    ),
    "inertia missing": _bad("inertia_missing", "link 'b'", physical=True, link_b=PARTS["link_b"], inertia=""),
    "inertia of three numbers": _bad(
        "inertia_missing", "link 'b'", physical=True, inertia='<inertia ixx="1" iyy="1" izz="1"/>'
    ),
    "inertia negative": _bad("inertia_not_psd", "link 'b'", physical=True, inertia=_inertia(iyy="-0.03")),
    "inertia indefinite": _bad("inertia_not_psd", "link 'b'", physical=True, inertia=_inertia(ixy="0.5")),
    "inertia of no body": _bad("inertia_triangle", "link 'b'", physical=True, inertia=_inertia(izz="0.06")),
    "inertia of no body, turned": _bad(
        "inertia_triangle",
        "link 'b'",
        physical=True,
        inertia=_inertia(ixx="0.035", iyy="0.035", ixy="0.025", izz="0.005"),
    ),
}
"""Bodies that cannot exist: Pinocchio builds a model of each."""

CORPUS = DOCUMENTS | NAMES | VALUES | JOINTS | TREES | BODIES
