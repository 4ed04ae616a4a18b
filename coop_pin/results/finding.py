"""Findings of a check: what is known of a scenario before it runs, each with its severity and its remedy."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self, get_args

Severity = Literal["error", "warning", "note"]
"""Error: the task will be lost, or the simulation is wrong. Warning: a likely mistake. Note: a margin."""
Kind = Literal[
    "unit",
    "inertia",
    "posture",
    "start",
    "motion",
    "grasp frame",
    "squeeze",
    "grasp plan",
    "pad",
    "shared joint",
    "rolling base",
    "record size",
    "reach",
    "closure rank",
    "freedom",
    "static torque",
    "friction",
    "table force",
    "take-hold",
    "plant steps",
    "sampled damping",
    "loop stability",
    "grasp stability",
    "admittance stability",
    "closed loop",
    "lost arm",
    "internal moment",
    "payload mode",
    "unheld link",
    "steady error",
    "user code",
    "log",
    "distance",
]
"""What a finding is about."""
LEFT_TO_CHECK: tuple[Kind, ...] = (
    "closed loop",
    "lost arm",
    "internal moment",
    "steady error",
    "distance",
)
"""Kinds that ``cp.run`` leaves to ``cp.check``, for time."""


class Finding(NamedTuple):
    """What is known of a scenario in one respect.

    Attributes:
        kind: subject of the finding, one of ``Kind``.
        place: field, or arm and joint, that it is about; empty for the whole cell.
        severity: "error", "warning" or "note".
        sentence: the finding as text.
        value: value that was found; NaN where it is no number.
        limit: value that is allowed; NaN likewise.
        remedy: changes of the scenario that cure it, by dotted path; empty where none is known.
    """

    kind: Kind
    place: str
    severity: Severity
    sentence: str
    value: float = math.nan
    limit: float = math.nan
    remedy: Mapping[str, Any] = {}

    def __str__(self) -> str:
        """Return the sentence and the remedy as text."""
        cure = " ".join(f"--{field} {_typed(value)}" for field, value in self.remedy.items())
        return f"{self.sentence}\n  remedy: {cure}" if cure else self.sentence


@dataclass(frozen=True, eq=False)
class Findings:
    """Findings of a scenario, the severest first.

    Attributes:
        scenario: name of the scenario.
        entries: findings in the order of their severity.
        left: kinds that were not looked at.
    """

    scenario: str
    entries: tuple[Finding, ...]
    left: tuple[Kind, ...] = ()

    def __iter__(self) -> Iterator[Finding]:
        """Yield the findings, the severest first."""
        return iter(self.entries)

    def __len__(self) -> int:
        """Return their number."""
        return len(self.entries)

    def of(self, *severities: Severity) -> Findings:
        """Return the findings of some severities.

        Args:
            severities: "error", "warning" or "note".
        """
        entries = tuple(finding for finding in self if finding.severity in severities)
        return Findings(self.scenario, entries, self.left)

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not self.of("error")

    def summary(self) -> str:
        """Return the findings as text: errors and warnings with an exclamation mark, then the notes."""
        count = Counter(finding.severity for finding in self)
        counted = [name for name in _SEVERITIES if name != "note" or count[name]]
        counts = ", ".join(f"{count[name]} {name}{'' if count[name] == 1 else 's'}" for name in counted)
        lines = [f"{self.scenario}: {counts}"]
        for before, finding in zip((None, *self), self, strict=False):
            is_same = before is not None and before.remedy == finding.remedy
            text = finding.sentence if is_same else str(finding)
            lines.append(("  " if finding.severity == "note" else "! ") + text.replace("\n", "\n    "))
        if self.left:
            lines.append(f"not looked at: {', '.join(self.left)}")
        return "\n  ".join(lines)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the findings of a text as ``to_json`` writes it."""
        table = json.loads(text)
        entries = tuple(
            Finding(**entry | {name: math.nan for name in ("value", "limit") if entry[name] is None})
            for entry in table["findings"]
        )
        return cls(table["scenario"], entries, tuple(table["left"]))

    def to_json(self) -> str:
        """Return the findings as JSON; numbers that are NaN or infinite are null."""
        entries = [
            finding._asdict() | {"value": _finite(finding.value), "limit": _finite(finding.limit)}
            for finding in self
        ]
        return json.dumps(
            {"scenario": self.scenario, "ok": self.ok, "left": self.left, "findings": entries}, indent=1
        )


_SEVERITIES: tuple[Severity, ...] = get_args(Severity)


def sorted_findings(entries: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings in the order of their severity, otherwise as they come."""
    return tuple(sorted(entries, key=lambda finding: _SEVERITIES.index(finding.severity)))


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _typed(value: Any) -> str:
    """Return a value as it is typed on the command line."""
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
