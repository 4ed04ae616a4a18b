"""Numbers in the text of README and of the pages on laws, each with the tests that read it there.

    python tools/page_numbers.py          # counts, and the numbers that no test reads
    python tools/page_numbers.py --all    # every number

A test reads a number if a group of one of its patterns stands there, or the pattern has the number itself as
a condition of another. Tables that studies write and blocks of code are left out: tests compare or run them
whole. So are formulas, code, headings and references such as "Theorem 3". ``tools/stated_numbers.tsv`` lists
what nothing derives: conditions, definitions, quotations.
"""

from __future__ import annotations

import ast
import csv
import re
import sys
import warnings
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
STATED = REPOSITORY / "tools" / "stated_numbers.tsv"
PAGES = {
    "README": "README.md",
    **{name: f"docs/concepts/{name}.md" for name in ("choose", "paper", "impossibility", "messages")},
    **{name: f"docs/studies/{name}.md" for name in ("alpha", "front", "paper-claims")},
}
"""Pages by the name that tests give them."""
WHOLE = {"front"}
"""Pages whose tables a test compares whole, without comments around them."""
READERS = ("repository", "proof", "simulation", "control")
"""Folders of the tests that read these pages."""
LONGEST = 60
"""Characters of the longest group that is a number."""
VALUE = r"[\\\w{},. ]+(?:=|<|>|\\ge|\\le) *[\d.e-]+\$"
"""Inline mathematics that is a symbol and its value, after the first sign; all else is a formula."""
SKIPPED = re.compile(
    r"^```.*?^```|^<!-- (?P<name>[\w ]+) -->.*?<!-- end of (?P=name) -->|\$\$.*?\$\$|^#[^\n]*|`[^`\n]*`"
    rf"|\]\([^)]*\)|^\d\. |\$(?!\s)(?!{VALUE})[^$\n]*\$",
    re.DOTALL | re.MULTILINE,
)
REFERENCE = re.compile(
    r"\b(?:Theorem|[Cc]laims?|[Jj]oint|arm|[Ee]xercise|Figs?\.|eq\.|section|Automatica|Python) "
    r"\(?\d[\d.]*\)?(?: (?:and|to) \d[\d.]*)?|\(23\)|\b(?!2000)(?:19|20)\d\d\b|\d-D\b"
    r"|(?:=|>|\\ge|\\le) [01](?=[ $,]|$)"
)
"""References, and a symbol that is set to 0 or 1 or bounded by it."""
NUMBER = re.compile(r"(?<![\w.^_\\{-])(?:\d+(?:\.\d+)?|\.\d+)(?:e-?\d+)?(?![\w}]|\.\d)")
UNIT = re.compile(
    r"\s*(?:N m\b|N/s|kN/m|mrad|rad|mm|kHz|Hz|%|degrees|kg|ms|m/s|µm|per second|minutes|times|ticks"
    r"|[NmsJ]\b)?"
)


class Number(NamedTuple):
    """A number on a page.

    Attributes:
        page: relative to the repository.
        line: from 1.
        section: the heading above it.
        text: with its unit.
        context: what stands around it.
        tests: file::name of those that read it.
    """

    page: str
    line: int
    section: str
    text: str
    context: str
    tests: tuple[str, ...]


class Pattern(NamedTuple):
    """A pattern of a test.

    Attributes:
        text: the regular expression.
        test: file::name.
        pages: those that it may be about, names of PAGES.
    """

    text: str
    test: str
    pages: frozenset[str]


def patterns(folder: Path = REPOSITORY / "tests") -> Iterator[Pattern]:
    """Return the patterns with groups in tests that name a page."""
    for file in sorted(path for name in READERS for path in (folder / name).rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        if not any(_is_named(page, text) for page in PAGES):
            continue
        lines = text.splitlines()
        nodes = {node: "\n".join(lines[node.lineno - 1 : node.end_lineno]) for node in ast.parse(text).body}
        constants = {_name_of(node): node for node in nodes}
        for node, source in nodes.items():
            if not isinstance(node, ast.FunctionDef):
                continue
            words = set(re.findall(r"\w+", source))
            used = [constants[name] for name in words & set(constants) if constants[name] is not node]
            told = source if "_numbers(" in source else "\n".join([source, *(nodes[each] for each in used)])
            pages = frozenset(page for page in PAGES if _is_named(page, told))
            test = f"{file.relative_to(folder).as_posix()}::{node.name}"
            for part in (node, *(each for each in used if isinstance(each, ast.Assign))):
                for string in _strings(part):
                    if re.search(r"\((?!\?)[^()]*(?:\\d|\\w|\.\*|\[\^)", string):
                        yield Pattern(string, test, pages)


def _name_of(node: ast.stmt) -> str:
    target = node.targets[0] if isinstance(node, ast.Assign) else node
    return str(getattr(target, "id", getattr(target, "name", "")))


def _is_named(page: str, source: str) -> bool:
    """Return whether a source names a page: by its file, or quoted as the helpers of tests take it."""
    stem = page.rpartition("/")[2].removesuffix(".md")
    names = [f'"{page}"', f'"{stem}.md"', f'"{stem}"'] if "/" not in page else [f'"{page}"', f'"{stem}.md"']
    return any(name in source for name in names) or (page == "alpha" and "alpha.PAGE" in source)


def _strings(node: ast.AST) -> Iterator[str]:
    inner: set[int] = set()
    for part in ast.walk(node):
        if isinstance(part, ast.JoinedStr):
            inner.update(map(id, part.values))
            yield "".join(str(p.value) if isinstance(p, ast.Constant) else "[^|]*?" for p in part.values)
        elif isinstance(part, ast.Constant) and isinstance(part.value, str) and id(part) not in inner:
            yield part.value


def spans(name: str, text: str, known: list[Pattern]) -> Iterator[tuple[int, int, str]]:
    """Return start and end of the numbers that patterns match on a page, with the test."""
    flat = text.replace("\n", " ")
    for pattern in known:
        if name not in pattern.pages:
            continue
        for form in (text, flat):
            try:
                hits = list(re.finditer(pattern.text, form, re.MULTILINE))
            except re.error:
                break
            for hit in hits if len(hits) <= 40 else ():
                for group in range(1, len(hit.groups()) + 1):
                    if hit[group] and len(hit[group]) <= LONGEST:
                        yield (*hit.span(group), pattern.test)
                for part in re.findall(r"[^\\()\[\]*+?|.]*\d[\w %]*", pattern.text):
                    if (start := form.find(part.strip(), hit.start(), hit.end())) >= 0 and len(
                        part.strip()
                    ) > 3:
                        yield (start, start + len(part.strip()), pattern.test)


def numbers(name: str, known: list[Pattern]) -> Iterator[Number]:
    """Return the numbers of a page in order."""
    text = (REPOSITORY / PAGES[name]).read_text(encoding="utf-8")
    read = list(spans(name, text, known))
    masked = text
    for skipped in (SKIPPED, REFERENCE, *([re.compile(r"^\|.*", re.MULTILINE)] if name in WHOLE else [])):
        masked = skipped.sub(lambda hit: re.sub(r"[^\n]", " ", hit[0]), masked)
    headings = [(hit.start(), hit[1]) for hit in re.finditer(r"^#+ (.*)$", text, re.MULTILINE)]
    for hit in NUMBER.finditer(masked):
        start, end = hit.span()
        tests = sorted({test for low, high, test in read if low <= start and end <= high})
        unit = UNIT.match(masked, end)
        label = f"{hit[0]} {unit[0].strip() if unit else ''}".strip()
        section = [heading for place, heading in headings if place <= start][-1]
        context = " ".join(text[max(0, start - 60) : end + 40].split())
        line = text.count("\n", 0, start) + 1
        yield Number(PAGES[name], line, section, label, context, tuple(tests))


def stated() -> dict[tuple[str, str], str]:
    """Return why nothing derives a number, by page and number with its unit."""
    with STATED.open(encoding="utf-8", newline="") as lines:
        return {(row["page"], row["number"]): row["reason"] for row in csv.DictReader(lines, delimiter="\t")}


def inventory() -> list[Number]:
    """Return the numbers of all pages."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        known = list(patterns())
        return [number for name in PAGES for number in numbers(name, known)]


def main() -> None:
    """Print the inventory."""
    reasons, counts = stated(), defaultdict(Counter)
    for one in inventory():
        reason = reasons.get((one.page, one.text), "")
        counts[one.page]["read" if one.tests else "stated" if reason else "none"] += 1
        if "--all" in sys.argv or not (one.tests or reason):
            source = ", ".join(one.tests) or reason or "none"
            print(f"{one.page}:{one.line}\t{one.text}\t{source}\t{one.context}")
    for page, kinds in counts.items():
        print(f"{page}: {kinds['read']} read by a test, {kinds['stated']} stated, {kinds['none']} neither")


if __name__ == "__main__":
    main()
