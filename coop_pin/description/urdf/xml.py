"""XML elements of a URDF, read with limits.

Malformed or hostile text gives a finding, never a crash or exhausted memory.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple
from xml.parsers import expat

from coop_pin.description.urdf.report import Kind, UrdfFinding, quoted

MAX_BYTES = 5_000_000
"""Size limit of a file; the largest of example-robot-data has 0.2 MB."""

MAX_ELEMENTS = 100_000
"""Limit of the number of XML elements; the largest file of example-robot-data has 4 000."""

MAX_NESTING = 100
"""Limit of the nesting depth of XML elements; real files stay below 10."""

_XML_ERRORS = {
    expat.errors.XML_ERROR_NO_ELEMENTS: "the file ends before all elements are closed; is </robot> missing?",
    expat.errors.XML_ERROR_TAG_MISMATCH: (
        "this end tag does not match the open element; is an end tag missing above?"
    ),
    expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "there is text after </robot>; remove it",
}
"""Explanations of the most common messages of expat."""

_READ = frozenset({"link", "joint", "material"})
"""Children of <robot> that Pinocchio reads; gazebo, transmission and the like are skipped."""

_LOOPS = frozenset(
    (
        "loop_joint",
        "loop",
        "constraint",
        "closed_loop",
        "coupling",
        "joint_constraint",
        "drake:ball_constraint",
        "drake:linear_bushing_rpy",
        "drake:tendon_constraint",
    )
)
"""Children of <robot> by which dialects of URDF close loops; a <joint> inside <gazebo> does so, too."""

LOOP = "(loop)"
"""Tag of the node that stands for such an element."""

TEXT = "(text)"
"""Attribute for the text of an element inside such a node."""

_SHOWN_TEXT = 1000
"""Characters from which on more pieces of such a text are dropped; what is read has fewer."""

_BROKEN_VALUE = re.compile(rb"""=\s*(?:"[^"]*?[\t\r\n]|'[^']*?[\t\r\n])""")
"""An attribute value with a tab or line break: XML reads it as a blank, Pinocchio's parser does not."""

EXPAND = "rename the file so that it ends in .xacro, or run xacro on it and use its output"
"""Advice for a xacro file that is used as a URDF."""


class Node(NamedTuple):
    """One XML element.

    Attributes:
        tag: its name.
        attributes: its attributes.
        line: line of the file, from 1.
        broken: whether the value of an attribute contains a tab or a line break.
        children: the elements inside it.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    broken: bool
    children: list[Node]

    @property
    def name(self) -> str:
        """Name attribute, empty if there is none."""
        return self.attributes.get("name", "")

    @property
    def label(self) -> str:
        """Element name in findings: "link 'x'", or "robot" alone."""
        if self.tag == "robot":
            return "robot"
        tag = self.attributes["element"] if self.tag == LOOP else self.tag
        return f"{tag} {quoted(self.name)}" if self.name else f"{tag} (unnamed)"

    def child(self, tag: str) -> Node | None:
        """Return the first child with a tag, as Pinocchio does."""
        return next((child for child in self.children if child.tag == tag), None)

    def family(self) -> Iterator[Node]:
        """Yield the node and all its descendants, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.family()

    def finding(
        self, code: str, message: str, *, at: Node | None = None, kind: Kind = "structural"
    ) -> UrdfFinding:
        """Return a finding about this element.

        Args:
            code: short name of the defect.
            message: what is wrong.
            at: the element inside it whose line is named; the element itself when omitted.
            kind: severity class.
        """
        return UrdfFinding(kind, code, self.label, (at or self).line, message)


class _RefusedError(Exception):
    """Stops the reading of a document; never leaves this file."""

    def __init__(self, code: str, line: int, message: str) -> None:
        self.finding = UrdfFinding("structural", code, "document", line, message)
        super().__init__(message)


def read_document(data: bytes) -> Node | UrdfFinding:
    """Return the <robot> element of a URDF, or the finding that says why there is none.

    Of its children only links, joints and materials are kept, and a node for each element that closes a loop.
    """
    try:
        _require_text(data)
        return _Reader(data).robot
    except _RefusedError as refused:
        return refused.finding


def _require_text(data: bytes) -> None:
    if len(data) > MAX_BYTES:
        advice = "put meshes and textures into files of their own"
        raise _RefusedError("size", 0, f"the file is larger than {MAX_BYTES} bytes; {advice}")
    if not data.strip():
        raise _RefusedError("empty", 0, "the file is empty; a URDF starts with <robot name=...>")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"byte {error.start} is not UTF-8; save the file as UTF-8 text"
        raise _RefusedError("encoding", line, message) from None
    if (index := data.find(b"\0")) >= 0:
        line = data.count(b"\n", 0, index) + 1
        raise _RefusedError("encoding", line, f"byte {index} is NUL; a URDF is UTF-8 text")


class _Reader:
    """Parser that keeps the elements that Pinocchio reads and stops at the first violated limit."""

    def __init__(self, data: bytes) -> None:
        """Parse the document.

        Raises:
            _RefusedError: it is not a URDF.
        """
        self.robot: Node
        self._data = data
        self._count = 0
        self._gazebo: dict[str, str] | None = None
        self._is_loop = False
        self._path: list[Node | None] = []
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartDoctypeDeclHandler = self._doctype
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = lambda _: self._path.pop()
        self._parser.buffer_text = True
        self._parser.CharacterDataHandler = self._text
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            text = expat.ErrorString(error.code)
            message = f"not well-formed XML: {_XML_ERRORS.get(text, text)}"
            raise _RefusedError("not_xml", error.lineno, message) from None

    def _doctype(self, *_: object) -> None:
        message = "a DOCTYPE is not allowed: its entities can read other files or fill the memory; remove it"
        raise _RefusedError("doctype", self._parser.CurrentLineNumber, message)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        self._count += 1
        if self._count > MAX_ELEMENTS:
            advice = "put each robot of a scene into a file of its own"
            raise _RefusedError("elements", line, f"more than {MAX_ELEMENTS} XML elements; {advice}")
        if len(self._path) >= MAX_NESTING:
            message = f"XML elements are nested more than {MAX_NESTING} deep; a URDF needs about 5 levels"
            raise _RefusedError("nesting", line, message)
        if tag.startswith("xacro:"):
            raise _RefusedError("xacro", line, f"{quoted(tag)} is a xacro that is not expanded; {EXPAND}")
        if not self._path and tag != "robot":
            message = f"the root element is {quoted(tag)}; the root element of a URDF is 'robot'"
            raise _RefusedError("root", line, message)
        self._path.append(self._kept(tag, attributes, line))

    def _kept(self, tag: str, attributes: dict[str, str], line: int) -> Node | None:
        parent = self._path[-1] if self._path else None
        depth = len(self._path)
        if depth == 1:
            self._gazebo = attributes if tag == "gazebo" else None
            self._is_loop = tag in _LOOPS
        elif depth == 2 and self._gazebo is not None:
            self._is_loop = tag.partition(":")[0] == "joint"
            if self._is_loop:
                parent = self.robot
                attributes = attributes | {f"gazebo_{key}": value for key, value in self._gazebo.items()}
        if self._is_loop and depth and parent is self.robot:
            attributes, tag = attributes | {"element": tag}, LOOP
        elif depth and (parent is None or (depth == 1 and tag not in _READ)):
            return None
        start = self._parser.CurrentByteIndex
        broken = _BROKEN_VALUE.search(self._data, start, self._data.index(b">", start)) is not None
        node = Node(tag, attributes, line, broken, [])
        if parent is None:
            self.robot = node
        else:
            parent.children.append(node)
        return node

    def _text(self, text: str) -> None:
        """Keep the text of an element inside a loop, in which SDFormat has its values."""
        node = self._path[-1]
        if self._is_loop and node is not None and node.tag != LOOP:
            before = node.attributes.get(TEXT, "")
            if len(before) < _SHOWN_TEXT:
                node.attributes[TEXT] = before + text
