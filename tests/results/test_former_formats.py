"""Folders of formats before 0.2.0 are refused with the command that repeats them; others are found."""

import json
import shutil
import tomllib
from pathlib import Path

import pytest
import tomli_w
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import FieldError, FileReadError
from coop_pin.cli import main
from coop_pin.comparison import Comparison
from coop_pin.sweeps.run_key import run_key
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.job import checked_content, checksummed

HERE = cp.Execution(workers=0, quiet=True)
FORMER = Path(__file__).parents[1] / "data" / "former"


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(FORMER, tmp_path / "former"))


def test_a_run_is_refused_and_repeated_by_the_command_once_its_law_has_its_kind(folder):
    result, file = folder / "run" / "result.nc", folder / "run" / "scenario.toml"
    command = ["run", str(file), "--out", str(folder / "run")]
    with pytest.raises(FileReadError) as caught:
        cp.RunResult.load(result)
    assert f"coop-pin {' '.join(command)}" in str(caught.value)
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load(file)
    assert caught.value.path == "controller.target"
    assert main(command) == 2
    table = tomllib.loads(file.read_text())
    gains = {name: gain for name, gain in table["controller"]["options"].items() if gain is not None}
    table["controller"] = {"kind": "leader-follower", "gains": gains}
    file.write_text(tomli_w.dumps(table))
    assert main([*command, "--no-figures", "--no-replay", "--quiet"]) in (0, 4)
    assert cp.RunResult.load(result).scenario.controller == cp.Scenario.load(file).controller


def test_a_sweep_is_refused_and_the_same_call_repeats_it(folder):
    with pytest.raises(FileReadError, match=r"coop-pin sweep .*cp\.sweep") as caught:
        cp.SweepResult.load(folder / "sweep")
    assert "before 0.2.0" in str(caught.value)
    former = {record.key for record in SweepStore(folder / "sweep").records()}
    base = cp.Scenario.load("adept-paper").replace(duration=0.2, events=())
    plan = cp.SweepPlan(base=base, axes={"controller.gains.sign_gain": [0.1, 0.2]})
    again = cp.sweep(plan, out=folder / "sweep", execution=HERE)
    assert again.counts() == {"ok": 2, "failed": 0, "missing": 0}
    assert former.isdisjoint(again.table["key"])
    assert cp.SweepResult.load(folder / "sweep").counts() == again.counts()


def test_a_comparison_is_refused(folder):
    with pytest.raises(FileReadError, match="coop-pin compare"):
        Comparison.load(folder / "comparison")


def test_a_sweep_of_another_version_is_refused_and_repeated(tmp_path):
    base = cp.Scenario.load("adept-paper").replace(duration=0.1, events=())
    plan = cp.SweepPlan(base=base, axes={"controller.gains.sign_gain": [0.1, 0.2]})
    cp.sweep(plan, out=tmp_path, execution=HERE)
    fields = json.loads(checked_content((tmp_path / "plan.json").read_bytes().strip()))
    content = json.dumps(fields | {"coop_pin": "9.8.7"}).encode()
    (tmp_path / "plan.json").write_bytes(checksummed(content) + b"\n")
    with pytest.raises(FileReadError, match=r"9\.8\.7"):
        cp.SweepResult.load(tmp_path)
    assert cp.sweep(plan, out=tmp_path, execution=HERE).counts()["ok"] == 2


@pytest.mark.parametrize("engine", by_default(["pinocchio", "compiled"], "pinocchio"))
def test_what_this_version_stores_is_found(tmp_path, engine):
    base = cp.Scenario.load("adept-anchored").replace(duration=0.1, events=())
    plan = cp.SweepPlan(base=base, axes={"controller.gains.sign_gain": [0.1, 0.2]}, engine=engine, keep="all")
    first = cp.sweep(plan, out=tmp_path, execution=HERE)
    again = cp.sweep(plan, out=tmp_path, execution=HERE)
    assert len(SweepStore(tmp_path).segments()) == 1  # nothing was computed again
    assert again.data.identical(first.data)
    assert cp.SweepResult.load(tmp_path).data.identical(first.data)
    stored = first.open(0).scenario
    assert stored == plan.scenario(0)
    assert run_key(stored, engine=engine) == first.table["key"][0]


@pytest.mark.parametrize("name", cp.scenario_names())
def test_scenarios_have_the_keys_of_their_files(name):
    scenario = cp.Scenario.load(name)
    for read in (
        cp.Scenario.from_toml(scenario.to_toml()),
        cp.Scenario.model_validate_json(scenario.model_dump_json()),
    ):
        assert read == scenario
        assert run_key(read) == run_key(scenario)
