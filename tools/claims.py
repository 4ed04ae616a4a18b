"""Claims of the documentation, their tests and what these find: the tables of docs/verification.md.

``tools/claims.tsv`` has a line for each claim: section, claim, names of tests, what they find.
``tools/measure.py`` measures the last column, and ``tools/reference.py`` writes the page.
"""

from __future__ import annotations

import ast
import csv
import itertools
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
FILE = REPOSITORY / "tools" / "claims.tsv"


class Claim(NamedTuple):
    """A claim and its tests.

    Attributes:
        section: the heading under which it stands.
        claim: a sentence without an end.
        tests: names of test functions.
        found: largest difference and its share of the tolerance, a stated number, or a dash.
    """

    section: str
    claim: str
    tests: tuple[str, ...]
    found: str


def read(file: Path = FILE) -> list[Claim]:
    """Return the claims of a file, in order."""
    with file.open(encoding="utf-8", newline="") as lines:
        _, *rows = csv.reader(lines, delimiter="\t", quoting=csv.QUOTE_NONE)
    return [Claim(section, claim, tuple(tests.split()), found) for section, claim, tests, found in rows]


def write(claims: Iterable[Claim], file: Path = FILE) -> None:
    """Write claims, one a line."""
    rows = [Claim._fields, *((one.section, one.claim, " ".join(one.tests), one.found) for one in claims)]
    file.write_text("".join("\t".join(row) + "\n" for row in rows), encoding="utf-8")


def places(folder: Path = REPOSITORY / "tests") -> dict[str, dict[str, str]]:
    """Return the files of every test function with its tier: nothing, "slow" or "partly slow".

    Args:
        folder: the tests; files are relative to it.
    """
    found: dict[str, dict[str, str]] = defaultdict(dict)
    for file in sorted(folder.rglob("test_*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                found[node.name][file.relative_to(folder).as_posix()] = _tier(node)
    return found


def _tier(test: ast.FunctionDef) -> str:
    marks = [ast.unparse(mark) for mark in test.decorator_list]
    if any(mark.startswith("pytest.mark.slow") for mark in marks):
        return "slow"
    return "partly slow" if any("pytest.mark.slow" in mark for mark in marks) else ""


def table(claims: Iterable[Claim], where: dict[str, dict[str, str]]) -> str:
    """Return the claims as Markdown, a table for each section.

    Args:
        claims: in the order of the page.
        where: files and tiers by test, of :func:`places`.

    Raises:
        ValueError: a test does not exist.
    """
    lines: list[str] = []
    for section, group in itertools.groupby(claims, key=lambda one: one.section):
        lines += ["", f"## {section}", "", "| claim | test | found |", "| --- | --- | --- |"]
        lines += [f"| {one.claim} | {_cell(one.tests, where)} | {one.found} |" for one in group]
    return "\n".join(lines[1:])


def _cell(tests: Iterable[str], where: dict[str, dict[str, str]]) -> str:
    """Return tests by file: `folder/test_file.py`: `test_one`, `test_two` (slow)."""
    files: dict[str, list[str]] = defaultdict(list)
    for test in tests:
        if test not in where:
            raise ValueError(f"there is no test named {test}; tools/claims.tsv must name tests that exist")
        for file, tier in where[test].items():
            files[file].append(f"`{test}`" + f" ({tier})" * bool(tier))
    return "; ".join(f"`{file}`: {', '.join(names)}" for file, names in files.items())
