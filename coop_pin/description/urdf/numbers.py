"""Numbers of a URDF: how many each attribute has, and what is malformed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from coop_pin.description.urdf.report import UrdfFinding, quoted
from coop_pin.description.urdf.xml import Element, finding

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


def numbers(element: Element | None, attribute: str) -> tuple[float, ...] | None:
    """Return the numbers of an attribute, or None if they are absent or malformed (see number_findings)."""
    if element is None or attribute not in element.attrib:
        return None
    return number_list(element.attrib[attribute], COUNTS[element.tag][attribute])


def number_list(text: str, count: int) -> tuple[float, ...] | None:
    """Return the numbers of a text, or None if they are malformed or not as many as they must be."""
    return None if _problem(text, count) else tuple(map(float, _pieces(text, count)))


def number(element: Element | None, attribute: str) -> float | None:
    """Return the single number of an attribute, or None if it is absent or malformed."""
    values = numbers(element, attribute)
    return values[0] if values else None


def number_findings(owner: Element, element: Element) -> Iterator[UrdfFinding]:
    """Yield malformed numbers of an element in a link or joint; Pinocchio reads many of them as zero."""
    # Pinocchio never reads the axis of a joint that has none, and many files have "0 0 0" there.
    if owner.get("type") in ("fixed", "floating") and element is owner.find("axis"):
        return
    for attribute, count in COUNTS.get(element.tag, {}).items():
        text = element.get(attribute)
        if text is not None and not is_unexpanded(text) and (problem := _problem(text, count)):
            message = f"{attribute} of <{element.tag}> is {quoted(text)}{problem[1]}"
            yield finding(owner, problem[0], message, at=element)


def is_unexpanded(text: str) -> bool:
    """Return whether the value of an attribute is a xacro expression."""
    return "${" in text or "$(" in text


def _pieces(text: str, count: int) -> list[str]:
    # Tabs and line breaks are a finding of their own. A trailing blank is harmless in a vector; Pinocchio's
    # parser does not read a scalar that has one.
    blank = re.sub(r"[\t\r\n]", " ", text)
    return [blank.lstrip(" ")] if count == 1 else [piece for piece in blank.split(" ") if piece]


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
