"""What a check of a URDF found: findings, and the report that holds them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

SHOWN_CHARACTERS = 60
"""Longest piece of a file that a message quotes."""

SHOWN_FINDINGS = 100
"""Most findings that a report writes out; the rest are counted."""


EXPAND = "give the file a name that ends in .xacro, or run xacro on it and use its output"
"""What to do about a xacro that stands where a URDF should."""


class UrdfFinding(NamedTuple):
    """One defect of a URDF.

    Attributes:
        kind: "structural" (the file does not say what Pinocchio would read), "physical" (no such body exists)
            or "doubtful" (it can be read, but is hardly meant).
        code: short name of the defect; the package's docstring lists them.
        element: "link 'x'", "joint 'y'", "robot" or "document".
        line: line of the file, from 1; 0 where the file as a whole is meant.
        message: what is wrong, with value, allowed and what to do.
    """

    kind: Literal["structural", "physical", "doubtful"]
    code: str
    element: str
    line: int
    message: str

    def __str__(self) -> str:
        """Return the finding as one line of text."""
        return f"line {self.line}: {self.element}: {self.message} [{self.code}]"


@dataclass(frozen=True)
class UrdfReport:
    """Everything that a check found in one file.

    Attributes:
        source: the file's name, for messages.
        findings: the findings by line.
    """

    source: str
    findings: tuple[UrdfFinding, ...]

    def errors(self, strict: bool = False) -> tuple[UrdfFinding, ...]:
        """Return the findings that forbid the file: the structural ones, and the physical ones when strict."""
        return tuple(
            finding
            for finding in self.findings
            if finding.kind == "structural" or (strict and finding.kind == "physical")
        )

    def warnings(self, strict: bool = False) -> tuple[UrdfFinding, ...]:
        """Return the findings that only call for attention: the doubtful ones, and the physical ones unless strict."""
        return tuple(
            finding
            for finding in self.findings
            if finding.kind == "doubtful" or (not strict and finding.kind == "physical")
        )

    def lines(self, strict: bool = False) -> tuple[str, ...]:
        """Return the report as lines of plain text: errors, warnings, and a closing count."""
        errors, warnings = self.errors(strict), self.warnings(strict)
        shown = [f"error: {finding}" for finding in errors] + [f"warning: {finding}" for finding in warnings]
        if len(shown) > SHOWN_FINDINGS:
            shown[SHOWN_FINDINGS:] = [f"... and {len(shown) - SHOWN_FINDINGS} more"]
        return (*shown, f"{self.source}: {_count(len(errors), 'error')}, {_count(len(warnings), 'warning')}")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def structural(code: str, element: str, line: int, message: str) -> UrdfFinding:
    """Return a structural finding."""
    return UrdfFinding("structural", code, element, line, message)


def physical(code: str, element: str, line: int, message: str) -> UrdfFinding:
    """Return a physical finding."""
    return UrdfFinding("physical", code, element, line, message)


def doubtful(code: str, element: str, line: int, message: str) -> UrdfFinding:
    """Return a doubtful finding."""
    return UrdfFinding("doubtful", code, element, line, message)


def quoted(text: str) -> str:
    """Return a piece of a file for a message: in quotes, printable and short."""
    short = text if len(text) <= SHOWN_CHARACTERS else text[:SHOWN_CHARACTERS] + "..."
    return repr(short)


def listed(names: Iterable[str], most: int = 5) -> str:
    """Return the first few names of many, quoted."""
    every = tuple(names)
    return ", ".join(map(quoted, every[:most])) + (
        f" and {len(every) - most} more" if len(every) > most else ""
    )
