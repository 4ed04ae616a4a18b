"""``coop-pin conform``: engines that are installed, the table, engines of others, traps, and the page."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coop_pin.base.errors import FieldError
from coop_pin.cli import main
from coop_pin.cli.conform import conform_folder

REPOSITORY = Path(__file__).parents[2]
CONFORM = REPOSITORY / "benchmarks" / "conform"
PAGE, DIGITS = (
    (REPOSITORY / "docs" / "studies" / name).read_text(encoding="utf-8")
    for name in ("other-engines.md", "conform.md")
)
TRAPS = sorted((CONFORM / "traps").glob("*.py"))
OFF = 6.0
"""Digits below which the page has a reason."""
LEAST = {"Pinocchio": 8.0, "CoopPinMechanism": 11.0, "CoopPin": 10.0, "CoopPinMujoco": 2.5, "Mujoco": 4.5}
"""Digits of engines that are installed with the tests."""


@pytest.fixture(scope="module")
def conform_modules():
    """Modules of the command, by name."""
    before = set(sys.modules)
    sys.path.insert(0, str(CONFORM))
    import cases
    import engine
    import table

    yield {"cases": cases, "engine": engine, "table": table}
    sys.path.remove(str(CONFORM))
    for name in set(sys.modules) - before:
        if name.partition(".")[0] == "engines" or str(CONFORM) in str(
            getattr(sys.modules[name], "__file__", "")
        ):
            del sys.modules[name]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:suspicious values in the URDF")
def test_engines_that_are_installed_have_the_closed_forms(conform_modules):
    """In the cases that need no time to come to rest; the others are on the page."""
    engine, quick = conform_modules["engine"], [
        case for case in conform_modules["cases"].all_cases() if case.time < 1.0
    ]  # fmt: skip
    seen = set()
    for name in ("coop_pin_cell", "coop_pin_mechanism", "coop_pin_mujoco", "mujoco_raw", "pinocchio_raw"):
        (kind,) = engine.load_engines(str(CONFORM / "engines" / f"{name}.py"))
        for case in quick:
            try:
                errors = case.errors(kind().wrenches(case))
            except engine.RefusedError:
                continue
            seen.add((kind.__name__, case.name, case.is_planar))
            assert max(errors) < 10.0 ** -LEAST[kind.__name__], (name, case.label)
    assert len(seen) == 2 * 5 * 10


def test_an_engine_is_one_file_of_at_most_eighty_lines():
    for file in (CONFORM / "engines").glob("*.py"):
        assert len(file.read_text(encoding="utf-8").splitlines()) <= 80, file.name


MINE = """
import numpy as np
from engine import RefusedError

class Mine:
    name, settings, reading = "mine", "none", "nothing"
    def wrenches(self, case):
        if case.is_planar:
            raise RefusedError("no plane")
        return {}
"""


@pytest.mark.parametrize(
    ("answer", "cell", "code"),
    [("case.wrenches", "12+ / 12+", 0), ("case.wrenches * np.nan", "0 / 0", 0), ("1 / 0", "failed", 1)],
)
def test_an_engine_of_ones_own_is_a_file_a_folder_or_a_class(answer, cell, code, tmp_path, conform_modules):
    (tmp_path / "engine_of_ones_own.py").write_text(MINE.format(answer))
    table, cases = conform_modules["table"], conform_modules["cases"].all_cases()[:2]
    sys.path.insert(0, str(tmp_path))
    try:
        for words in (
            [str(tmp_path / "engine_of_ones_own.py")],
            [str(tmp_path)],
            ["engine_of_ones_own:Mine"],
        ):
            (column,) = table.columns(words, cases)
            assert list(column.cells.values()) == ["refused", cell]
            assert bool(column.failures) == bool(code)
            assert "no plane" in table.text([column], cases)
    finally:
        sys.path.remove(str(tmp_path))
        del sys.modules["engine_of_ones_own"]


def test_an_engine_that_is_not_installed_is_a_column_of_dashes(tmp_path, capfd):
    (tmp_path / "absent.py").write_text("import not_installed_engine\n")
    words = ["conform", "--engine", str(tmp_path / "absent.py"), "--case", "squeeze", "spatial"]
    assert main(words) == 0
    lines = capfd.readouterr().out.splitlines()
    assert lines[1].split() == ["static", "squeeze,", "spatial", "-"]
    assert lines[-1] == "- absent: not installed."


def test_without_a_checkout_the_command_says_what_it_needs(tmp_path):
    assert conform_folder(REPOSITORY) == CONFORM
    with pytest.raises(FieldError, match="checkout"):
        conform_folder(tmp_path)


def part(title: str, parts: str) -> str:
    """Code and output below a title of the page."""
    return re.search(
        rf"\*\*{re.escape(title)}\*\*\n\n```python\n(.*?)\n```\n\n```text\n(.*?)\n```", parts, re.DOTALL
    )


@pytest.mark.parametrize("file", TRAPS, ids=lambda file: file.stem)
def test_a_trap_gives_what_the_page_says(file):
    source = file.read_text(encoding="utf-8")
    shown = part(ast.get_docstring(ast.parse(source)).strip(), PAGE)
    assert shown[1] == source.partition('"""\n\n')[2].strip()
    comes, right = (line.partition(": ") for line in shown[2].splitlines())
    assert (comes[0], right[0]) == ("comes", "right")
    assert comes[2] != right[2]
    package = {"drake": "pydrake"}.get(file.stem.partition("_")[0], file.stem.partition("_")[0])
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    ran = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == shown[2]


def rows_of(block: str) -> list[list[str]]:
    """Cells of the table of a part of the page."""
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in block.splitlines()
        if line[:1] == "|"
    ]


def test_the_page_has_every_case_and_a_reason_for_every_number_that_is_off(conform_modules):
    block = re.search(r"<!-- conform -->(.*)<!-- end of conform -->", DIGITS, re.DOTALL)[1]
    head, _, *body = rows_of(block)
    assert [row[0] for row in body] == [case.label for case in conform_modules["cases"].all_cases()]
    reasons = rows_of(PAGE.partition("Where an engine has fewer")[2].partition("## ")[0])[2:]
    told = {(engine, case) for engine, case, _ in reasons}
    off = set()
    for label, *cells in body:
        for name, cell in zip(head[1:], cells, strict=True):
            assert cell not in ("-", "failed"), (name, label)
            digits = [float(each.strip("+ ")) for each in cell.split("/")] if "/" in cell else [OFF]
            if min(digits) < OFF:
                off.add((re.sub(r" \d[\d.]*", "", name), label.partition(",")[0]))
    assert off == told
    assert len(head) == 8
    assert np.all([len(reason) > 20 for *_, reason in reasons])
