"""Folders of version 0.1.0, in which the baseline laws were users' classes: read, and told."""

import re
import shutil
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.control import LeaderFollower, PrescribedPerformance
from coop_pin.description.model_laws import ComputedTorque
from coop_pin.sweeps import run_key
from coop_pin.sweeps.store import SweepStore

STORED = Path(__file__).parents[1] / "data" / "previous_laws"


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(STORED, tmp_path / "stored"))


def test_a_run_is_read_with_its_law_and_repeats(folder):
    stored = cp.RunResult.load(folder / "run" / "result.nc")
    law = stored.scenario.controller
    assert type(law) is LeaderFollower
    assert law == cp.Scenario.load(folder / "run" / "scenario.toml").controller
    again = cp.run(stored.scenario)
    # Bits are those of one machine, and the run was stored on another.
    assert_allclose(again.data["torque"], stored.data["torque"], rtol=1e-9, atol=1e-9)
    assert cp.Scenario.from_toml(stored.scenario.to_toml()).controller == law


def test_a_sweep_is_read_and_the_same_call_repeats_it(folder, caplog):
    stored = cp.SweepResult.load(folder / "sweep")
    assert {"0.1.0", cp.__version__} <= {*re.findall(r"[\d.]*\d", caplog.text)}
    assert stored.counts() == {"ok": 2, "failed": 0, "missing": 0}
    assert stored.table["controller.options.pose_gain"].tolist() == [2.0, 3.0]
    laws = [stored.plan.scenario(number).controller for number in range(2)]
    assert [law.gains.pose_gain for law in laws] == [2.0, 3.0]
    before = stored.table
    again = cp.sweep(stored.plan, out=folder / "sweep", execution=cp.Execution(workers=0, quiet=True))
    assert again.counts() == stored.counts()
    assert {*again.table["key"]}.isdisjoint(before["key"])
    names = ["position_rms_m", "torque_peak_Nm"]  # numbers of one machine, and stored on another
    assert_allclose(again.table[names], before[names], rtol=1e-9)


def test_a_comparison_is_read(folder):
    stored = cp.SweepResult.load(folder / "comparison" / "small" / "fixed")
    assert stored.counts() == {"ok": 2, "failed": 0, "missing": 0}
    kinds = {type(stored.plan.scenario(number).controller) for number in range(2)}
    assert kinds == {PrescribedPerformance, ComputedTorque}
    assert {record.key for record in SweepStore(folder / "comparison" / "small" / "fixed").records()} == {
        *stored.table["key"]
    }


def test_a_law_by_its_kind_has_a_key_of_its_own():
    base = cp.Scenario.load(STORED / "run" / "scenario.toml")
    law = base.controller
    renamed = base.replace(controller=law.model_dump())
    assert renamed.controller == law
    assert run_key.run_key(renamed) != run_key.run_key(base)
    changed = base.override({"controller.gains.pose_gain": 3.0})
    assert changed.controller.stored_as is changed.controller
