"""Commands with a scenario of somebody else: code that it names is told, refused or not imported."""

import sys

import pytest
from tiers import by_default

import coop_pin as cp
from coop_pin.base.schema.user_code import ALLOWED
from coop_pin.cli import main

OWN = """
from pathlib import Path
import numpy as np
print("imported")
Path("imported").touch()
def pose(time, cmd=""):
    X = np.eye(4)
    X[:2, 3] = 0.6, 0.146
    return X
"""
COMMANDS = {
    "check": ["check", "stranger.toml", "--poses", "5"],
    "suggest": ["suggest", "stranger.toml", "--poses", "5"],
    "export": ["export", "stranger.toml", "--to", "c", "--arm", "left", "--ticks", "1", "--out", "c"],
    "root-locus": ["root-locus", "stranger.toml", "--gain", "controller.gains.pose_gain", "--count", "1"],
    "run": ["run", "stranger.toml", "--no-figures", "--no-replay", "--out", "run"],
    "sweep": ["sweep", "plan.toml", "--workers", "0", "--out", "sweep"],
    "view": ["view", "stranger.toml", "--no-open"],
    "compare": ["compare", "stranger.toml", "--controllers", "anchored", "--trials", "nominal"],
}


@pytest.fixture
def own(tmp_path):
    """Name of a function in a module of the working folder, which no other test has loaded."""
    name = f"own_{tmp_path.name.replace('-', '_').replace('[', '_')}"
    (tmp_path / f"{name}.py").write_text(OWN)
    yield f"{name}:pose"
    sys.modules.pop(name, None)


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """Writer of a scenario that names code, and of a plan of it, in the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(ALLOWED, "")

    def write(target, **options):
        motion = {"kind": "function", "target": target, "options": options}
        changes = {"duration": 0.05, "events": [], "motion": motion}
        scenario = cp.Scenario.load("adept-anchored", changes)
        scenario.save("stranger.toml")
        (tmp_path / "plan.toml").write_text('base = "stranger.toml"\n')

    return write


@pytest.mark.parametrize("command", COMMANDS)
def test_code_of_the_standard_library_is_refused_by_every_command(stranger, tmp_path, command, capsys):
    stranger("pydoc:pipepager", cmd=f"touch {tmp_path / 'PWNED'}")
    for options in ([], ["--no-code"]):
        assert main([*COMMANDS[command], *options]) == 2
        assert "'pydoc:pipepager'" in capsys.readouterr().err
    assert not (tmp_path / "PWNED").exists()


@pytest.mark.parametrize("command", COMMANDS)
def test_no_code_refuses_code_of_the_working_folder_before_it_is_imported(stranger, own, tmp_path, command):
    stranger(own)
    assert main([*COMMANDS[command], "--no-code"]) == 2
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize("command", by_default(["check", "run", "sweep"], "run"))
def test_code_is_told_in_the_first_line_before_it_is_imported(stranger, own, command, capsys):
    stranger(own)
    main(COMMANDS[command])
    lines = capsys.readouterr().out.splitlines()
    assert own in lines[0]
    assert "imported" not in lines[0]


def test_the_line_is_no_part_of_json(stranger, own, capsys):
    stranger(own)
    main([*COMMANDS["check"], "--json"])
    out, err = capsys.readouterr()
    assert own in err
    assert own not in out.splitlines()[0]


def test_a_listed_module_is_used(stranger, own, tmp_path, monkeypatch, capsys):
    stranger(own)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    words = ["check", "../stranger.toml", "--poses", "5"]
    assert main(words) == 2
    assert not (tmp_path / "elsewhere" / "imported").exists()
    assert main([*words, "--allow-code", own.partition(":")[0]]) == 0
    assert own in capsys.readouterr().out


def test_workers_import_nothing_of_the_working_folder_that_is_not_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    (tmp_path / "pebble.py").write_text("open('PWNED', 'w')\n")
    text = 'base = "adept-paper"\nengine = "pinocchio"\nchanges = { duration = 0.05, events = [] }\n'
    (tmp_path / "plan.toml").write_text(text)
    assert main(["sweep", "plan.toml", "--workers", "1", "--out", "sweep", "--quiet"]) == 0
    assert not (tmp_path / "PWNED").exists()


def test_the_interface_has_the_same_rule(stranger, tmp_path):
    stranger("pydoc:pipepager", cmd=f"touch {tmp_path / 'PWNED'}")
    scenario = cp.Scenario.load("stranger.toml")
    law = {"kind": "user", "target": "pydoc:TextDoc"}
    event = {"kind": "user", "time": 0.02, "target": "pydoc:pipepager"}
    for call in (cp.run, cp.check, cp.suggest):
        with pytest.raises(cp.errors.CodeRefusedError):
            call(scenario)
    for changes in ({"controller": law}, {"events": [event]}, {"squeeze": {**event, "kind": "function"}}):
        changes["squeeze"] = {key: changes.get("squeeze", {}).get(key) for key in ("kind", "target")}
        changes = {key: value for key, value in changes.items() if value != {"kind": None, "target": None}}
        with pytest.raises(cp.errors.CodeRefusedError):
            cp.run("adept-anchored", {"duration": 0.05, "events": []} | changes)
    with pytest.raises(cp.errors.CodeRefusedError):
        cp.sweep(scenario, {"seed": [0, 1]}, out=tmp_path / "sweep", execution=cp.Execution(quiet=True))
    with pytest.raises(cp.errors.CodeRefusedError):
        cp.sweep("adept-anchored", metrics=("pydoc:pipepager",), out=tmp_path / "sweep")
    assert not (tmp_path / "PWNED").exists()


@pytest.mark.gate
def test_pages_of_a_result_call_nothing_that_it_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = cp.run("adept-anchored", {"duration": 0.02, "events": []}, warn=False)
    law = {"kind": "user", "target": "nowhere:Law"}
    squeeze = {"kind": "function", "target": "pydoc:pipepager"}
    changes = {"squeeze": squeeze, "motion": squeeze, "controller": law}
    cp.RunResult(result.scenario.override(changes), result.data).save("result.nc")
    assert main(["report", "result.nc"]) == 0
    assert main(["export", "result.nc", "--to", "csv"]) == 0
    assert main(["view", "result.nc", "--no-open"]) == 0
    assert "pydoc:pipepager" in (tmp_path / "report.html").read_text()
