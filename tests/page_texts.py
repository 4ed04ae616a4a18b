"""Numbers in the text of pages, read at one place each and held against what a test derives."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
WORDS = {
    word: str(number)
    for word, number in zip(
        ("one", "two", "three", "five", "six", "nine", "ten", "seventeen", "thirty"),
        (1, 2, 3, 5, 6, 9, 10, 17, 30),
        strict=True,
    )
}


@cache
def page_text(page):
    """A page on one line: README, a name in docs/concepts, or a path such as docs/studies/front.md."""
    folder = "" if page == "README" else "docs/concepts/"
    path = page if page.endswith(".md") else f"{folder}{page}.md"
    return (REPOSITORY / path).read_text(encoding="utf-8").replace("\n", " ")


def read_numbers(page, pattern):
    """The groups of a pattern that stands once on a page; numbers in words as digits."""
    places = list(re.finditer(pattern, page_text(page)))
    assert len(places) == 1, (page, pattern, len(places))
    return [WORDS.get(text.lower(), text.replace("−", "-")) for text in places[0].groups()]


def rounds_to(value, shown):
    """Whether a number rounds to the digits that a page shows."""
    if "e" in shown:
        digits = len(shown.partition("e")[0].replace(".", "")) - 1
        return float(f"{value:.{digits}e}") == float(shown)
    return float(f"{value:.{len(shown.partition('.')[2])}f}") == float(shown)


def require_numbers(page, values):
    """Hold the numbers of a page against a value, or a list of values, for each pattern."""
    for pattern, expected in values.items():
        shown = read_numbers(page, pattern)
        expected = expected if isinstance(expected, list | tuple) else [expected]
        assert len(shown) == len(expected), pattern
        for text, value in zip(shown, expected, strict=True):
            assert rounds_to(value, text), (page, pattern, text, float(value))
