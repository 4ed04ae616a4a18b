"""Numbers of a URDF: how many each attribute has, and what is malformed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from coop_pin.description.urdf.report import UrdfFinding, quoted
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
"""Number of values of each numeric attribute, by element."""

_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:e[+-]?[0-9]+)?|nan|inf|infinity)",
    re.IGNORECASE | re.ASCII,
)


def numbers(node: Node | None, attribute: str) -> tuple[float, ...] | None:
    """Return the numbers of an attribute, or None if they are absent or malformed (see number_findings)."""
    if node is None or attribute not in node.attributes:
        return None
    return number_list(node.attributes[attribute], COUNTS[node.tag][attribute])


def number_list(text: str, count: int) -> tuple[float, ...] | None:
    """Return the numbers of a text, or None if they are malformed or not as many as they must be."""
    return None if _problem(text, count) else tuple(map(float, _pieces(text, count)))


def number(node: Node | None, attribute: str) -> float | None:
    """Return the single number of an attribute, or None if it is absent or malformed."""
    values = numbers(node, attribute)
    return values[0] if values else None


def number_findings(owner: Node) -> Iterator[UrdfFinding]:
    """Yield malformed numbers of a link or joint; Pinocchio silently reads many of them as zero."""
    # Pinocchio never reads the axis of a joint that has none, and many files have "0 0 0" there.
    unread = owner.child("axis") if owner.attributes.get("type") in ("fixed", "floating") else None
    for node in owner.family():
        for attribute, count in COUNTS.get(node.tag, {}).items():
            text = node.attributes.get(attribute)
            if text is None or node is unread or is_unexpanded(text):
                continue
            if problem := _problem(text, count):
                code, message = problem
                yield owner.finding(code, f"{attribute} of <{node.tag}> is {quoted(text)}{message}", at=node)


def is_unexpanded(text: str) -> bool:
    """Return whether the value of an attribute is a xacro expression."""
    return "${" in text or "$(" in text


def _pieces(text: str, count: int) -> list[str]:
    # A trailing blank is harmless in a vector; Pinocchio's parser does not read a scalar that has one.
    return [text.lstrip(" ")] if count == 1 else [piece for piece in text.split(" ") if piece]


def _problem(text: str, count: int) -> tuple[str, str] | None:
    """Return code and message of the first malformed number, or None."""
    pieces = _pieces(text, count)
    if len(pieces) != count:
        return "count", f": {len(pieces)} numbers; it must have {count}, separated by blanks"
    for piece in pieces:
        if not _NUMBER.fullmatch(piece):
            return "number", "; it must be a plain decimal number without trailing blanks"
        if not math.isfinite(float(piece)):
            return "not_finite", "; it must be finite and within the range of a float"
    return None
