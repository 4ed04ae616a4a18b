"""Analysis of sweeps against known results, on stores filled with records of made-up metrics."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from coop_pin.base.errors import FieldError, InvalidStateError, NameNotFoundError, WrongTypeError
from coop_pin.sweeps import linspace
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import keyed_points
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.table import Columns
from coop_pin.sweeps.workers.execution import Execution
from coop_pin.sweeps.workers.job import JobRecord, Outcome

GAIN, RATE, MASS = "controller.gains.sign_gain", "clock.rate_hz", "cell.payload.mass"
SPAN = {"low": -np.pi, "high": np.pi}


def filled(folder, plan, metrics, fails=lambda _: False):
    """A sweep whose metrics are a function of the parameters."""
    store = SweepStore(folder)
    store.write_plan(plan)
    runs = []
    for point, key, *_ in keyed_points(plan):
        failure = ("DivergedError", "gone", 0.5) if fails(point.parameters) else ()
        runs.append(Outcome(JobRecord(key, {}, {} if failure else metrics(point.parameters), *failure)))
    store.append(runs)
    return SweepResult.load(folder)


@pytest.fixture
def grid(tmp_path):
    """f = (gain - 0.3)^2 + rate, g = gain; unstable where gain rate >= 60."""
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.0, 0.2, 0.4, 0.6], RATE: [50.0, 100.0, 200.0, 400.0]})
    metrics = lambda p: {"f": (p[GAIN] - 0.3) ** 2 + p[RATE], "g": p[GAIN]}  # noqa: E731
    return filled(tmp_path, plan, metrics, lambda p: p[GAIN] * p[RATE] >= 60.0)


def test_the_table_has_named_axes_and_each_run_in_its_place(grid):
    assert grid.data.sizes == {GAIN: 4, RATE: 4}
    assert float(grid.data["f"].sel({GAIN: 0.2, RATE: 100.0})) == pytest.approx(100.01)
    failed = grid.data["status"].values == "failed"
    assert_array_equal(failed, np.outer([0.0, 0.2, 0.4, 0.6], [50.0, 100.0, 200.0, 400.0]) >= 60.0)
    assert np.isnan(grid.data["f"].values[failed]).all()
    assert_array_equal(grid.data["failed_at_s"].values[failed], 0.5)
    assert len(grid.failures) == failed.sum()


def test_best_is_the_smallest_and_largest_the_largest(grid):
    assert [place.parameters for place in grid.best("f", 2)] == [
        {GAIN: 0.2, RATE: 50.0},
        {GAIN: 0.4, RATE: 50.0},
    ]
    assert grid.best("f", largest=True)[0].parameters == {GAIN: 0.0, RATE: 400.0}
    assert len(grid.best("f", 99)) == grid.counts()["ok"]
    with pytest.raises(WrongTypeError, match="largest"):
        grid.best("f", largest=np.full((4, 4), np.nan))


def test_marginals_average_what_finished(grid, tmp_path):
    found = grid.marginal(GAIN, "f")
    assert found.dims == (GAIN,)
    assert_allclose(found.values[0], 0.09 + np.mean([50.0, 100.0, 200.0, 400.0]), rtol=1e-12)
    assert_allclose(found.values[3], 0.09 + 50.0, rtol=1e-12)
    assert np.isnan(filled(tmp_path / "none", grid.plan, lambda _: {"f": np.inf}).marginal(GAIN, "f")).all()
    assert_allclose(grid.marginal(RATE, "g", average=np.max).values, [0.6, 0.4, 0.2, 0.0], rtol=0, atol=0)


def test_the_stability_boundary_lies_between_the_last_stable_and_the_first_unstable_value(grid):
    found = grid.stability_boundary(RATE)
    assert_array_equal(found["last_stable"], [400.0, 200.0, 100.0, 50.0])
    assert_array_equal(found["first_unstable"], [np.nan, 400.0, 200.0, 100.0])
    assert_array_equal(found[GAIN], [0.0, 0.2, 0.4, 0.6])
    by_metric = grid.stability_boundary(RATE, stable=grid.values("f") < 150.0)
    assert_array_equal(by_metric["last_stable"], [100.0, 100.0, 100.0, 50.0])


def test_a_boundary_of_what_is_unstable_from_the_start_is_not_a_number(tmp_path):
    plan = SweepPlan(base="adept-paper", axes={RATE: [50.0, 100.0], GAIN: [0.0, 0.1]})
    result = filled(tmp_path, plan, lambda _: {"f": 1.0}, lambda p: p[GAIN] == 0.1)
    found = result.stability_boundary(RATE)
    assert_array_equal(found["last_stable"], [100.0, np.nan])
    assert_array_equal(found["first_unstable"], [np.nan, 50.0])
    assert float(result.stability_boundary(RATE, by=[])["first_unstable"]) == 50.0


def test_runs_that_end_but_are_not_sound_or_lose_their_task_are_beyond_the_boundary(tmp_path):
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.0, 0.2, 0.4, 0.6], MASS: [2.0, 3.0]})
    verdicts = lambda p: {  # noqa: E731
        "simulation_sound": float(p[GAIN] < 0.5 or p[MASS] < 2.5),
        "task_kept": float(p[GAIN] < 0.3 or p[MASS] > 2.5),
    }
    found = filled(tmp_path, plan, verdicts).stability_boundary(GAIN)
    assert_array_equal(found["last_stable"], [0.2, 0.4])
    assert_array_equal(found["first_unstable"], [0.4, 0.6])


def test_the_pareto_front_is_what_nothing_beats(tmp_path):
    random = np.random.default_rng(0)
    a, b = random.random((2, 200))
    a[5], b[6], a[7:9] = np.nan, np.inf, 0.5
    plan = SweepPlan(base="adept-paper", axes={"seed": range(200)})
    made = filled(tmp_path / "random", plan, lambda p: {"a": a[p["seed"]], "b": b[p["seed"]]})
    front = [run.number for run in made.pareto("a", "b")]
    usable = [i for i in range(200) if np.isfinite(a[i]) and np.isfinite(b[i])]
    wanted = {
        i
        for i in usable
        if not any((a[j] <= a[i]) & (b[j] <= b[i]) & ((a[j] < a[i]) | (b[j] < b[i])) for j in usable)
    }
    assert set(front) == wanted
    assert (np.diff(a[front]) > 0.0).all()
    plan = SweepPlan(base="adept-paper", axes={GAIN: linspace(0.0, 1.0, 5)})
    result = filled(tmp_path, plan, lambda p: {"up": p[GAIN], "down": abs(p[GAIN] - 0.5)})
    assert [place.parameters[GAIN] for place in result.pareto("up", "down")] == [0.0, 0.25, 0.5]


@pytest.mark.parametrize(
    ("count", "allowed", "wide"), [(256, 0.13, 0.6), pytest.param(1024, 0.03, 0.25, marks=pytest.mark.slow)]
)
def test_sobol_indices_of_the_ishigami_function_are_the_known_ones(count, allowed, wide, tmp_path):
    """f = sin x + 7 sin^2 y + 0.1 z^4 sin x: first 0.3139, 0.4424, 0; total 0.5576, 0.4424, 0.2437."""
    fields = {"motion.constant.0": SPAN, "motion.constant.1": SPAN, "motion.constant.2": SPAN}
    plan = SweepPlan(base="adept-paper", sample={"fields": fields, "count": count, "method": "saltelli"})

    def ishigami(p):
        x, y, z = (p[name] for name in fields)
        return {"f": np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)}

    found = filled(tmp_path, plan, ishigami).sobol_indices("f", resamples=100)
    assert list(found.index) == list(fields)
    assert_allclose(found["first"], [0.3139, 0.4424, 0.0], rtol=0, atol=allowed)
    assert_allclose(found["total"], [0.5576, 0.4424, 0.2437], rtol=0, atol=allowed)
    for name in ("first", "total"):
        low, value, high = found[f"{name}_low"], found[name], found[f"{name}_high"]
        assert (low <= value).all()
        assert (value <= high).all()
        assert (high - low < wide).all()


def test_samples_are_a_dimension_whose_fields_are_coordinates(tmp_path):
    plan = SweepPlan(base="adept-paper", sample={"fields": {MASS: {"low": 1.0, "high": 2.0}}, "count": 8})
    result = filled(tmp_path, plan, lambda p: {"f": p[MASS]})
    assert result.data.sizes == {"sample": 8}
    assert_array_equal(result.data["f"], result.data[MASS])


def test_zipped_fields_stand_along_one_dimension(tmp_path):
    plan = SweepPlan(
        base="adept-paper",
        zipped=[{GAIN: [0.1, 0.2], RATE: [100.0, 200.0]}],
        cases={"payload": {"full": {}, "half": {MASS: 5.6}}},
    )
    result = filled(tmp_path, plan, lambda p: {"f": p[RATE] + (p["payload"] == "half")})
    assert result.data.sizes == {"payload": 2, GAIN: 2}
    assert_array_equal(result.data["f"].sel(payload="half"), [101.0, 201.0])
    assert_array_equal(result.data[RATE], [100.0, 200.0])
    assert_array_equal(result.marginal(RATE, "f"), [100.5, 200.5])


def test_questions_without_an_answer_are_typed_errors(grid, tmp_path):
    with pytest.raises(NameNotFoundError, match="metric"):
        grid.best("h")
    with pytest.raises(NameNotFoundError):
        grid.marginal(MASS, "f")
    with pytest.raises(NameNotFoundError):
        grid.stability_boundary(MASS)
    with pytest.raises(FieldError, match="saltelli"):
        grid.sobol_indices("f")
    (segment,) = (tmp_path / "runs").iterdir()
    segment.write_bytes(segment.read_bytes().rstrip()[:-1])
    with pytest.raises(InvalidStateError):
        SweepResult.load(tmp_path).stability_boundary(GAIN)


def test_a_summary_says_how_many_and_why(grid):
    text = repr(grid)
    assert text == grid.summary()
    failed = len(grid.failures)
    assert "NOT TRUSTWORTHY" not in text  # it counts finished runs; the failed ones have their errors
    assert f"{16 - failed} ok, {failed} failed, 0 missing" in text
    assert f"  {failed} DivergedError; run {grid.failures[0].number}: gone\n" in text


def test_a_summary_quotes_the_first_run_of_each_kind_of_failure_and_keeps_its_lines_together(tmp_path):
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.0, 0.2, 0.4]})
    store, keys = SweepStore(tmp_path), [each.key for each in keyed_points(plan)]
    for number, kind, message in (
        (0, "WorkerDiedError", "dead"),
        (1, "ScenarioError", "2 mistakes:\n  a\n  b"),
        (2, "ScenarioError", "no"),
    ):
        store.append([Outcome(JobRecord(keys[number], {}, {}, kind, message))])
    lines = SweepResult(plan, store).summary().splitlines()
    assert lines[-4:] == [
        "  2 ScenarioError; run 1: 2 mistakes:",
        "      a",
        "      b",
        "  1 WorkerDiedError; run 0: dead",
    ]


def test_the_summary_counts_runs_that_are_not_sound_lose_their_task_or_never_settle(tmp_path):
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.0, 0.2, 0.4]})
    metrics = lambda p: {  # noqa: E731
        "simulation_sound": float(p[GAIN] < 0.3),
        "task_kept": 0.0,
        "dropped_at_s": np.nan if p[GAIN] < 0.3 else 1.0,
        "settling_time_s": np.inf if p[GAIN] < 0.3 else 1.0,
        "moving_position_rms_m": np.nan,
        "torque_peak_Nm": np.nan if p[GAIN] == 0.2 else 2.0,
    }
    found = filled(tmp_path, plan, metrics)
    assert_array_equal(found.values("simulation_sound"), [1.0, 1.0, 0.0])
    text = found.summary()
    assert "1 SIMULATION NOT SOUND" in text
    assert "1 task DROPPED" in text
    assert "2 task OFF" in text
    assert "2 never settled" in text
    assert "metrics without a value in any finished run: 1\n" in text
    assert "torque_peak_Nm (1)\n" in text
    assert "position_rms_m" not in text


def test_a_part_of_a_sweep_has_the_runs_with_the_given_values_and_their_numbers(grid):
    part = grid.at({GAIN: 0.2})
    assert part.data.sizes == {RATE: 4}
    assert part.counts() == {"ok": 3, "failed": 1, "missing": 0}
    assert [failure.number for failure in part.failures] == [7]
    assert [run.number for run in part.best("f", 9)] == [4, 5, 6]
    assert part.best("f")[0] == grid.point(4)
    assert [run.number for run in part.pareto("f", "g")] == [4]
    assert part.open(4).scenario == grid.plan.scenario(4)
    single = grid.at({GAIN: "0.2", RATE: 100})
    assert single.data.sizes == {}
    assert single.counts() == {"ok": 1, "failed": 0, "missing": 0}
    assert grid.at({GAIN: "0.2"}).at({RATE: "100.0"}).data.identical(single.data)
    assert grid.at({}).data.identical(grid.data)
    for mistake, error in (({MASS: 1.0}, NameNotFoundError), ({GAIN: 0.3}, FieldError)):
        with pytest.raises(error):
            grid.at(mistake)


def test_a_part_is_chosen_by_cases_and_by_fields_that_vary_together(tmp_path):
    zipped = [{GAIN: [0.1, 0.2, 0.3], RATE: [100.0, 200.0, 200.0]}]
    plan = SweepPlan(base="adept-paper", zipped=zipped, cases={"payload": {"full": {}, "half": {MASS: 5.6}}})
    result = filled(tmp_path, plan, lambda p: {"f": p[RATE] + (p["payload"] == "half")})
    assert_array_equal(result.at({"payload": "half"}).values("f"), [101.0, 201.0, 201.0])
    assert_array_equal(result.at({RATE: 200, "payload": "full"}).values("f"), [200.0, 200.0])


def test_fields_without_effect_are_named(tmp_path):
    """Also where a metric is not a number; not if a run failed, or if there is one value only."""
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.1, 0.2], RATE: [100.0, 200.0], MASS: [1.0]})
    result = filled(tmp_path / "a", plan, lambda p: {"f": p[RATE], "g": np.nan})
    assert result.fields_without_effect() == [GAIN]
    sometimes = filled(tmp_path / "d", plan, lambda p: {"f": p[RATE], "g": np.nan if p[GAIN] == 0.2 else 1.0})
    assert sometimes.fields_without_effect() == []
    assert f"no effect on any metric here: {GAIN}\n" in result.summary()
    assert filled(tmp_path / "b", plan, lambda p: {"f": p[RATE] * p[GAIN]}).fields_without_effect() == []
    assert (
        filled(tmp_path / "c", plan, lambda _: {"f": 1.0}, lambda p: p[GAIN] == 0.2).fields_without_effect()
        == []
    )


@pytest.mark.parametrize(("scenario", "idle"), [("three-ur5-plate", True), ("two-pandas-box", False)])
def test_the_posture_of_six_joint_arms_is_told_to_have_no_effect_and_that_of_seven_is_not(
    tmp_path, scenario, idle
):
    spring = "controller.posture.stiffness"
    axes = {spring: [0.0, 30.0], "controller.gains.pose_gain": [0.5, 1.0]}
    short = {"duration": 0.02, "events": []}
    result = sweep(scenario, axes, out=tmp_path, execution=Execution(workers=0, quiet=True), changes=short)
    assert result.counts()["ok"] == 4
    assert result.fields_without_effect() == [spring] * idle
    assert (f"no effect on any metric here: {spring}" in result.summary()) == idle


@pytest.mark.parametrize("at_once", [1, 3])
def test_of_records_with_one_key_the_last_counts_with_all_it_has(at_once):
    failed = JobRecord("a", {}, {}, "DivergedError", "gone", 0.5)
    ok = JobRecord("a", {}, {"f": 1.0, "g": 2.0})
    for records, f, g in (
        ([ok, JobRecord("b", {}, {"f": 3.0}), failed], [np.nan, 3.0], [np.nan, np.nan]),
        ([failed, JobRecord("b", {}, {"f": 3.0}), ok], [1.0, 3.0], [2.0, np.nan]),
    ):
        columns = Columns(2)
        for first in range(0, 3, at_once):
            columns.add(records[first : first + at_once])
        assert_array_equal(columns.numbers["f"], [*f, np.nan])
        assert_array_equal(columns.numbers["g"], [*g, np.nan])
        assert columns.texts["failure"].tolist() == [records[-1].failure, "", None]


def test_the_order_of_metrics_does_not_depend_on_which_run_ended_first(tmp_path):
    plan = SweepPlan(base="adept-paper", axes={GAIN: [0.1, 0.2]})
    runs = [
        Outcome(JobRecord(each.key, {}, metrics))
        for each, metrics in zip(
            keyed_points(plan), ({"b": 1.0, "a": 2.0}, {"c": 1.0, "a": 3.0}), strict=True
        )
    ]
    for folder, order in (("one", runs), ("other", runs[::-1])):
        SweepStore(tmp_path / folder).append(order)
        result = SweepResult(plan, SweepStore(tmp_path / folder))
        assert result.metric_names == ["a", "b", "c"]
        result.write_tables()
    assert len({(tmp_path / folder / "table.csv").read_bytes() for folder in ("one", "other")}) == 1


def test_tables_as_text_have_every_number_and_text_as_it_is(tmp_path):
    numbers = [0.0, -0.0, 1e-5, 1.25e-5, 0.1 + 0.2, 1e16, 1.7976931348623157e308, 5e-324, np.inf, -np.inf]
    texts = ["", "a, b", 'said "so"', "two\nlines", "\u00e4", "NaN", "Infinity", "back\\", ",", " x "]
    plan = SweepPlan(base="adept-paper", axes={GAIN: linspace(0.0, 0.9, 10)})
    store, keys = SweepStore(tmp_path), [each.key for each in keyed_points(plan)]
    for key, number, text in zip(keys, numbers, texts, strict=True):
        failed = {"failure": "DivergedError", "message": text} if text else {}
        store.append([Outcome(JobRecord(key, {}, {"a": number, "b, c": np.nan}, **failed))])
    result = SweepResult(plan, store)
    result.write_tables()
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["message"] for line in lines] == texts
    assert np.array([float(line["a"]) for line in lines]).tobytes() == np.array(numbers).tobytes()
    assert {line["b, c"] for line in lines} == {""}
    assert tuple(float(line[GAIN]) for line in lines) == plan.axes[GAIN]
    assert [line["key"] for line in lines] == keys
