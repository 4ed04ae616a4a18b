"""Cases and changes: one form in a sweep, a search and a comparison."""

import numpy as np
import pytest

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError

FLAT = {"calm": {}, "soft": {"controller.gains.pose_gain": 1.0}}
SHORT = {"duration": 0.05, "events": []}
HERE = cp.Execution(workers=0, quiet=True)


@pytest.mark.parametrize(
    "cases",
    [
        {"a": {"controller": {"kind": "user", "target": "m:Law"}}},
        {"a": {}, "b": {"seed": 3}},
        {"a": {"sensors": {"encoder": {"noise": 1e-5}}}, "b": {"clock.rate_hz": 100.0}},
    ],
)
def test_cases_of_one_dimension_need_no_name_of_it(cases):
    plan = cp.SweepPlan(base="adept-paper", cases=cases)
    assert plan.cases == {"case": cases}
    assert plan == cp.SweepPlan(base="adept-paper", cases={"case": cases})


@pytest.mark.parametrize(
    "cases",
    [
        {"controller": {"paper": {}, "late": {"controller.force_path.kind": "late"}}},
        {"law": {"a": {"seed": 1}}, "payload": {"light": {"cell.payload.mass": 1.0}}},
        {"part": {"motion": {"motion.kind": "hold"}, "squeeze": {"squeeze.kind": "constant"}}},
    ],
)
def test_dimensions_of_cases_keep_their_names(cases):
    assert cp.SweepPlan(base="adept-paper", cases=cases).cases == cases


def test_a_misspelt_field_of_a_case_is_told():
    with pytest.raises((ScenarioError, FieldError), match="durationn"):
        cp.SweepPlan(base="adept-paper", cases={"a": {"durationn": 3.0}})


@pytest.mark.parametrize("scenario", ["adept-paper", "two-pandas-box"])
def test_sweep_and_tune_take_the_same_cases_and_changes(scenario, tmp_path):
    gain = "controller.gains.sign_gain"
    same = {"changes": SHORT, "cases": FLAT, "execution": HERE}
    swept = cp.sweep(scenario, {gain: [0.0, 0.1]}, out=tmp_path / "sweep", **same)
    assert swept.data.sizes["case"] == 2
    options = {"minimize": "torque_peak_Nm", "generations": 0, "population": 1, "out": tmp_path / "tune"}
    tuned = cp.tune(scenario, {gain: (0.0, 0.2)}, **options, **same)
    assert tuned.history.data.sizes["case"] == 2
    run = cp.run(scenario, SHORT | {gain: tuned.tuned[gain]}, warn=False)
    assert tuned.best.metrics["torque_peak_Nm"] == pytest.approx(run.metrics()["torque_peak_Nm"], rel=1e-9)


def test_a_search_takes_several_dimensions_of_cases(tmp_path):
    cases = {"law": FLAT, "payload": {"light": {"cell.payload.mass": 1.0}, "own": {}, "heavy": {}}}
    tuned = cp.tune(
        "adept-paper",
        {"controller.gains.sign_gain": (0.0, 0.2)},
        minimize="torque_peak_Nm",
        generations=0,
        population=1,
        changes=SHORT,
        cases=cases,
        out=tmp_path,
        execution=HERE,
    )
    peaks = tuned.history.data["torque_peak_Nm"]
    assert peaks.shape == (2, 3, 5)
    assert tuned.value == pytest.approx(float(np.min(peaks.values.mean(axis=(0, 1)))))


def test_a_field_with_a_range_has_no_value_besides(tmp_path):
    with pytest.raises(FieldError, match="duration"):
        cp.tune("adept-paper", {"duration": (1.0, 2.0)}, minimize="x", out=tmp_path, changes=SHORT)


def test_a_comparison_takes_cases_as_trials_and_changes(tmp_path):
    trials = {"calm": {}, "heavy": {"cell.payload.mass": 12.0}}
    table = cp.compare("adept-anchored", ["anchored"], trials, out=tmp_path, changes=SHORT, execution=HERE)
    assert list(table.data["trial"].values) == list(trials)
    assert table.open("adept-anchored", "anchored", "heavy").scenario.duration == SHORT["duration"]
    assert table.open("adept-anchored", "anchored", "heavy").scenario.cell.payload.mass == 12.0
