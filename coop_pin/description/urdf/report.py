"""Findings of a URDF check and the report that collects them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

SHOWN_CHARACTERS = 60
"""Most characters of a file that a message quotes."""

SHOWN_FINDINGS = 100
"""Most findings that a report prints; the rest are counted."""

Kind: TypeAlias = Literal["structural", "impossible", "physical", "doubtful"]
"""Severity class of a finding; see UrdfFinding."""


class UrdfFinding(NamedTuple):
    """One defect of a URDF.

    Attributes:
        kind: "structural" (Pinocchio would not read what the file says), "impossible" (a body that joints
            move has a mass or inertia that no body has), "physical" (so has another body, or its inertia is
            missing) or "doubtful" (readable, but probably not intended).
        code: short name of the defect; the docstring of the package lists them.
        element: "link 'x'", "joint 'y'", "robot" or "document".
        line: line of the file, from 1; 0 for the file as a whole, and for a xacro's expansion.
        message: text that says what is wrong, with the value, the allowed values and what to do.
    """

    kind: Kind
    code: str
    element: str
    line: int
    message: str

    def __str__(self) -> str:
        """Return the finding as one line of text."""
        line = f"line {self.line}: " if self.line else ""
        return f"{line}{self.element}: {self.message} [{self.code}]"


@dataclass(frozen=True)
class UrdfReport:
    """All findings of a check of one file.

    Attributes:
        source: name of the file, for messages.
        findings: the findings, sorted by line.
    """

    source: str
    findings: tuple[UrdfFinding, ...]

    def without(self, codes: Collection[str]) -> UrdfReport:
        """Return the report without the findings of some codes."""
        return UrdfReport(
            self.source, tuple(finding for finding in self.findings if finding.code not in codes)
        )

    def errors(self, *, strict: bool = False) -> tuple[UrdfFinding, ...]:
        """Return structural and impossible findings, which make a file unusable; if strict, physical ones."""
        kinds = ("structural", "impossible", "physical") if strict else ("structural", "impossible")
        return tuple(finding for finding in self.findings if finding.kind in kinds)

    def warnings(self, *, strict: bool = False) -> tuple[UrdfFinding, ...]:
        """Return the other findings: doubtful ones and, unless strict, physical ones."""
        kinds = ("doubtful",) if strict else ("doubtful", "physical")
        return tuple(finding for finding in self.findings if finding.kind in kinds)

    def summary(self, *, strict: bool = False) -> str:
        """Return the report as lines of text: errors, warnings, and their numbers."""
        errors, warnings = self.errors(strict=strict), self.warnings(strict=strict)
        shown = [f"error: {finding}" for finding in errors] + [f"warning: {finding}" for finding in warnings]
        if len(shown) > SHOWN_FINDINGS:
            shown[SHOWN_FINDINGS:] = [f"... and {len(shown) - SHOWN_FINDINGS} more"]
        counts = (("error", len(errors)), ("warning", len(warnings)))
        numbers = ", ".join(f"{number} {noun}" + "s" * (number != 1) for noun, number in counts)
        return "\n".join((*shown, f"{self.source}: {numbers}"))


def quoted(text: str) -> str:
    """Return a piece of a file for a message: in quotes, printable and short."""
    return repr(text if len(text) <= SHOWN_CHARACTERS else text[:SHOWN_CHARACTERS] + "...")


def listed(names: Iterable[str], most: int = 5) -> str:
    """Return the first few of many names, in quotes."""
    every = tuple(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(map(quoted, every[:most])) + more
