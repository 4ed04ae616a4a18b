"""CONTRIBUTING.md: the files that it names exist, its lists are short, and its examples work."""

import inspect
import re
import sys
from pathlib import Path

import pytest

import coop_pin as cp
from coop_pin.cli.parsing import COMMANDS

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
MOST = {
    "A metric": 1,
    "A trial of the benchmark": 1,
    "A cell of the catalogue": 1,
    "A command": 2,
    "A law": 3,
    "A sensor": 5,
    "An actuator effect": 4,
    "An event": 4,
    "A recorded quantity": 2,
}
"""Most files of the package that an addition touches."""


def sections():
    """Files of the package that each list names, by its heading."""
    _, *parts = re.split(r"^### (.*)$", PAGE, flags=re.MULTILINE)
    lists = (re.findall(r"^- `(coop_pin/[^`]*)`", text, re.MULTILINE) for text in parts[1::2])
    return dict(zip(parts[::2], lists, strict=True))


def test_every_file_that_is_named_exists():
    named = re.findall(r"`((?:coop_pin|tests|tools|studies|benchmarks|examples|docs)/[\w./]+\.\w+)`", PAGE)
    named += [target.partition("#")[0] for target in re.findall(r"\]\(([^)]+)\)", PAGE)]
    assert len(named) > 25
    offenders = [name for name in named if "NAME" not in name and not (REPOSITORY / name).is_file()]
    assert offenders == []


def test_every_tool_is_in_the_table():
    tools = {
        f"tools/{file.name}" for file in (REPOSITORY / "tools").iterdir() if file.suffix in (".py", ".sh")
    }
    assert tools - {"tools/setup.sh"} == set(re.findall(r"^\| `(tools/[^`]+)` \|", PAGE, re.MULTILINE))


def test_no_addition_touches_more_files_than_is_allowed():
    files = sections()
    assert set(MOST) <= set(files)
    assert {name: len(files[name]) for name, most in MOST.items() if len(files[name]) > most} == {}


def test_a_controller_a_metric_a_scenario_and_a_trial_are_added_as_written(tmp_path, monkeypatch):
    """In a folder of their own, without touching the package."""
    module, script = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    (tmp_path / "mine.py").write_text(module)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    names = {}
    exec(compile(script, "CONTRIBUTING.md", "exec"), names)
    speeds = cp.SweepResult.load("out/sweep").values("peak_speed_rad_s").values
    assert (speeds > 0.0).all()
    table = cp.compare(
        "adept-anchored",
        names["controllers"],
        names["trials"],
        out="out/compare",
        duration=0.2,
        execution=cp.Execution(workers=0, quiet=True),
    )
    assert set(table.data["trial"].values) == {"nominal", "half the rate"}
    assert set(table.data["controller"].values) == {"damper", "anchored"}
    monkeypatch.delitem(sys.modules, "mine")


def test_a_cell_of_the_catalogue_is_found_by_its_file():
    """A file in the folder is all that a new one takes."""
    files = (REPOSITORY / "coop_pin" / "description" / "scenarios").iterdir()
    assert cp.scenario_names() == sorted(file.stem for file in files)


@pytest.mark.parametrize("command", [*COMMANDS.values()])
def test_a_command_is_a_function_that_returns_an_exit_code_or_nothing(command):
    assert command.__module__.startswith("coop_pin.cli.")
    assert inspect.signature(command).return_annotation in ("int", "None")
