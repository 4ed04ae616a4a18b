"""The numbers of a URDF: which attributes hold them, how many, and whether they are numbers at all."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

from coop_pin.description.urdf.report import UrdfFinding, quoted, structural
from coop_pin.description.urdf.xml import Node

COUNTS: dict[str, dict[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "mass": {"value": 1},
    "inertia": {"ixx": 1, "ixy": 1, "ixz": 1, "iyy": 1, "iyz": 1, "izz": 1},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "calibration": {"rising": 1, "falling": 1},
    "safety_controller": {"soft_lower_limit": 1, "soft_upper_limit": 1, "k_position": 1, "k_velocity": 1},
    "box": {"size": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
}
"""How many numbers each attribute of each element holds."""

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)


class _Problem(NamedTuple):
    code: str
    message: str


def numbers(node: Node | None, attribute: str) -> tuple[float, ...] | None:
    """Return the numbers of an attribute, or None where they are absent or wrong (number_findings says how)."""
    if node is None or attribute not in node.attributes:
        return None
    text = node.attributes[attribute]
    count = COUNTS[node.tag][attribute]
    return None if _problem(text, count) else tuple(map(float, _pieces(text, count)))


def number(node: Node | None, attribute: str) -> float | None:
    """Return the one number of an attribute, or None where it is absent or wrong."""
    values = numbers(node, attribute)
    return values[0] if values else None


def number_findings(owner: Node) -> Iterator[UrdfFinding]:
    """Yield what is wrong with the numbers of a link or joint: Pinocchio takes many of them for zero in silence."""
    # Pinocchio never reads the axis of a joint that has none, and files are full of "0 0 0" there.
    unread = owner.child("axis") if owner.attributes.get("type") in ("fixed", "floating") else None
    for node in owner.family():
        for attribute, count in COUNTS.get(node.tag, {}).items():
            text = node.attributes.get(attribute)
            if text is None or node is unread or is_unexpanded(text):
                continue
            problem = _problem(text, count)
            if problem:
                yield structural(problem.code, owner.label, node.line, f"{attribute} of <{node.tag}> {problem.message}")


def is_unexpanded(text: str) -> bool:
    """Return whether an attribute's value is an expression of xacro."""
    return "${" in text or "$(" in text


def _pieces(text: str, count: int) -> list[str]:
    # A trailing blank is harmless in a vector; in a scalar Pinocchio's reader takes the value for no number.
    return [text.lstrip(" ")] if count == 1 else [piece for piece in text.split(" ") if piece]


def _problem(text: str, count: int) -> _Problem | None:
    pieces = _pieces(text, count)
    if len(pieces) != count:
        return _Problem("count", f"is {quoted(text)}: {len(pieces)} numbers; it must have {count}, separated by blanks")
    for piece in pieces:
        if _NOT_FINITE.fullmatch(piece):
            return _Problem("not_finite", f"is {quoted(text)}; it must be finite")
        if not _NUMBER.fullmatch(piece):
            return _Problem("number", f"is {quoted(text)}; it must be a plain decimal number without trailing blanks")
        if not math.isfinite(float(piece)):
            return _Problem("not_finite", f"is {quoted(text)}, beyond the range of a float; it must be finite")
    return None
