"""Table of digits: a column for each engine, a row for each case, and what was set and read."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cases import Case
from engine import HERE, RefusedError, engine_files, load_engines

MOST = 12.0
"""Digits beyond which rounding decides."""
REFUSED, ABSENT, FAILED = "refused", "-", "failed"


@dataclass
class Column:
    """What an engine gave.

    Attributes:
        name: name and version, or that of its file where it is not installed.
        settings: settings.
        reading: how the wrench is read.
        cells: text of each case by its label.
        refusals: why a case was refused, by label.
        failures: what an engine raised, by label.
    """

    name: str
    settings: str = ""
    reading: str = ""
    cells: dict[str, str] = field(default_factory=dict)
    refusals: dict[str, str] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)


def sources(words: Sequence[str]) -> list[str]:
    """Return files and module:Class names of engines, from names, files and folders."""
    found: list[str] = []
    for word in words:
        if (HERE / f"{word}.py").is_file():
            found.append(str(HERE / f"{word}.py"))
        else:
            found += engine_files(Path(word)) if Path(word).is_dir() else [word]
    return found


def columns(words: Sequence[str], cases: Sequence[Case]) -> list[Column]:
    """Return the columns of engines in some cases."""
    table = []
    for source in sources(words):
        try:
            engines = [kind() for kind in load_engines(source)]
        except ImportError:
            table.append(
                Column(Path(source).stem, cells=dict.fromkeys((case.label for case in cases), ABSENT))
            )
            continue
        for engine in engines:
            table.append(column := Column(engine.name, engine.settings, engine.reading))
            for case in cases:
                column.cells[case.label] = cell(engine, case, column)
    return table


def cell(engine: object, case: Case, column: Column) -> str:
    """Return the digits of force and moment of an engine in a case, as text."""
    try:
        errors = case.errors(engine.wrenches(case))
    except RefusedError as error:
        column.refusals[case.label] = str(error)
        return REFUSED
    except Exception as error:  # of foreign code: a table with a hole is worth more than none
        column.failures[case.label] = f"{type(error).__name__}: {error}"
        return FAILED
    return " / ".join(map(digits, errors))


def digits(error: float) -> str:
    """Return the number of digits that an error leaves."""
    if not error < 1.0:  # NaN, too
        return "0"
    number = -math.log10(max(error, 1e-300))
    return f"{MOST:.0f}+" if number >= MOST else f"{number:.1f}"


def rows(table: Sequence[Column], cases: Sequence[Case]) -> list[list[str]]:
    """Return head and rows of the table."""
    head = ["digits of force / moment", *(column.name for column in table)]
    return [head, *([case.label, *(column.cells[case.label] for column in table)] for case in cases)]


def notes(table: Sequence[Column], tick: str) -> list[str]:
    """Return a line for each engine: settings, reading, refusals and failures."""
    lines = []
    for column in table:
        if not column.settings:
            lines.append(f"- {column.name}: not installed.")
            continue
        lines.append(f"- {column.name}: {column.settings}. Read: {column.reading.replace('`', tick)}.")
        for kind, told in ((REFUSED, column.refusals), (FAILED, column.failures)):
            for reason in dict.fromkeys(told.values()):
                names = dict.fromkeys(label.partition(",")[0] for label, why in told.items() if why == reason)
                lines.append(f"  {kind}: {', '.join(names)}: {reason}.")
    return lines


def text(table: Sequence[Column], cases: Sequence[Case]) -> str:
    """Return the table for a terminal."""
    lines = rows(table, cases)
    widths = [max(map(len, each)) for each in zip(*lines, strict=True)]
    shown = [
        "  ".join(each.ljust(width) for each, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    return "\n".join([*shown, "", *notes(table, "")])


def markdown(table: Sequence[Column], cases: Sequence[Case]) -> str:
    """Return the table for a page."""
    head, *body = rows(table, cases)
    lines = [head, ["---"] * len(head), *body]
    return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", *notes(table, "`")])


def with_block(page: str, name: str, content: str) -> str:
    """Return a page with the text between its two comments of a name replaced.

    Raises:
        ValueError: the page does not have both comments once.
    """
    form = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- end of {name} -->)", re.DOTALL)
    page, count = form.subn(lambda block: f"{block[1]}\n{content}\n{block[2]}", page)
    if count != 1:
        raise ValueError(f"the page has {count} blocks named {name!r}; it must have one")
    return page
