"""Text of a URDF to lxml elements, with limits.

Malformed or hostile text gives a finding, never a crash or exhausted memory. Pinocchio's parser knows no
namespaces: prefixes are part of the names here, with ``COLON`` for the colon, which lxml does not allow.
"""

from __future__ import annotations

import itertools
import re

from lxml import etree
from lxml.etree import _Element as Element

from coop_pin.description.urdf.report import Kind, UrdfFinding, quoted

MAX_BYTES = 5_000_000
"""Size limit of a file; the largest of example-robot-data has 0.2 MB."""

MAX_ELEMENTS = 100_000
"""Limit of the number of XML elements; the largest file of example-robot-data has 4 000."""

MAX_NESTING = 100
"""Limit of the nesting depth of XML elements; real files stay below 10."""

COLON = "\u00b7"

EXPAND = "rename the file so that it ends in .xacro, or run xacro on it and use its output"
"""Advice for a xacro file that is used as a URDF."""

_DOCTYPE = re.compile(rb"(?:\xef\xbb\xbf)?(?>\s+|<\?.*?\?>|<!--.*?-->)*+<!DOCTYPE", re.DOTALL)
_START = re.compile(rb"<[^\s!?/]")
_TAG = re.compile(rb"</?[^\s<>!?/\"'](?>[^<>\"']+|\"[^<\"]*\"|'[^<']*')*+>")
_PIECE = re.compile(rb"\"[^\"]*\"|'[^']*'|\bxmlns\b|[:\r\n]")
"""What is rewritten in a tag: values, declarations of namespaces, colons and line breaks."""

_LIMITS = {"resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False}


class DocumentError(Exception):
    """A text that is no URDF; never leaves the package.

    Attributes:
        finding: why it is none.
    """

    def __init__(self, code: str, line: int, message: str) -> None:
        self.finding = UrdfFinding("structural", code, "document", line, message)
        super().__init__(message)


def read_document(data: bytes) -> Element:
    """Return the <robot> element of a URDF; the ``sourceline`` of an element is where its tag starts.

    Raises:
        DocumentError: there is none, or a limit is violated.
    """
    _require_text(data)
    parser = etree.XMLParser(encoding="utf-8", remove_comments=True, remove_pis=True, **_LIMITS)
    try:
        robot = etree.fromstring(_TAG.sub(_flat, data), parser)
    except etree.XMLSyntaxError as error:
        is_limit = error.code == etree.ErrorTypes.ERR_RESOURCE_LIMIT
        message = f"not well-formed XML: {str(error.msg).rpartition(', line')[0]}"
        raise DocumentError("nesting" if is_limit else "not_xml", error.lineno or 0, message) from None
    if robot.tag != "robot":
        message = f"the root element is {quoted(robot.tag)}; the root element of a URDF is 'robot'"
        raise DocumentError("root", _line(robot), message)
    for deep in robot.xpath(f"//*[count(ancestor::*) >= {MAX_NESTING}]"):
        message = f"XML elements are nested more than {MAX_NESTING} deep; a URDF needs about 5 levels"
        raise DocumentError("nesting", _line(deep), message)
    for macro in robot.xpath(f"//*[starts-with(name(), 'xacro{COLON}')]"):
        message = f"{quoted(name_of_tag(macro))} is a xacro that is not expanded; {EXPAND}"
        raise DocumentError("xacro", _line(macro), message)
    return robot


def _require_text(data: bytes) -> None:
    def refuse(code: str, at: int, message: str) -> None:
        raise DocumentError(code, data.count(b"\n", 0, at) + 1, message)

    if len(data) > MAX_BYTES:
        advice = "put meshes and textures into files of their own"
        raise DocumentError("size", 0, f"the file is larger than {MAX_BYTES} bytes; {advice}")
    if not data.strip():
        raise DocumentError("empty", 0, "the file is empty; a URDF starts with <robot name=...>")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        refuse("encoding", error.start, f"byte {error.start} is not UTF-8; save the file as UTF-8 text")
    if (index := data.find(b"\0")) >= 0:
        refuse("encoding", index, f"byte {index} is NUL; a URDF is UTF-8 text")
    if doctype := _DOCTYPE.match(data):
        message = "a DOCTYPE is not allowed: its entities can read other files or fill the memory; remove it"
        refuse("doctype", doctype.end(), message)
    if start := next(itertools.islice(_START.finditer(data), MAX_ELEMENTS, None), None):
        advice = "put each robot of a scene into a file of its own"
        refuse("elements", start.start(), f"more than {MAX_ELEMENTS} XML elements; {advice}")


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
    return re.sub(rb"[\t\r\n]", lambda blank: b"&#%d;" % ord(blank[0]), piece[0]) if piece[0].strip() else b" "


def name_of_tag(element: Element) -> str:
    """Return the tag of an element as it is in the file."""
    return element.tag.replace(COLON, ":")


def _line(element: Element) -> int:
    return element.sourceline or 0


def finding(
    element: Element, code: str, message: str, *, at: Element | None = None, kind: Kind = "structural"
) -> UrdfFinding:
    """Return a finding about an element.

    Args:
        element: the link, joint or loop that has the defect, or the robot.
        code: short name of the defect.
        message: what is wrong.
        at: the element inside it whose line is named; the element itself when omitted.
        kind: severity class.
    """
    name = element.get("name", "")
    label = f"{name_of_tag(element)} {quoted(name) if name else '(unnamed)'}"
    line = _line(element if at is None else at)
    return UrdfFinding(kind, code, "robot" if element.tag == "robot" else label, line, message)
