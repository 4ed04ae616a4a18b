"""Numbers in the text of README and of the pages on laws, each with the tests that read it there.

    python tools/page_numbers.py          # counts, and the numbers that no test reads
    python tools/page_numbers.py --all    # every number

A test reads a number if a group of one of its patterns stands there. Tables that a study writes between comments
and blocks of code are left out, as tests compare or run them whole; so are formulas, code, headings and
references such as "Theorem 3". ``tools/stated_numbers.tsv`` lists numbers that nothing derives, with the reason.
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
CONCEPTS = ("choose", "front", "paper", "paper-claims", "alpha", "impossibility", "messages")
PAGES = {
    "README": "README.md",
    **{name: f"docs/concepts/{name}.md" for name in CONCEPTS},
    "docs/studies/front.md": "docs/studies/front.md",
    "docs/studies/paper-claims.md": "docs/studies/paper-claims.md",
}
READERS = ("repository", "proof", "simulation", "control")
"""Folders of the tests that read these pages."""
EQUATION = r"\$[\\\w{},. ]+(?:=|<|>|\\ge|\\le) *[\d.e-]+\$"
"""Inline mathematics that is a symbol and its value; all else is a formula."""
SKIPPED = re.compile(
    r"^```.*?^```|^<!-- (?P<name>[\w ]+) -->.*?<!-- end of (?P=name) -->|\$\$.*?\$\$|^#[^\n]*|`[^`\n]*`"
    rf"|\]\([^)]*\)|^\d\. |\$(?!\s)(?!{EQUATION[2:]})[^$\n]*\$",
    re.DOTALL | re.MULTILINE,
)
REFERENCE = re.compile(
    r"\b(?:Theorem|[Cc]laims?|[Jj]oint|arms?|[Ee]xercise|Figs?\.|eq\.|section|Automatica|Python|law|\*\*Joint) "
    r"\(?\d[\d.]*\)?(?: (?:and|to) \d[\d.]*)?|\(23\)|\b(?:19|20)\d\d\b|\d-D\b|gen\. \d+"
)
NUMBER = re.compile(r"(?<![\w.^_\\{-])(?:\d+(?:\.\d+)?|\.\d+)(?:e-?\d+)?(?![\w}]|\.\d)")
UNIT = re.compile(
    r"\s*(?:N m\b|N/s|kN/m|mrad|rad|mm|kHz|Hz|%|degrees|kg|ms|m/s|µm|per second|minutes|times|[NmsJ]\b)?"
)


class Number(NamedTuple):
    """A number on a page.

    Attributes:
        page: relative to the repository.
        line: from 1.
        text: with its unit.
        context: what stands around it.
        tests: file::name of those that read it.
    """

    page: str
    line: int
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
    """Return the patterns with groups for numbers in tests, with the pages that the test names."""
    for file in sorted(path for name in READERS for path in (folder / name).rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        tree = ast.parse(text)
        sources = [(node, ast.get_source_segment(text, node) or "") for node in tree.body]
        constants = {
            node.targets[0].id: source
            for node, source in sources
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        }
        for node, source in sources:
            used = [
                source,
                *(other for name, other in constants.items() if re.search(rf"\b{name}\b", source)),
            ]
            pages = frozenset(
                name for name in PAGES if _names(name, source if _calls(source) else "\n".join(used))
            )
            strings = list(_strings(node))
            if isinstance(node, ast.FunctionDef):
                strings += [
                    each
                    for other, _ in sources
                    if isinstance(other, ast.Assign) and isinstance(other.targets[0], ast.Name)
                    if re.search(rf"\b{other.targets[0].id}\b", source)
                    for each in _strings(other)
                ]
                test = f"{file.relative_to(folder).as_posix()}::{node.name}"
                for each in strings:
                    if re.search(r"\((?!\?)[^()]*(?:\\d|\\w|\.\*|\[\^)", each):
                        yield Pattern(each, test, pages)


def _calls(source: str) -> bool:
    return "read_numbers(" in source or "require_numbers(" in source


def _names(page: str, source: str) -> bool:
    """Return whether a test names a page: by its file, or quoted as the helpers of tests take it."""
    stem = page.rpartition("/")[2].removesuffix(".md")
    quoted = f'"{page}"' in source or f'"{stem}.md"' in source or f'"{stem}"' in source
    return (
        quoted
        or (page == "alpha" and "alpha.PAGE" in source)
        or (stem == "paper-claims" and "claims_page" in source)
    )


def _strings(node: ast.AST) -> Iterator[str]:
    inner: set[int] = set()
    for part in ast.walk(node):
        if isinstance(part, ast.JoinedStr):
            inner.update(map(id, part.values))
            yield "".join(str(p.value) if isinstance(p, ast.Constant) else "[^|]*?" for p in part.values)
        elif isinstance(part, ast.Constant) and isinstance(part.value, str) and id(part) not in inner:
            yield part.value


def spans(name: str, text: str, known: list[Pattern]) -> Iterator[tuple[int, int, str]]:
    """Return start and end of what the groups of patterns match on a page, with the test."""
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
                    if hit[group]:
                        yield (*hit.span(group), pattern.test)


def numbers(name: str, known: list[Pattern]) -> Iterator[Number]:
    """Return the numbers of a page in order."""
    text = (REPOSITORY / PAGES[name]).read_text(encoding="utf-8")
    read = list(spans(name, text, known))
    masked = text
    for skipped in (SKIPPED, REFERENCE):
        masked = skipped.sub(lambda hit: re.sub(r"[^\n]", " ", hit[0]), masked)
    for hit in NUMBER.finditer(masked):
        start, end = hit.span()
        tests = sorted({test for low, high, test in read if low <= start and end <= high})
        unit = UNIT.match(masked, end)
        context = " ".join(text[max(0, start - 60) : end + 40].split())
        label = f"{hit[0]} {unit[0].strip() if unit else ''}".strip()
        yield Number(PAGES[name], text.count("\n", 0, start) + 1, label, context, tuple(tests))


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
            print(
                f"{one.page}:{one.line}\t{one.text}\t{', '.join(one.tests) or reason or 'none'}\t{one.context}"
            )
    for page, kinds in counts.items():
        print(f"{page}: {kinds['read']} read by a test, {kinds['stated']} stated, {kinds['none']} neither")


if __name__ == "__main__":
    main()
