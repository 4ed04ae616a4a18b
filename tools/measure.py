"""Measure what the tests of the claims in tools/claims.tsv find, and write it there.

    python tools/measure.py && python tools/reference.py

Every test of a claim without a number of its own runs. The column "found" gets the largest difference between
actual and expected value of all its ``assert_allclose``, in the unit compared, and the largest share of the
tolerance. Claims whose tests compare no numbers have a dash. The second command writes docs/verification.md.
"""

from __future__ import annotations

import functools
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "tools"))
from claims import Claim, read, write  # noqa: E402

MEASURED = re.compile(r"\d+e[+-]\d\d \((< 1|\d{1,2}|100)%\)")
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


def filled(claims: Iterable[Claim], found: Mapping[str, Found]) -> list[Claim]:
    """Return claims with what was measured now; numbers that are stated by hand stay.

    Args:
        claims: the claims of the page.
        found: the largest differences by name of the test.
    """
    return [
        one._replace(found=cell(one.tests, found))
        if one.found == NOTHING or MEASURED.fullmatch(one.found)
        else one
        for one in claims
    ]


def cell(tests: Iterable[str], found: Mapping[str, Found]) -> str:
    """Return the largest difference of tests, and the share of the tolerance."""
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
    known = read()
    measured = {
        test for one in known if one.found == NOTHING or MEASURED.fullmatch(one.found) for test in one.tests
    }
    write(filled(known, measure(measured)))
