"""The tools: what they install, run and write, with stand-ins for what takes long."""

import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

STAND_IN = """#!/bin/sh
case "$1 $2 $3" in
    "-m pip --version") ;;
    "-m pip "*|"-m ensurepip "*|"-m ruff "*|"-m mypy "*|"-m pytest "*|"-m sphinx "*)
        echo "$@" >>"$CALLS"; [ "$2" != "$FAILS" ];;
    *) exec {python} "$@";;
esac
"""


@pytest.fixture
def workshop(tmp_path):
    """A copy of the tools with an environment that records its calls; only coop-pin is real."""
    folder = tmp_path / "a clone"
    shutil.copytree(REPOSITORY / "tools", folder / "tools")
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / name, folder)
    binaries = folder / ".venv" / "bin"
    binaries.mkdir(parents=True)
    for name, text in (
        ("python", STAND_IN.format(python=sys.executable)),
        ("coop-pin", f'#!/bin/sh\nexec {sys.executable} -m coop_pin "$@"\n'),
    ):
        (binaries / name).write_text(text)
        (binaries / name).chmod(0o755)
    return folder


def use(workshop, tool, *words, cwd=None, fails=""):
    """Call a tool; return what was asked for, and how it ended."""
    calls = workshop / "calls"
    calls.unlink(missing_ok=True)
    environment = os.environ | {"CALLS": str(calls), "FAILS": fails, "CHROMIUM": "/bin/true"}
    command = ["bash", str(workshop / "tools" / tool), *words]
    done = subprocess.run(
        command,
        cwd=cwd or workshop,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    asked = calls.read_text().splitlines() if calls.exists() else []
    return [line.removeprefix("-m ") for line in asked], done


def test_the_gate_installs_and_checks_everything_in_this_order(workshop):
    asked, done = use(workshop, "gate.sh")
    assert done.returncode == 0, done.stderr
    install, *stages = asked
    assert install.startswith("pip install ")
    assert "-e .[test,docs] -c constraints.txt" in install
    assert stages == [
        *("ruff format --check .", "ruff check .", "mypy"),
        "pytest -n auto --dist worksteal -q -m not slow",
    ]
    assert done.stdout.endswith("== gate passed\n")


@pytest.mark.parametrize("stage", ["pip", "ruff", "mypy", "pytest"])
def test_the_gate_stops_where_something_fails(workshop, stage):
    asked, done = use(workshop, "gate.sh", fails=stage)
    assert done.returncode != 0
    assert asked[-1].split()[0] == stage
    assert "gate passed" not in done.stdout


def test_what_is_installed_is_installed_again_only_where_something_changed(workshop):
    for tool, name in (("gate.sh", "pyproject.toml"), ("docs.sh", "constraints.txt")):
        assert use(workshop, tool)[0][0].startswith("pip install")
        assert not use(workshop, tool)[0][0].startswith("pip")
        with (workshop / name).open("a") as file:
            file.write("\n# changed\n")
        assert use(workshop, tool)[0][0].startswith("pip install")
    (workshop / "pyproject.toml").write_text("# changed again")
    assert use(workshop, "docs.sh", fails="pip")[1].returncode != 0
    assert use(workshop, "docs.sh")[0][0].startswith("pip install")


def test_the_site_is_built_with_warnings_as_errors(workshop):
    asked, done = use(workshop, "docs.sh", "-D", "nb_execution_mode=off")
    assert done.returncode == 0, done.stderr
    words = asked[-1].split()
    assert words[:1] == ["sphinx"]
    assert {"-W", "-n", "--keep-going"} <= set(words)
    assert asked[-1].endswith("-D nb_execution_mode=off docs out/docs")
    assert use(workshop, "docs.sh", fails="sphinx")[1].returncode != 0


def test_the_workflow_publishes_what_the_tool_builds():
    """One command, and the folder that it writes."""
    workflow = (REPOSITORY / ".github" / "workflows" / "pages.yml").read_text(encoding="utf-8")
    commands = re.findall(r"^ +- run: (.*)$", workflow, re.MULTILINE)
    assert commands == ["bash tools/docs.sh"]
    (folder,) = re.findall(r"upload-pages-artifact@v\d+\n +with:\n +path: (\S+)$", workflow, re.MULTILINE)
    assert f" docs {folder} " in (REPOSITORY / "tools" / "docs.sh").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_papers_experiment_is_written_where_the_user_stands(workshop, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    _, done = use(workshop, "run.sh", "mine", cwd=elsewhere)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (elsewhere / "mine").iterdir()} == {
        name
        for names in re.findall(
            r"^\| (`[\w.]+`(?:, `[\w.]+`)*)",
            (REPOSITORY / "docs" / "howto" / "shell.md").read_text(),
            re.MULTILINE,
        )
        for name in re.findall(r"[\w.]+", names)
    }


# ---------------------------------------------------------------- tools/measure.py, tools/claims.py


def tool(name):
    """A Python file of tools/ as a module."""
    spec = importlib.util.spec_from_file_location(name, REPOSITORY / "tools" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def measure():
    return tool("measure")


def test_a_difference_is_the_largest_and_its_share_is_of_what_is_allowed_there(measure):
    found = measure.difference([1.0, 2.0, np.nan], [1.1, 2.05, np.nan], rtol=0.0, atol=0.2)
    assert found.difference == pytest.approx(0.1)
    assert found.share == pytest.approx(0.5)
    assert measure.difference(3.0, 3.0, 0.0, 0.0) == (0.0, 0.0)
    assert measure.difference([100.0, 0.0], [101.0, 0.0], rtol=0.1, atol=0.0).share == pytest.approx(
        1.0 / 10.1
    )


def test_claims_are_filled_row_by_row_and_stated_numbers_stay(measure):
    rows = [
        measure.Claim("section", "one", ("test_a", "test_b"), "1e-03 (50%)"),
        measure.Claim("section", "two", ("test_c",), "–"),
        measure.Claim("section", "three", ("test_a",), "2 %"),
    ]
    found = {"test_a": measure.Found(1e-12, 0.001), "test_b": measure.Found(3e-9, 0.25)}
    filled = measure.filled(rows, found)
    assert [one.found for one in filled] == ["3e-09 (25%)", "–", "2 %"]
    assert measure.filled(filled, found) == filled


def test_every_claim_has_tests_and_says_what_they_find(tmp_path):
    claims = tool("claims")
    rows = claims.read()
    assert len(rows) > 100
    assert [
        one for one in rows if not all((one.section, one.claim, one.tests, one.found)) or "|" in one.claim
    ] == []
    assert len({one.claim for one in rows}) == len(rows)
    claims.write(rows, tmp_path / "claims.tsv")
    assert claims.read(tmp_path / "claims.tsv") == rows
    assert (tmp_path / "claims.tsv").read_bytes() == claims.FILE.read_bytes()
    page = (REPOSITORY / "docs" / "verification.md").read_text(encoding="utf-8")
    assert len(page.split()) < 5000


def test_tables_of_claims_have_files_and_tiers_and_only_tests_that_exist():
    claims = tool("claims")
    where = {"test_a": {"one/test_x.py": ""}, "test_b": {"one/test_x.py": "slow"}}
    rows = [
        claims.Claim("S", "it holds", ("test_a", "test_b"), "2 %"),
        claims.Claim("T", "too", ("test_a",), "–"),
    ]
    assert claims.table(rows, where).splitlines() == [
        "## S",
        "",
        "| claim | test | found |",
        "| --- | --- | --- |",
        "| it holds | `one/test_x.py`: `test_a`, `test_b` (slow) | 2 % |",
        "",
        "## T",
        "",
        "| claim | test | found |",
        "| --- | --- | --- |",
        "| too | `one/test_x.py`: `test_a` | – |",
    ]
    with pytest.raises(ValueError, match="test_c"):
        claims.table([claims.Claim("S", "no", ("test_c",), "–")], where)
    places = claims.places()
    assert places["test_one_simulated_hour"] == {"simulation/test_simulation.py": "slow"}
    assert places["test_every_plant_gives_the_same_run"] == {"description/test_catalogue.py": "partly slow"}


def test_a_test_that_does_not_exist_is_not_measured_as_nothing(measure):
    with pytest.raises(SystemExit, match="there is no test named test_of_nothing"):
        measure.measure({"test_of_nothing"})


@pytest.mark.gate
def test_what_claims_say_is_what_is_found(measure):
    """The quick ones of their rows, measured again: the same order of magnitude."""
    names = {
        "test_tip_pose_is_what_yourdfpy_says",
        "test_mass_matrix_is_the_kinetic_energy_of_the_links",
        "test_a_closure_opened_by_a_decimetre_recovers_at_the_baumgarte_rate",
    }
    code = "import sys; sys.path.insert(0, 'tools'); import measure"
    code += f"; print(repr(dict(measure.measure({names}))))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stdout
    found = eval(done.stdout.splitlines()[-1], {"Found": measure.Found})
    assert set(found) == names
    for name, now in found.items():
        (row,) = [one for one in measure.read() if name in one.tests]
        written = float(row.found.split()[0])
        assert 0.1 < max(now.difference, 1e-15) / max(written, 1e-15) < 10.0, name


# ---------------------------------------------------------------- tools/statements.py


def test_statements_are_counted_inside_others_and_docstrings_are_not():
    source = '''"""Module."""
X = 1
"""Meaning of X."""


def f(a):
    """Return a."""
    if a:
        return a
'''
    assert tool("statements").statements(source) == 4


def test_statements_of_every_package_are_in_the_table():
    entries = {file.stem for file in (REPOSITORY / "coop_pin").glob("*.py")}
    entries |= {file.parent.name for file in (REPOSITORY / "coop_pin").glob("*/__init__.py")}
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "tools" / "statements.py")],
        capture_output=True,
        text=True,
        check=True,
    )
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    table = {name: (int(files), int(size)) for name, files, size in rows}
    assert table.pop("coop_pin") == tuple(map(sum, zip(*table.values(), strict=True)))
    assert set(table) == entries
    assert all(files >= 1 and size >= 1 for files, size in table.values())
    texts = [
        file.read_text(encoding="utf-8") for file in (REPOSITORY / "coop_pin" / "reference").rglob("*.py")
    ]
    assert table["reference"] == (len(texts), sum(map(tool("statements").statements, texts)))


# ---------------------------------------------------------------- tools/mutate.py


@pytest.fixture(scope="module")
def mutate():
    return tool("mutate")


@pytest.mark.parametrize(
    ("line", "becomes"),
    [
        ("y = a + b", {"y = a - b", "y = a", "y = b"}),
        ("y = a - b", {"y = a + b", "y = a"}),
        ("y = J @ v", {"y = J * v", "y = J", "y = v"}),
        ("y = -a", {"y = a"}),
        ("y = x[:3]", {"y = x[:4]"}),
        ("y = 0.5", {"y = 1.0"}),
        ("y = True", {"y = False"}),
        ("y = a < b", {"y = a <= b"}),
        ("y = a and (not b)", {"y = a or not b", "y = a", "y = not b", "y = a and b"}),
        ("y = a if b else c", {"y = a if not b else c"}),
        ("y: 'int | None' = zip(a, b, strict=True)", set()),
        ("raise ValueError(1 + 2)", set()),
    ],
)
def test_a_line_has_these_mutants(mutate, line, becomes):
    found = list(mutate.mutants("one.py", line))
    assert {ast.unparse(ast.parse(mutant.source)) for mutant in found} == becomes
    assert all(mutant.lines == range(1, 2) and mutant.text == line for mutant in found)


def test_every_test_file_of_the_mutation_run_exists_and_every_equivalent_mutant_too(mutate):
    exist = {path.stem for path in (REPOSITORY / "tests").rglob("test_*.py")}
    assert {f"test_{name}" for names in mutate.TESTS.values() for name in names.split()} <= exist
    assert {path.parent.name for path in mutate.PACKAGE.glob("*/__init__.py")} == set(mutate.TESTS)
    found = mutate.all_mutants({file for file, *_ in mutate.equivalent()})
    assert len(found) > 1000
    assert mutate.equivalent() <= {mutant.key for mutant in found}


def test_planted_faults_change_one_place_each_of_a_package_with_tests(mutate):
    found = mutate.planted()
    assert len(found) > 60
    assert {mutant.package for mutant in found} <= set(mutate.TESTS)
    for mutant in found:
        before = (mutate.PACKAGE / mutant.file).read_text()
        changed = [*before.splitlines()][mutant.lines.start - 1 : mutant.lines.stop - 1]
        assert mutant.old in "\n".join(changed)
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(before))


def other_sign(mutate):
    (mutant,) = (
        mutant
        for mutant in mutate.mutants(
            "base/spatial/internal_wrench.py",
            (mutate.PACKAGE / "base/spatial/internal_wrench.py").read_text(),
        )
        if mutant.new == "interaction + load_wrenches(interaction, load_shares)"
    )
    return mutant


@pytest.mark.filterwarnings("error")
def test_a_mutant_that_python_warns_of_is_one_too(mutate):
    text = (mutate.PACKAGE / "base/spatial/pose.py").read_text()
    subscripted = [one for one in mutate.mutants("base/spatial/pose.py", text) if "((1.0))[" in one.source]
    assert subscripted
    for mutant in subscripted:
        assert {name for name, _ in mutate.changed_names(mutant)} == {"quaternions"}


def internal_sum(_):
    module = importlib.import_module("coop_pin.base.spatial.internal_wrench")
    return float(module.internal_wrenches(np.ones((2, 1)), np.full(2, 0.5)).sum())


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_mutant_acts_in_its_child_whether_a_function_is_changed_or_its_file_loaded_anew(mutate):
    mutant = other_sign(mutate)
    assert {name for name, _ in mutate.changed_names(mutant)} == {"internal_wrenches"}
    functions = [importlib.import_module("coop_pin.base.spatial.internal_wrench").internal_wrenches]

    def change(way):
        if way == "function":
            mutate.change_functions(mutant, functions)
        elif way == "file":
            mutate.load_changed(mutant)
        elif way == "slow":
            time.sleep(60.0)
        return internal_sum(way)

    ways = ["none", "function", "file", "slow"]
    found = dict(mutate.in_children(ways, change, lambda way: 0.01 if way == "slow" else 60.0, 1))
    assert found == {"none": 0.0, "function": 4.0, "file": 4.0, "slow": None}
    assert internal_sum(None) == 0.0


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_nothing_of_the_package_stays_loaded_beside_a_file_loaded_anew(mutate):
    """A namespace has no file; one that stays has classes of before, and tests fail whatever is changed."""
    importlib.import_module("coop_pin.events")

    def left(mutant):
        mutate.load_changed(mutant)
        return [name for name in sys.modules if name.partition(".")[0] == "coop_pin"]

    ((_, names),) = mutate.in_children([other_sign(mutate)], left, lambda _: 60.0, 1)
    assert names == []


def test_the_lines_that_are_executed(mutate):
    with mutate.executed_lines() as lines:
        internal_sum(None)
    (line,) = other_sign(mutate).lines
    assert ("base/spatial/internal_wrench.py", line) in lines
    assert {file for file, _ in lines} == {"base/arrays.py", "base/spatial/internal_wrench.py"}
