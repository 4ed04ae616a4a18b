"""Text of a URDF to lxml elements, with limits; the numbers in their attributes.

Malformed or hostile text gives a finding, never a crash or exhausted memory. Pinocchio's parser knows no
namespaces: prefixes are part of the names here, with ``COLON`` for the colon, which lxml does not allow.
"""

from __future__ import annotations

import math
import re
from typing import Any, TypeAlias

from lxml import etree

from coop_pin.description.urdf.report import Kind, UrdfFinding, quoted

Element: TypeAlias = Any
"""lxml.etree._Element; lxml has no types."""

MAX_BYTES = 5_000_000
"""Size limit of a file; the largest of example-robot-data has 0.2 MB."""

MAX_ELEMENTS = 100_000
"""Limit of the number of XML elements; the largest file of example-robot-data has 4 000."""

MAX_NESTING = 100
"""Limit of the nesting depth of XML elements; real files stay below 10."""

COLON = "\u00b7"

EXPAND = "rename the file so that it ends in .xacro, or run xacro on it and use its output"
"""Advice for a xacro file that is used as a URDF."""

_REFUSED_TEXT = (
    ("encoding", re.compile(rb"[^\0]*+\0"), "a byte is NUL; a URDF is UTF-8 text"),
    (
        "doctype",
        re.compile(rb"(?:\xef\xbb\xbf)?(?>\s+|<\?.*?\?>|<!--.*?-->)*+<!DOCTYPE", re.DOTALL),
        "a DOCTYPE is not allowed: its entities can read other files or fill the memory; remove it",
    ),
    (
        "elements",
        re.compile(rb"(?:(?>[^<]+|<[\s!?/])*+<[^\s!?/]){%d}" % (MAX_ELEMENTS + 1)),
        f"more than {MAX_ELEMENTS} XML elements; put each robot of a scene into a file of its own",
    ),
)
"""Beginnings of texts that are refused."""

_DECLARATION = re.compile(rb"\A(?:\xef\xbb\xbf)?<\?xml\b[^>\n]*\?>")
"""XML declaration, which Pinocchio's parser does not read: many files have version 0.0, or none."""
_TAG = re.compile(rb"</?[^\s<>!?/\"'](?>[^<>\"']+|\"[^<\"]*\"|'[^<']*')*+>")
_PIECE = re.compile(rb"\"[^\"]*\"|'[^']*'|\bxmlns\b|[:\r\n]")
"""What is rewritten in a tag: values, declarations of namespaces, colons and line breaks."""

_REFUSED = (
    ("root", "/*[name() != 'robot']", "the root element is {}; the root element of a URDF is 'robot'"),
    (
        "nesting",
        f"//*[count(ancestor::*) >= {MAX_NESTING}]",
        f"{{}} is nested more than {MAX_NESTING} deep; a URDF needs about 5 levels",
    ),
    (
        "xacro",
        f"//*[starts-with(name(), 'xacro{COLON}')]",
        f"{{}} is a xacro that is not expanded; {EXPAND}",
    ),
)


class DocumentError(Exception):
    """Code, line and message of why a text is no URDF; never leaves the package."""


def read_document(data: bytes) -> Element:
    """Return the <robot> element of a URDF; the ``sourceline`` of an element is where its tag starts.

    Raises:
        DocumentError: there is none, or a limit is violated.
    """
    _require_text(data)
    parser = etree.XMLParser(
        encoding="utf-8",
        remove_comments=True,
        remove_pis=True,
        resolve_entities=False,
        no_network=True,
    )
    try:
        robot = etree.fromstring(_TAG.sub(_flat, _DECLARATION.sub(b"", data, 1)), parser)
    except etree.XMLSyntaxError as error:
        is_limit = error.code == etree.ErrorTypes.ERR_RESOURCE_LIMIT
        message = f"not well-formed XML: {str(error.msg).rpartition(', line')[0]}"
        raise DocumentError("nesting" if is_limit else "not_xml", error.lineno or 0, message) from None
    for code, path, message in _REFUSED:
        for element in robot.xpath(path):
            raise DocumentError(code, element.sourceline or 0, message.format(quoted(name_of_tag(element))))
    return robot


def _require_text(data: bytes) -> None:
    if len(data) > MAX_BYTES:
        advice = "put meshes and textures into files of their own"
        raise DocumentError("size", 0, f"the file is larger than {MAX_BYTES} bytes; {advice}")
    if not data.strip():
        raise DocumentError("empty", 0, "the file is empty; a URDF starts with <robot name=...>")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        message = f"byte {error.start} is not UTF-8; save the file as UTF-8 text"
        raise DocumentError("encoding", data.count(b"\n", 0, error.start) + 1, message) from None
    for code, pattern, message in _REFUSED_TEXT:
        if match := pattern.match(data):
            raise DocumentError(code, data.count(b"\n", 0, match.end()) + 1, message)


def _flat(tag: re.Match[bytes]) -> bytes:
    """Return a tag without namespaces and on one line, so that libxml2, which names its end, tells its start.

    Tabs and line breaks in values become references to characters, which XML does not turn into blanks:
    neither does Pinocchio's parser.
    """
    return _PIECE.sub(_flat_piece, tag[0]) + b"\n" * tag[0].count(b"\n")


def _flat_piece(piece: re.Match[bytes]) -> bytes:
    if piece[0] == b":":
        return COLON.encode()
    if piece[0] == b"xmlns":
        return b"xmlns_"
    return (
        re.sub(rb"[\t\r\n]", lambda blank: b"&#%d;" % ord(blank[0]), piece[0]) if piece[0].strip() else b" "
    )


def text_of(robot: Element) -> str:
    """Return the text of a <robot> as Pinocchio reads it; prefixes stay parts of the names."""
    return str(etree.tostring(robot, encoding="unicode"))


def name_of_tag(element: Element) -> str:
    """Return the tag of an element as it is in the file."""
    return element.tag.replace(COLON, ":")


def finding(
    element: Element, code: str, message: str, *, at: Element | None = None, kind: Kind = "structural"
) -> UrdfFinding:
    """Return a finding about an element.

    Args:
        element: the link, joint or loop that has the defect, or the robot.
        code: short name of the defect.
        message: text that says what is wrong.
        at: the element inside it whose line is named; the element itself when omitted.
        kind: severity class.
    """
    name = element.get("name", "")
    label = f"{name_of_tag(element)} {quoted(name) if name else '(unnamed)'}"
    line = (element if at is None else at).sourceline or 0
    return UrdfFinding(kind, code, "robot" if element.tag == "robot" else label, line, message)


# ---------------------------------------------------------------- numbers

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
    """Return the numbers of an attribute, or None if they are absent or malformed."""
    if element is None or attribute not in element.attrib:
        return None
    return number_list(element.attrib[attribute], COUNTS[element.tag][attribute])


def number_list(text: str, count: int) -> tuple[float, ...] | None:
    """Return the numbers of a text, or None if they are malformed or not as many as they must be."""
    return None if number_problem(text, count) else tuple(map(float, _pieces(text, count)))


def number(element: Element | None, attribute: str) -> float | None:
    """Return the single number of an attribute, or None if it is absent or malformed."""
    values = numbers(element, attribute)
    return values[0] if values else None


def number_problem(text: str, count: int) -> str:
    """Return "count", "number" or "not_finite" if numbers are malformed; Pinocchio reads many as zero."""
    pieces = _pieces(text, count)
    if len(pieces) != count:
        return "count"
    if not all(map(_NUMBER.fullmatch, pieces)):
        return "number"
    return "" if all(map(math.isfinite, map(float, pieces))) else "not_finite"


def _pieces(text: str, count: int) -> list[str]:
    # Tabs and line breaks are a finding of their own. A trailing blank is harmless in a vector; Pinocchio's
    # parser does not read a scalar that has one.
    blank = re.sub(r"[\t\r\n]", " ", text)
    return [blank.lstrip(" ")] if count == 1 else [piece for piece in blank.split(" ") if piece]
