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

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.urdf.numbers import number_list
from coop_pin.description.urdf.report import UrdfFinding, listed, quoted
from coop_pin.description.urdf.robot import Robot
from coop_pin.description.urdf.xml import LOOP, TEXT, Node, read_document
from coop_pin.spatial import inverse_pose, make_pose

LoopRows = Literal["full", "point", "axis"] | tuple[bool, ...]

_SLIDE = (True, True, False, True, True, True)
_ROWS: dict[str, LoopRows] = {
    "fixed": "full",
    "link": "full",
    "spherical": "point",
    "ball": "point",
    "revolute": "axis",
    "continuous": "axis",
    "prismatic": _SLIDE,
}
"""Held rows by type, in axes of C; for the last three z is along the axis."""

_WORLD = "world"
_GIVE = "give it as a Closure of ClosedChain.from_urdf"


class UrdfLoop(NamedTuple):
    """Loop closure of a URDF, with the fields of a coop_pin.Closure.

    Attributes:
        link_a: name of link A, or "world".
        link_b: name of link B, or "world".
        rows: which relative motions are held, in axes of C.
        X_AC: pose of C in A, shape (4, 4).
        X_BC: pose of C in B, shape (4, 4).
        name: in the file; empty if it has none.
    """

    link_a: str
    link_b: str
    rows: LoopRows
    X_AC: Array
    X_BC: Array
    name: str


class _Stated(NamedTuple):
    """What an element says: links, poses of its frame in them (None: from the zero configuration), axis."""

    link_a: str
    link_b: str
    X_AC: Array | None
    X_BC: Array
    axis: Node | None


class _UnreadError(Exception):
    """Says why an element cannot be read as a closure; never leaves this file."""

    def __init__(self, message: str, at: Node) -> None:
        self.message, self.at = message, at
        super().__init__(message)


def read_loops(text: str) -> tuple[UrdfLoop, ...]:
    """Return the loop closures of the text of a URDF that the check has accepted with its loops."""
    document, robot = read_document(text.encode()), Robot(text)
    assert isinstance(document, Node)
    links, zero, loops = _links(document), dict.fromkeys(robot.joints, 0.0), []
    for node in _loop_nodes(document):
        stated, rows, X_CZ = _read(node)
        a, b, X_AC, X_BC, _ = stated
        if X_AC is None:
            X_RA, X_RB = (robot.pose(link, zero) if link in links else np.eye(4) for link in (a, b))
            X_AC = inverse_pose(X_RA) @ X_RB @ X_BC
        loops.append(UrdfLoop(a, b, rows, X_AC @ X_CZ, X_BC @ X_CZ, node.name))
    return tuple(loops)


def loop_findings(robot: Node) -> Iterator[UrdfFinding]:
    """Yield one finding for each element that closes a loop: ``loop`` if it can be read as a closure."""
    links, first = _links(robot), dict[str, int]()
    for node in _loop_nodes(robot):
        tag = node.attributes["element"]
        try:
            stated, _, _ = _read(node)
            for link in stated[:2]:
                if link not in links | {_WORLD}:
                    raise _UnreadError(
                        f"its link {quoted(link)} is not a link of the file; links: {listed(links)}", node
                    )
            if stated.link_a == stated.link_b:
                raise _UnreadError(f"it joins link {quoted(stated.link_a)} to itself", node)
            if node.name and first.setdefault(node.name, node.line) != node.line:
                raise _UnreadError(f"the same name is used on line {first[node.name]}", node)
        except _UnreadError as unread:
            message = f"<{tag}> closes a loop and cannot be read: {unread.message}; correct it, or {_GIVE}"
            yield node.finding("loop_unread", message, at=unread.at)
        else:
            message = (
                f"<{tag}> closes a loop, but an arm is a tree; remove it (ClosedChain.from_urdf reads it)"
            )
            yield node.finding("loop", message)


def _links(robot: Node) -> set[str]:
    return {node.name for node in robot.children if node.tag == "link"}


def _loop_nodes(robot: Node) -> list[Node]:
    return [node for node in robot.children if node.tag == LOOP]


def _read(loop: Node) -> tuple[_Stated, LoopRows, Array]:
    """Return what an element says, its rows, and the pose in its frame of C, whose z is along the axis.

    Raises:
        _UnreadError: it cannot be read as a closure.
    """
    tag = loop.attributes["element"]
    if tag not in _DIALECTS:
        raise _UnreadError(f"only {listed(_DIALECTS)} can be", loop)
    stated = _DIALECTS[tag](loop)
    kind = "ball" if tag == "drake:ball_constraint" else loop.attributes.get("type", "")
    if kind not in _ROWS:
        raise _UnreadError(f"type is {quoted(kind)}; it must be one of {listed(_ROWS, len(_ROWS))}", loop)
    rows = _ROWS[kind]
    if rows in ("full", "point"):
        return stated, rows, np.eye(4)
    if stated.axis is None:
        raise _UnreadError(f"a {kind} loop must have an axis", loop)
    attribute = TEXT if stated.axis.tag == "xyz" else "xyz"
    z = np.array(_numbers(stated.axis, attribute, 3))
    if not z.any():
        raise _UnreadError("the axis is zero; give a direction", stated.axis)
    z /= np.abs(z).max()
    return stated, rows, _along(z / np.linalg.norm(z))


def _along(z: Array) -> Array:
    """Return a pose whose z axis is a unit vector; the identity for z itself, shape (4, 4)."""
    X, k = np.eye(4), int(np.argmin(np.abs(z)))
    x = np.eye(3)[k] - z[k] * z
    x /= np.linalg.norm(x)
    X[:3, :3] = np.column_stack((x, np.cross(z, x), z))
    return X


# ---------------------------------------------------------------- dialects


def _loop_joint(loop: Node) -> _Stated:
    a, b = _child(loop, "link1"), _child(loop, "link2")
    return _Stated(_attribute(a, "link"), _attribute(b, "link"), _pose(a), _pose(b), loop.child("axis"))


def _urdf_plus_loop(loop: Node) -> _Stated:
    a, b = _child(loop, "predecessor"), _child(loop, "successor")
    X_AC, X_BC = _pose(a.child("origin")), _pose(b.child("origin"))
    return _Stated(_attribute(a, "link"), _attribute(b, "link"), X_AC, X_BC, loop.child("axis"))


def _constraint(loop: Node) -> _Stated:
    a, b = _child(loop, "parent"), _child(loop, "child")
    axis, other = loop.child("parent_axis"), loop.child("child_axis")
    if axis is not None and other is not None and _numbers(axis, "xyz", 3) != _numbers(other, "xyz", 3):
        raise _UnreadError("child_axis differs from parent_axis; turn child_origin instead", other)
    X_AC, X_BC = _pose(loop.child("parent_origin")), _pose(loop.child("child_origin"))
    return _Stated(_attribute(a, "link"), _attribute(b, "link"), X_AC, X_BC, axis)


def _sdformat_joint(loop: Node) -> _Stated:
    if "gazebo_reference" in loop.attributes:
        raise _UnreadError("it is inside <gazebo reference=...>, which is part of a link or joint", loop)
    a, b = (_attribute(_child(loop, tag), TEXT) for tag in ("parent", "child"))
    pose, axis = loop.child("pose"), loop.child("axis")
    xyz = None if axis is None else _child(axis, "xyz")
    for node in filter(None, (pose, xyz)):
        if any(value for key, value in node.attributes.items() if key != TEXT):
            raise _UnreadError(f"<{node.tag}> has attributes; only the default frame can be read", node)
    model_frame = None if axis is None else axis.child("use_parent_model_frame")
    if model_frame is not None and model_frame.attributes.get(TEXT, "").strip() not in ("0", "false"):
        raise _UnreadError("its axis is in the parent's model frame; give it in the joint's", model_frame)
    x, y, z, *rpy = (0.0,) * 6 if pose is None else _numbers(pose, TEXT, 6)
    return _Stated(a, b, None, make_pose((x, y, z), rpy), xyz)


def _drake_ball(loop: Node) -> _Stated:
    prefix = "drake:ball_constraint_"
    a, b = (_attribute(_child(loop, f"{prefix}body_{side}"), "name") for side in "AB")
    p_AP, p_BQ = (_numbers(_child(loop, f"{prefix}p_{point}"), "value", 3) for point in ("AP", "BQ"))
    return _Stated(a, b, make_pose(p_AP), make_pose(p_BQ), None)


_DIALECTS = {
    "loop_joint": _loop_joint,
    "loop": _urdf_plus_loop,
    "constraint": _constraint,
    "joint": _sdformat_joint,
    "drake:ball_constraint": _drake_ball,
}


def _child(node: Node, tag: str) -> Node:
    found = [child for child in node.children if child.tag == tag]
    if len(found) != 1:
        raise _UnreadError(f"it has {len(found)} <{tag}>; it must have one", found[-1] if found else node)
    return found[0]


def _attribute(node: Node, attribute: str) -> str:
    value = node.attributes.get(attribute, "").strip()
    if not value:
        raise _UnreadError(f"<{node.tag}> names no link", node)
    return value


def _pose(node: Node | None) -> Array:
    if node is None:
        return np.eye(4)
    xyz, rpy = (
        _numbers(node, name, 3) if name in node.attributes else (0.0, 0.0, 0.0) for name in ("xyz", "rpy")
    )
    return make_pose(xyz, rpy)


def _numbers(node: Node, attribute: str, count: int) -> tuple[float, ...]:
    text = " ".join(node.attributes.get(attribute, "").split())
    if (values := number_list(text, count)) is None:
        where = f"<{node.tag}>" if attribute == TEXT else f"{attribute} of <{node.tag}>"
        raise _UnreadError(f"{where} is {quoted(text)}; it must be {count} finite numbers", node)
    return values
