"""Generate the last column of the tables in docs/verification.md from the tests named there.

    python tools/measure.py

Every test named in a table of the page runs. The column shows the largest difference between actual and
expected value of all its ``assert_allclose``, in the unit compared, and the largest share of the tolerance.
Rows whose tests compare no numbers have a dash.
"""

from __future__ import annotations

import functools
import re
import sys
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "docs" / "verification.md"
NAMED = re.compile(r"`(test_\w+)`")
NOTHING = "–"


class Found(NamedTuple):
    """Difference between actual and expected values.

    Attributes:
        difference: the largest difference, in the unit that was compared.
        share: the largest share of the tolerance.
    """

    difference: float
    share: float


class Recorder:
    """Pytest plugin that records the differences of ``numpy.testing.assert_allclose`` by name of the test."""

    def __init__(self) -> None:
        self.found: dict[str, list[Found]] = defaultdict(list)
        self._test = ""

    def pytest_runtest_call(self, item: Any) -> None:
        """Note the name of the test that runs."""
        self._test = item.originalname

    def watch(self) -> None:
        """Replace assert_allclose by a recording one; test files must be imported after this."""
        compare = np.testing.assert_allclose

        @functools.wraps(compare)
        def watched(actual: Any, desired: Any, rtol: float = 1e-7, atol: float = 0.0, **options: Any) -> None:
            self.found[self._test].append(difference(actual, desired, rtol, atol))
            compare(actual, desired, rtol, atol, **options)

        np.testing.assert_allclose = watched


def difference(actual: Any, desired: Any, rtol: float, atol: float) -> Found:
    """Return the largest difference of two arrays, and its largest share of atol + rtol |d|.

    NaN counts as equal to NaN.
    """
    a, d = np.broadcast_arrays(np.asarray(actual, dtype=float), np.asarray(desired, dtype=float))
    off, allowed = np.abs(a - d), atol + rtol * np.abs(d)
    shares = np.divide(off, allowed, out=np.zeros_like(off), where=off > 0.0)
    return Found(float(np.nanmax(off, initial=0.0)), float(np.nanmax(shares, initial=0.0)))


def fill(page: str, found: Mapping[str, Found]) -> str:
    """Return the page with the last column of each table updated whose heading is "found".

    Args:
        page: the page's text.
        found: the largest differences by name of the test.
    """
    lines, inside = [], False
    for line in page.splitlines():
        if not line.startswith("|"):
            inside = False
        elif line.rstrip().endswith("| found |"):
            inside = True
        elif inside and not line.startswith("| ---"):
            *cells, _, end = line.split("|")
            line = "|".join((*cells, f" {cell(NAMED.findall(line), found)} ", end))
        lines.append(line)
    return "\n".join(lines) + "\n"


def cell(tests: list[str], found: Mapping[str, Found]) -> str:
    """Return the cell of a row: the largest difference of its tests, and the share of the tolerance."""
    numbers = [found[test] for test in tests if test in found]
    if not numbers:
        return NOTHING
    share = max(one.share for one in numbers)
    return f"{max(one.difference for one in numbers):.0e} ({f'{share:.0%}' if share >= 0.01 else '< 1%'})"


def measure(names: set[str]) -> dict[str, Found]:
    """Run tests and return the largest difference of each; a test that compares no numbers is omitted.

    Args:
        names: the functions' names.

    Raises:
        SystemExit: a test failed, or does not exist.
    """
    places = [
        f"{file}::{name}"
        for file in sorted((REPOSITORY / "tests").rglob("test_*.py"))
        for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.MULTILINE)
        if name in names
    ]
    missing = names - {place.rpartition("::")[2] for place in places}
    if missing:
        sys.exit(f"there is no test named {', '.join(sorted(missing))}")
    recorder = Recorder()
    recorder.watch()
    code = pytest.main(
        ["-q", "-m", "", "-p", "no:cacheprovider", "-p", "no:xdist", "--rootdir", str(REPOSITORY), *places],
        [recorder],
    )
    if code != pytest.ExitCode.OK:
        sys.exit(int(code))
    return {
        name: Found(max(one.difference for one in seen), max(one.share for one in seen))
        for name, seen in recorder.found.items()
        if seen
    }


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    rows = "\n".join(line for line in text.splitlines() if line.startswith("|"))
    PAGE.write_text(fill(text, measure(set(NAMED.findall(rows)))), encoding="utf-8")
