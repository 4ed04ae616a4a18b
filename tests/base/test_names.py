"""Names that become paths and labels: refused where they are read, drawn as they are written."""

import ast
import re
from pathlib import Path

import pytest
from cells import SCENARIOS, planar_scenario
from source_trees import SourceTrees, nodes
from tiers import by_default

import coop_pin as cp
from coop_pin import figures
from coop_pin.base.errors import FieldError
from coop_pin.cli import main

PACKAGE = Path(cp.__file__).parent

UNSAFE = [
    "../../x",
    "/etc/x",
    "..",
    ".hidden",
    "a/b",
    "a\\b",
    "C:x",
    "a\0b",
    "a\x1b[2Jb",
    "a\nb",
    "a\u202eb",
    "",
    "  ",
    "a" * 101,
]
SAFE = ["adept-paper", "my arms", "Zwei Arme (März)", "<b>&'\"", "$x$", "x..y"]


@pytest.mark.parametrize("name", UNSAFE)
@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_name_that_is_no_plain_file_name_is_refused(name, cell):
    with pytest.raises(FieldError) as caught:
        SCENARIOS[cell]().replace(name=name)
    assert caught.value.path == "name"
    assert "\0" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize("name", SAFE)
def test_any_other_name_is_taken(name):
    assert planar_scenario().replace(name=name).name == name


@pytest.mark.parametrize("name", [*UNSAFE, "a.b", "payload"])
def test_so_are_the_names_of_arms(name):
    cell = planar_scenario().cell
    arms = {name: cell.arms["left"], "right": cell.arms["right"]}
    grasps = {name: cell.grasps["left"], "right": cell.grasps["right"]}
    with pytest.raises(FieldError):
        cell.replace(arms=arms, grasps=grasps)


@pytest.mark.parametrize("summary", ["a\0b", "a\x1b[2Jb"])
def test_a_summary_has_no_control_characters(summary):
    with pytest.raises(FieldError, match="summary"):
        planar_scenario().replace(summary=summary)
    assert planar_scenario().replace(summary="two\nlines, $5").summary == "two\nlines, $5"


@pytest.mark.parametrize("name", ["../../x", "{absolute}", "..", "a/b"])
def test_run_writes_and_removes_nothing_outside_its_folder(name, tmp_path, monkeypatch, capsys):
    inside = tmp_path / "a" / "b" / "c"
    inside.mkdir(parents=True)
    (tmp_path / "a" / "replay.html").write_text("kept")
    name = name.format(absolute=tmp_path / "x")
    (inside / "s.toml").write_text(planar_scenario().to_toml().replace('"adept-paper"', f'"{name}"', 1))
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.chdir(inside)
    assert main(["run", "s.toml", "--no-replay", "--no-figures", "--duration", "0.1", "--events", "[]"]) == 2
    assert sorted(tmp_path.rglob("*")) == before
    assert "name" in capsys.readouterr().err


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_a_dollar_sign_is_drawn_in_figures(cell):
    """An unbalanced formula such as \\frac stopped the drawing after the run."""
    text = SCENARIOS[cell]().replace(name="$^$", summary="$\\frac{$").to_toml()
    scenario = cp.Scenario.from_toml(re.sub(r"\bleft\b", "'$^$'", text))
    result = cp.run(scenario.replace(duration=0.1, events=()))
    for make in (figures.tracking_figure, figures.motion_figure, figures.singularity_figure):
        make(result).draw_without_rendering()
    panels = figures.torque_figure(result).axes
    assert panels[0].get_title(loc="left").startswith(r"arm \$^\$, joint 1")


# ---------------------------------------------------------------- names and texts in the code

NO_NOUNS = re.compile(
    r"    \w+: (as|at|by|for|from|how|in|its|likewise|of|to|what|when|where|which)\b", re.IGNORECASE
)
"""Argument or attribute whose text does not begin with a noun."""
PARTICIPLES = {"found", "given", "own", "place", "wanted"}
"""Locals that do not say what they hold."""
TREES = SourceTrees(sorted(PACKAGE.rglob("*.py")))


def documented(tree):
    """Lines of the lists of arguments and attributes in the docstrings of a module."""
    for node in nodes(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            for part in re.findall(
                r"^(?:Args|Attributes):\n((?:    .*\n?)+)", ast.get_docstring(node) or "", re.M
            ):
                yield from part.splitlines()


def local_names(tree):
    """Names of arguments and of variables that a module assigns; fields of classes are none."""
    classes = [node for node in nodes(tree) if isinstance(node, ast.ClassDef)]
    fields = {part.target for node in classes for part in node.body if isinstance(part, ast.AnnAssign)}
    for node in nodes(tree):
        if node in fields:
            continue
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def test_texts_of_arguments_begin_with_a_noun():
    offenders = [
        f"{file.relative_to(PACKAGE)}: {line.strip()}"
        for file, tree in TREES.items()
        for line in documented(tree)
        if NO_NOUNS.match(line)
    ]
    assert offenders == []
    assert sum(1 for tree in TREES.values() for _ in documented(tree)) > 2000


def test_locals_are_nouns():
    offenders = [
        (file, name) for file, tree in TREES.items() for name in local_names(tree) if name in PARTICIPLES
    ]
    assert offenders == []
