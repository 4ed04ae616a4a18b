"""Loop closures that a URDF states in one of the dialects that have them.

URDF is a tree. These elements close a loop between two links A and B, and are read as closures:

- ``<loop_joint name type>`` with ``<link1 link xyz rpy/>``, ``<link2 link xyz rpy/>`` and ``<axis xyz/>``
  (earlier Drake, NVIDIA Isaac Sim).
- ``<loop name type>`` with ``<predecessor link>``, ``<successor link>``, an ``<origin xyz rpy/>`` in each,
  and ``<axis xyz/>`` (URDF+).
- ``<constraint name type>`` with ``<parent link/>``, ``<parent_origin xyz rpy/>``, ``<parent_axis xyz/>``,
  ``<child link/>``, ``<child_origin xyz rpy/>`` and ``<child_axis xyz/>``, equal to the other axis
  (proposed for urdfdom).
- ``<joint name type>`` in a ``<gazebo>`` without reference: a joint of SDFormat 1.5 or later with
  ``<parent>``, ``<child>``, ``<pose>`` in the child and ``<axis><xyz>`` in the joint. The joint's frame on
  the parent is where its frame on the child is when all joints of the tree are at zero.
- ``<drake:ball_constraint>`` with the bodies A and B and the points ``p_AP`` and ``p_BQ``.

An axis is given in the loop's frame C, on A as on B. Types: fixed or link (a cut link), spherical or ball,
revolute or continuous, and prismatic. Limits, friction and damping of a loop are not read.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import inverse_pose, make_pose
from coop_pin.description.cell.closure import Closure, NamedRows, RowMask
from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.robot import Robot
from coop_pin.description.urdf.tree import Edge, Tree
from coop_pin.description.urdf.xml import COLON, Element, finding, name_of_tag, number_list, read_document

_SLIDE = (True, True, False, True, True, True)
_ROWS: dict[str, NamedRows | RowMask] = {
    "fixed": "full",
    "link": "full",
    "spherical": "point",
    "ball": "point",
    "revolute": "axis",
    "continuous": "axis",
    "prismatic": _SLIDE,
}
"""Held rows by type, in axes of C; for the last three z is along the axis."""

_ELEMENTS = frozenset(
    (
        "loop_joint",
        "loop",
        "constraint",
        "closed_loop",
        "coupling",
        "joint_constraint",
        f"drake{COLON}ball_constraint",
        f"drake{COLON}linear_bushing_rpy",
        f"drake{COLON}tendon_constraint",
    )
)
"""Children of <robot> by which dialects of URDF close loops; a <joint> inside <gazebo> does so, too."""

_MODEL_FRAME = "axis/use_parent_model_frame[not(normalize-space()='0' or normalize-space()='false')]"

_WORLD = "world"
_GIVE = "give it as a Closure of ClosedChain.from_urdf"


class _Dialect(NamedTuple):
    """XPaths of what an element says, from it; empty for what it does not.

    Attributes:
        link_a: name of link A.
        link_b: name of link B.
        pose_a: element with the pose of C in A; None: from the zero configuration.
        pose_b: the same in B.
        axis: three numbers in axes of C.
        unread: elements that cannot be read, and why.
    """

    link_a: str
    link_b: str
    pose_a: str | None
    pose_b: str
    axis: str
    unread: Mapping[str, str] = MappingProxyType({})


_BALL = f"drake{COLON}ball_constraint"
_DIALECTS = {
    "loop_joint": _Dialect("link1/@link", "link2/@link", "link1", "link2", "axis/@xyz"),
    "loop": _Dialect(
        "predecessor/@link", "successor/@link", "predecessor/origin", "successor/origin", "axis/@xyz"
    ),
    "constraint": _Dialect(
        "parent/@link", "child/@link", "parent_origin", "child_origin", "(parent_axis | child_axis)/@xyz"
    ),
    "joint": _Dialect(
        "parent/text()",
        "child/text()",
        None,
        "pose",
        "axis/xyz/text()",
        {
            "parent::gazebo[@reference]": "it is in <gazebo reference=...>, which is part of a link or joint",
            "(pose | axis/xyz)[@*]": "it has attributes; only the default frame can be read",
            _MODEL_FRAME: "its axis is in the parent's model frame; give it in the joint's",
        },
    ),
    _BALL: _Dialect(
        f"{_BALL}_body_A/@name",
        f"{_BALL}_body_B/@name",
        f"{_BALL}_p_AP",
        f"{_BALL}_p_BQ",
        "",
        {f"self::*[not({_BALL}_p_AP/@value and {_BALL}_p_BQ/@value)]": "it must have p_AP and p_BQ"},
    ),
}


class _UnreadError(Exception):
    """Why an element cannot be read as a closure, and the element that says so; never leaves this file."""


@typed
def read_loops(text: str) -> tuple[Closure, ...]:
    """Return the loop closures of the text of a URDF that the check has accepted with its loops."""
    document, robot, loops = read_document(text.encode()), Robot(text), []
    links = {link.get("name") for link in document.iterchildren("link")}
    for element in _loop_elements(document):
        a, b, rows, X_AC, X_BC, X_CZ = _read(element)
        if X_AC is None:
            X_RA, X_RB = (robot.pose(link, {}) if link in links else np.eye(4) for link in (a, b))
            X_AC = inverse_pose(X_RA) @ X_RB @ X_BC
        loops.append(Closure(a, b, rows, X_AC @ X_CZ, X_BC @ X_CZ, element.get("name", "")))
    return tuple(loops)


def loop_findings(robot: Element, tree: Tree, locked: Collection[str]) -> Iterator[UrdfFinding]:
    """Yield one finding for each element that closes a loop: ``loop`` if it can be read as a closure.

    Args:
        robot: the <robot> element.
        tree: tree of the robot.
        locked: names of the locked joints; between parts that they join a loop binds nothing.
    """
    first: dict[str, Element] = {}
    links, bodies, joints = tree.links, tree.bodies(locked), {edge.name: edge for edge in tree.edges()}
    loops = list(_loop_elements(robot))
    within = set(_within(loops, bodies, joints)) if locked else ()
    for element in (loop for loop in loops if loop not in within):
        says, name = f"<{name_of_tag(element)}> closes a loop", element.get("name")
        try:
            a, b = _read(element)[:2]
            if unknown := {a, b} - {*links, _WORLD}:
                message = f"its link {listed(unknown)} is not a link of the file; links: {listed(links)}"
                raise _UnreadError(message, element)
            if a == b:
                raise _UnreadError(f"it joins link {quoted(a)} to itself", element)
            if name and first.setdefault(name, element) is not element:
                raise _UnreadError(f"the same name is used on line {first[name].sourceline}", element)
        except _UnreadError as unread:
            reason, at = unread.args
            message = f"{says} and cannot be read: {reason}; correct it, lock its joints, or {_GIVE}"
            yield finding(element, "loop_unread", message, at=at)
        else:
            message = f"{says}, but an arm is a tree; lock its joints, or use ClosedChain.from_urdf"
            yield finding(element, "loop", message)


def _within(
    loops: Sequence[Element], bodies: Mapping[str, str], joints: Mapping[str, Edge]
) -> Iterator[Element]:
    """Yield the elements that join parts of one body only, in any dialect.

    Links that the file does not have, as of PR2's grippers, may join bodies by several elements together.
    """
    named = [(loop, *_ends(loop, bodies, joints)) for loop in loops]
    groups: list[tuple[set[str], set[str]]] = []  # of unknown links that elements join, and their bodies
    for _, joined, unknown in named:
        links, around = {*unknown}, {*joined}
        for group in [group for group in groups if group[0] & unknown]:
            groups.remove(group)
            links, around = links | group[0], around | group[1]
        groups.append((links, around))
    for loop, joined, unknown in named:
        around = joined.union(*(group[1] for group in groups if group[0] & unknown))
        if len(around) == 1:
            yield loop


def _ends(loop: Element, bodies: Mapping[str, str], joints: Mapping[str, Edge]) -> tuple[set[str], set[str]]:
    """Return the bodies that an element joins, none if it names a single link, and links not in the file."""
    says = _DIALECTS.get(loop.tag)
    if says is not None:
        ends = {value.strip() for path in (says.link_a, says.link_b) for value in loop.xpath(path)}
        return {bodies.get(end, end) for end in ends & {*bodies, _WORLD}}, ends - {*bodies, _WORLD}
    parts = [str(part).strip() for inner in loop.iter() for part in (*inner.values(), inner.text or "")]
    links = {part for part in parts if part in bodies}
    links.update(*({edge.parent, edge.child} for edge in map(joints.get, parts) if edge))
    return ({bodies.get(link, link) for link in links} if len(links) > 1 else set()), set()


def _loop_elements(robot: Element) -> Iterator[Element]:
    for element in robot:
        if element.tag in _ELEMENTS:
            yield element
        elif element.tag == "gazebo":
            yield from (inner for inner in element if inner.tag.partition(COLON)[0] == "joint")


def _read(loop: Element) -> tuple[str, str, NamedRows | RowMask, Array | None, Array, Array]:
    """Return links, rows, X_AC (None: from the zero configuration), X_BC and X_CZ, whose z is along the axis.

    Raises:
        _UnreadError: it cannot be read as a closure.
    """
    says = _DIALECTS.get(loop.tag)
    if says is None:
        raise _UnreadError(f"only {listed(name.replace(COLON, ':') for name in _DIALECTS)} can be", loop)
    for path, message in says.unread.items():
        for element in loop.xpath(path):
            raise _UnreadError(message, element)
    kind = "ball" if loop.tag == _BALL else loop.get("type", "")
    if kind not in _ROWS:
        raise _UnreadError(f"type is {quoted(kind)}; it must be one of {listed(_ROWS, len(_ROWS))}", loop)
    a, b = (_only(loop, path) for path in (says.link_a, says.link_b))
    X_AC = None if says.pose_a is None else _pose(loop, says.pose_a)
    X_BC, X_CZ, rows = _pose(loop, says.pose_b), np.eye(4), _ROWS[kind]
    if rows not in ("full", "point"):
        X_CZ = _along(loop, says.axis)
    return a.strip(), b.strip(), rows, X_AC, X_BC, X_CZ


def _along(loop: Element, path: str) -> Array:
    """Return a pose whose z axis is along the axis of a loop; the identity for z itself, shape (4, 4)."""
    axes = {_numbers(value, 3): value.getparent() for value in loop.xpath(path)}
    if len(axes) != 1:
        raise _UnreadError(f"it has {len(axes)} different axes; it must have one", loop)
    for axis, element in axes.items():
        z = np.array(axis)
        if not z.any():
            raise _UnreadError("the axis is zero; give a direction", element)
    z /= np.abs(z).max()
    z /= np.linalg.norm(z)
    X, k = np.eye(4), int(np.argmin(np.abs(z)))
    x = np.eye(3)[k] - z[k] * z
    x /= np.linalg.norm(x)
    X[:3, :3] = np.column_stack((x, np.cross(z, x), z))
    return X


def _only(loop: Element, path: str) -> Any:
    """Return the only value at a path."""
    values = [value for value in loop.xpath(path) if value.strip()]
    if len(values) != 1:
        message = f"it has {len(values)} {path.replace(COLON, ':')}; it must have one"
        raise _UnreadError(message, values[-1].getparent() if values else loop)
    return values[0]


def _pose(loop: Element, path: str) -> Array:
    """Return the pose that the element at a path says: xyz and rpy, six numbers, or a point; or identity."""
    pose = np.zeros(6)
    point = "@*[name()='xyz' or name()='value']"
    for text, places in ((point, slice(3)), ("@rpy", slice(3, 6)), ("self::pose/text()", slice(6))):
        for value in loop.xpath(f"({path})/{text}"):
            pose[places] = _numbers(value, len(pose[places]))
    return make_pose(pose[:3], pose[3:])


def _numbers(value: Any, count: int) -> tuple[float, ...]:
    text = " ".join(value.split())
    if (numbers := number_list(text, count)) is not None:
        return numbers
    element = value.getparent()
    where = f"{value.attrname or 'text'} of <{name_of_tag(element)}>"
    raise _UnreadError(f"{where} is {quoted(text)}; it must be {count} finite numbers", element)
