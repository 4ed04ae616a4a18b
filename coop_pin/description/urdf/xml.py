"""The XML of a URDF, read with limits: hostile text ends in a finding, never in a crash or a full memory."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import NamedTuple
from xml.parsers import expat

from coop_pin.description.urdf.report import EXPAND, UrdfFinding, quoted, structural

MAX_BYTES = 5_000_000
"""Largest file that is read; the largest of example-robot-data has 0.2 MB."""

MAX_ELEMENTS = 100_000
"""Most XML elements that are read; the largest file of example-robot-data has 4 000."""

MAX_NESTING = 100
"""Deepest nesting of XML elements; real files stay below 10."""

_XML_WORDS = {
    expat.errors.codes[
        expat.errors.XML_ERROR_NO_ELEMENTS
    ]: "the file ends before all elements are closed; is </robot> missing?",
    expat.errors.codes[
        expat.errors.XML_ERROR_TAG_MISMATCH
    ]: "this end tag does not fit the element that is open; is an end tag missing above?",
    expat.errors.codes[
        expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT
    ]: "something follows </robot>; remove it",
}
"""The commonest complaints of the XML reader in plain words."""

_READ = frozenset({"link", "joint", "material"})
"""Children of <robot> that Pinocchio reads; gazebo, transmission and the like are passed over."""

_BROKEN_VALUE = re.compile(rb"""=\s*(?:"[^"]*?[\t\r\n]|'[^']*?[\t\r\n])""")
"""An attribute whose value holds a tab or a line break: XML makes it a blank, Pinocchio's reader does not."""


class Node(NamedTuple):
    """One XML element.

    Attributes:
        tag: its name.
        attributes: its attributes.
        line: line of the file, from 1.
        broken: an attribute's value holds a tab or a line break.
        children: the elements in it.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    broken: bool
    children: list[Node]

    @property
    def name(self) -> str:
        """The name attribute, empty where there is none."""
        return self.attributes.get("name", "")

    @property
    def label(self) -> str:
        """The element as findings call it: "link 'x'", or only "robot"."""
        if self.tag == "robot":
            return "robot"
        return f"{self.tag} {quoted(self.name)}" if self.name else f"{self.tag} (unnamed)"

    def child(self, tag: str) -> Node | None:
        """Return the first child of a tag, as Pinocchio does."""
        return next((child for child in self.children if child.tag == tag), None)

    def family(self) -> Iterator[Node]:
        """Yield the node and everything in it."""
        waiting = [self]
        while waiting:
            node = waiting.pop()
            yield node
            waiting.extend(reversed(node.children))


class Document(NamedTuple):
    """What was read.

    Attributes:
        robot: the <robot> element, or None where the document has none that can be used.
        findings: what is wrong; they say why there is none.
    """

    robot: Node | None
    findings: tuple[UrdfFinding, ...]


class _RefusedError(Exception):
    """Ends the reading of a document; never leaves this file."""

    def __init__(self, finding: UrdfFinding) -> None:
        self.finding = finding
        super().__init__(finding)


def read_document(data: bytes) -> Document:
    """Return the links, joints and materials of a URDF, or the finding that says why it is not one."""
    try:
        _require_text(data)
        reader = _Reader(data)
        reader.read()
    except _RefusedError as refused:
        return Document(None, (refused.finding,))
    return Document(reader.robot, ())


def _refuse(code: str, line: int, message: str) -> _RefusedError:
    return _RefusedError(structural(code, "document", line, message))


def _require_text(data: bytes) -> None:
    if len(data) > MAX_BYTES:
        raise _refuse(
            "size",
            0,
            f"the file is larger than {MAX_BYTES} bytes; meshes and textures belong in files of their own",
        )
    if not data.strip():
        raise _refuse("empty", 0, "the file is empty; a URDF starts with <robot name=...>")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise _refuse(
            "encoding", line, f"byte {error.start} is not UTF-8; save the file as UTF-8 text"
        ) from None
    if b"\0" in data:
        index = data.index(b"\0")
        raise _refuse(
            "encoding", data.count(b"\n", 0, index) + 1, f"byte {index} is NUL; a URDF is UTF-8 text"
        )


class _Reader:
    """An expat parser that keeps what Pinocchio reads and stops at the first sign of harm."""

    def __init__(self, data: bytes) -> None:
        self.robot: Node | None = None
        self._data = data
        self._count = 0
        self._path: list[Node | None] = []
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end

    def read(self) -> None:
        """Read the document.

        Raises:
            _RefusedError: it is not a URDF.
        """
        try:
            self._parser.Parse(self._data, True)
        except expat.ExpatError as error:
            raise _refuse(
                "not_xml",
                error.lineno,
                f"not well-formed XML: {_XML_WORDS.get(error.code) or expat.ErrorString(error.code)}",
            ) from None

    def _doctype(self, *_: object) -> None:
        line = self._parser.CurrentLineNumber
        raise _refuse(
            "doctype",
            line,
            "a DOCTYPE and its entities are refused: they can read other files or fill the memory; remove it",
        )

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise _refuse(
                "elements",
                line,
                f"more than {MAX_ELEMENTS} XML elements; the robots of a whole scene belong in files of their own",
            )
        if len(self._path) >= MAX_NESTING:
            raise _refuse(
                "nesting",
                line,
                f"XML elements nest deeper than {MAX_NESTING}; those of a URDF nest 5 deep or so",
            )
        if tag.startswith("xacro:"):
            raise _refuse("xacro", line, f"{quoted(tag)} is a xacro that is not expanded; {EXPAND}")
        if not self._path and tag != "robot":
            raise _refuse("root", line, f"the root element is {quoted(tag)}; that of a URDF is 'robot'")
        self._path.append(self._keep(tag, attributes, line))

    def _keep(self, tag: str, attributes: dict[str, str], line: int) -> Node | None:
        parent = self._path[-1] if self._path else None
        if self._path and (parent is None or (len(self._path) == 1 and tag not in _READ)):
            return None
        node = Node(tag, attributes, line, self._has_broken_value(), [])
        if parent is None:
            self.robot = node
        else:
            parent.children.append(node)
        return node

    def _has_broken_value(self) -> bool:
        start = self._parser.CurrentByteIndex
        return _BROKEN_VALUE.search(self._data, start, self._data.index(b">", start)) is not None

    def _end(self, _: str) -> None:
        self._path.pop()


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
                yield structural(
                    problem.code, owner.label, node.line, f"{attribute} of <{node.tag}> {problem.message}"
                )


def is_unexpanded(text: str) -> bool:
    """Return whether an attribute's value is an expression of xacro."""
    return "${" in text or "$(" in text


def _pieces(text: str, count: int) -> list[str]:
    # A trailing blank is harmless in a vector; in a scalar Pinocchio's reader takes the value for no number.
    return [text.lstrip(" ")] if count == 1 else [piece for piece in text.split(" ") if piece]


def _problem(text: str, count: int) -> _Problem | None:
    pieces = _pieces(text, count)
    if len(pieces) != count:
        return _Problem(
            "count", f"is {quoted(text)}: {len(pieces)} numbers; it must have {count}, separated by blanks"
        )
    for piece in pieces:
        if _NOT_FINITE.fullmatch(piece):
            return _Problem("not_finite", f"is {quoted(text)}; it must be finite")
        if not _NUMBER.fullmatch(piece):
            return _Problem(
                "number", f"is {quoted(text)}; it must be a plain decimal number without trailing blanks"
            )
        if not math.isfinite(float(piece)):
            return _Problem(
                "not_finite", f"is {quoted(text)}, beyond the range of a float; it must be finite"
            )
    return None
