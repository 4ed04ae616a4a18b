"""Sweep plans: points are counted, ordered and found without being stored; dimensions, samples and keys."""

import importlib
import itertools
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import (
    ArgumentError,
    FieldError,
    FileReadError,
    NameNotFoundError,
    UnknownFieldError,
    WrongTypeError,
)
from coop_pin.description.urdf import find_urdf
from coop_pin.sweeps import Sample, estimate, linspace, logspace
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.run_key import run_key, unresolved_key

GAIN, RATE, MASS = "controller.gains.sign_gain", "clock.rate_hz", "cell.payload.mass"
SHORT = {"duration": 0.25, "events": []}


def plan(**fields):
    return SweepPlan(**{"base": "adept-paper", "changes": SHORT} | fields)


# ---------------------------------------------------------------- points


def test_points_are_the_product_of_the_dimensions_with_the_last_fastest():
    cases = {"law": {"sign": {}, "tanh": {"controller.switching": {"kind": "tanh", "width": 0.1}}}}
    zipped = [{"controller.gains.pose_gain": [1.0, 2.0], "controller.gains.transient_rate": [4.0, 5.0]}]
    made = plan(cases=cases, axes={GAIN: [0.0, 0.1, 0.2], RATE: [80.0, 160.0]}, zipped=zipped)
    wanted = list(
        itertools.product(["sign", "tanh"], [0.0, 0.1, 0.2], [80.0, 160.0], [(1.0, 4.0), (2.0, 5.0)])
    )
    assert made.shape == (2, 3, 2, 2)
    assert len(made) == len(wanted) == len(list(made.points()))
    for point, (law, gain, rate, (pose_gain, transient)) in zip(made.points(), wanted, strict=True):
        scenario = made.scenario(point.number)
        assert scenario.controller.switching.kind == law
        assert scenario.controller.gains.sign_gain == gain
        assert scenario.clock.rate_hz == rate
        assert (scenario.controller.gains.pose_gain, scenario.controller.gains.transient_rate) == (
            pose_gain,
            transient,
        )
        assert point.parameters["law"] == law


def test_a_point_is_its_base_with_its_changes_and_nothing_else():
    made = plan(axes={MASS: [5.0, 6.0]})
    assert made.scenario(1) == cp.Scenario.load("adept-paper", SHORT | {MASS: 6.0})
    assert SweepPlan(base="adept-paper").scenario(0) == cp.Scenario.load("adept-paper")


def test_several_bases_are_a_dimension():
    heavy = cp.Scenario.load("adept-paper", {MASS: 20.0, "name": "heavy"})
    made = plan(base=["adept-paper", heavy])
    assert [made.scenario(i).cell.payload.mass for i in range(len(made))] == [11.2, 20.0]
    assert [point.parameters["base"] for point in made.points()] == ["adept-paper", "heavy"]


def test_negative_places_count_from_the_end_and_others_are_refused():
    made = plan(axes={GAIN: [0.0, 0.1, 0.2]})
    assert made[-1] == made[2]
    for number in (3, -4):
        with pytest.raises(IndexError):
            made[number]


def test_a_million_points_cost_no_memory_and_any_is_found_at_once():
    made = plan(
        axes={GAIN: linspace(0.0, 1.0, 1000), RATE: linspace(50.0, 150.0, 1000)},
        sample={"fields": {MASS: (span := {"low": 1.0, "high": 2.0})}, "count": 2**20},
    )
    assert len(made) == 1000 * 1000 * 2**20
    point = made[len(made) - 1]
    assert point.parameters[GAIN] == 1.0
    assert span["low"] <= point.parameters[MASS] <= span["high"]
    assert sys.getsizeof(made.model_dump_json()) < 1e5
    assert next(iter(made.points())).number == 0


def test_a_plan_survives_json_and_prints_its_size():
    made = plan(
        axes={GAIN: logspace(0.01, 1.0, 3)},
        sample={"fields": {MASS: {"low": 1, "high": 2}}, "count": 4},
        keep=[0],
    )
    assert SweepPlan(**made.model_dump(mode="json")) == made
    assert "3 x 4 = 12 runs" in made.summary()
    assert GAIN in made.summary()


def test_a_plan_is_read_from_toml_with_scenarios_beside_it(tmp_path):
    cp.Scenario.load("adept-paper", SHORT | {"name": "mine"}).save(tmp_path / "mine.toml")
    text = f"""
base = "mine.toml"
[axes]
"{GAIN}" = {{ linspace = [0.0, 1.0, 5] }}
"{RATE}" = {{ range = [80, 140, 20] }}
[cases.payload]
full = {{}}
half = {{ "{MASS}" = 5.6 }}
[sample]
method = "latin-hypercube"
count = 3
fields = {{ "controller.gains.pose_gain" = {{ low = 0.5, high = 2.0, scale = "log" }} }}
"""
    (tmp_path / "sweep.toml").write_text(text)
    made = SweepPlan.load(tmp_path / "sweep.toml")
    assert list(made.base) == ["mine"]
    assert made.shape == (2, 5, 3, 3)
    assert made.axes[RATE] == (80, 100, 120)


# ---------------------------------------------------------------- values


def test_spacings_are_those_of_numpy():
    made = plan(
        axes={
            GAIN: linspace(0.0, 1.0, 7),
            RATE: logspace(10.0, 1000.0, 5),
            MASS: np.array([1.0, 2.0]),
            "clock.steps_per_tick": range(1, 4),
        }
    )
    assert_allclose(made.axes[GAIN], np.linspace(0.0, 1.0, 7), rtol=0, atol=0)
    assert_allclose(made.axes[RATE], [10.0, 10**1.5, 100.0, 10**2.5, 1000.0], rtol=1e-12)
    assert made.axes[MASS] == (1.0, 2.0)
    assert made.axes["clock.steps_per_tick"] == (1, 2, 3)


@pytest.mark.parametrize(
    "fields",
    [
        {"axes": {GAIN: []}},
        {"axes": {GAIN: 3.0}},
        {"axes": {GAIN: {"linspce": [0, 1, 2]}}},
        {"axes": {GAIN: {"linspace": [0, 1]}}},
        {"axes": {GAIN: {"linspace": [0, 1, 0]}}},
        {"axes": {GAIN: {"logspace": [0, 1, 3]}}},
        {"axes": {GAIN: {"range": [0, 1, -1]}}},
        {"axes": {GAIN: [1]}, "zipped": [{GAIN: [2]}]},
        {"zipped": [{GAIN: [1, 2], RATE: [80]}]},
        {"cases": {"law": {"a": 3}}},
        {"cases": {"sample": {"a": {}}}},
        {"keep": "some"},
        {"keep": [1]},
        {"base": []},
        {"base": ["adept-paper", "adept-paper"]},
        {"sample": {"fields": {GAIN: {"low": 1, "high": 0}}, "count": 4}},
        {"sample": {"fields": {GAIN: {"low": 0, "high": 1, "scale": "log"}}, "count": 4}},
        {"sample": {"fields": {GAIN: {"low": 0, "high": 1}}, "count": 5}},
        {"cases": {"status": {"a": {}}}},
        {"repeats": 1 << 62, "axes": {GAIN: [0.0, 0.1]}},
    ],
    ids=str,
)
def test_a_plan_with_a_mistake_is_refused(fields):
    with pytest.raises(FieldError):
        plan(**fields)


def test_points_in_order_are_the_entries_of_the_plan_and_none_is_made_before_it_is_asked_for():
    for each in (plan(), plan(axes={GAIN: [0.1, 0.2], "cell.payload.mass": [5.0, 6.0, 7.0]}, repeats=2)):
        assert list(each.points()) == [each[number] for number in range(len(each))]
    endless = plan(axes={GAIN: [0.1, 0.2]}, repeats=1 << 50).points()
    assert [next(endless).places for _ in range(3)] == [(0, 0), (0, 1), (0, 2)]


def test_repeats_are_a_last_dimension_of_seeds():
    repeated = plan(repeats=3, axes={GAIN: [0.1, 0.2]})
    assert repeated.shape == (2, 3)
    assert [repeated[i].changes["seed"] for i in range(4)] == [0, 1, 2, 0]
    assert "seed" not in plan(repeats=1)[0].changes
    with pytest.raises(FieldError) as refused:
        plan(repeats=3, axes={"seed": [1, 2]})
    assert "seed" in str(refused.value)
    with pytest.raises(FieldError) as refused:
        plan(repeats=0)
    assert refused.value.path == "repeats"


def test_spacings_are_plain_numbers_and_refuse_what_has_none():
    assert linspace(0, 1, 3) == [0.0, 0.5, 1.0]
    assert logspace(1, 100, 3) == pytest.approx([1.0, 10.0, 100.0])
    assert {type(value) for value in (*linspace(0, 1, 3), *logspace(1, 8, 4))} == {float}
    for mistake in (lambda: linspace(0, 1, 0), lambda: linspace(0, 1, 1 << 70), lambda: logspace(0, 1, 3)):
        with pytest.raises(ArgumentError):
            mistake()
    with pytest.raises(WrongTypeError):
        linspace(0, 1, 2.0)


def test_a_misspelt_field_is_refused_before_anything_runs_and_a_bad_value_is_not():
    with pytest.raises(UnknownFieldError, match="sign_gain"):
        plan(axes={"controller.gains.sing_gain": [0.0]})
    with pytest.raises(UnknownFieldError):
        plan(cases={"law": {"a": {}, "b": {"controller.nothing": 1}}})
    assert len(plan(axes={"controller.gains.force_gain": [-1.0, 5.0]})) == 2


def test_files_that_are_no_plans_are_refused(tmp_path):
    with pytest.raises(NameNotFoundError):
        SweepPlan.load(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("base = ")
    with pytest.raises(FileReadError):
        SweepPlan.load(tmp_path / "bad.toml")


# ---------------------------------------------------------------- samples


def test_sobol_points_are_those_of_scipy_in_ranges_given_as_spans_or_pairs():
    from scipy.stats import qmc

    sample = Sample(fields={"a": {"low": 0, "high": 1}, "b": (2, 4)}, count=64, seed=5)
    whole = qmc.Sobol(2, scramble=True, rng=np.random.default_rng(5)).random(64)
    found = [sample.dimension().changes(i) for i in range(64)]
    assert_array_equal([point["a"] for point in found], whole[:, 0])
    assert_array_equal([point["b"] for point in found], 2.0 + 2.0 * whole[:, 1])


def test_a_latin_hypercube_has_one_point_in_every_slice():
    sample = Sample(
        fields={"a": {"low": 0, "high": 1}, "b": {"low": 0, "high": 1}}, count=50, method="latin-hypercube"
    )
    slices = np.floor(50 * sample.fractions())
    for column in slices.T:
        assert_array_equal(np.sort(column), np.arange(50))


def test_saltelli_points_differ_from_those_of_a_in_one_column_taken_from_b():
    sample = Sample(fields={name: {"low": 0, "high": 1} for name in "abc"}, count=8, method="saltelli")
    blocks = sample.fractions().reshape(5, 8, 3)
    assert sample.dimension().size == 40
    a, b = blocks[0], blocks[1]
    for column in range(3):
        wanted = a.copy()
        wanted[:, column] = b[:, column]
        assert_array_equal(blocks[2 + column], wanted)


def test_same_seed_same_points_and_log_spans_keep_their_ends():
    spans = {"a": {"low": 1e-3, "high": 1e3, "scale": "log"}}
    points = [
        Sample(fields=spans, count=64, method="random", seed=seed).dimension().fields["a"]
        for seed in (1, 1, 2)
    ]
    assert points[0] == points[1] != points[2]
    assert 1e-3 <= min(points[0]) < 0.03
    assert 30 < max(points[0]) <= 1e3


# ---------------------------------------------------------------- keys and time


def test_equal_scenarios_have_equal_keys_and_any_change_makes_another():
    base = cp.Scenario.load("adept-paper")
    again = cp.Scenario.from_toml(base.to_toml())
    changed = [
        {"clock.rate_hz": 81.0},
        {GAIN: 0.2000001},
        {"duration": 20.5},
        {"cell.arms.left.base.xyz": [0.0, 0.0, 1e-12]},
    ]
    keys = {run_key(base.override(change)) for change in changed} | {
        run_key(base),
        run_key(base, ("faulty:answer",)),
    }
    assert run_key(again) == run_key(base)
    assert len(keys) == len(changed) + 2


def test_a_changed_robot_file_makes_another_key(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(find_urdf("adept_3dof").path.read_text())
    scenario = cp.Scenario.load("adept-paper", {"cell.arms.left.urdf": str(urdf)})
    before = run_key(scenario)
    assert run_key(scenario) == before
    urdf.write_text(urdf.read_text() + "<!-- -->\n")
    assert run_key(scenario) != before


def test_an_estimate_counts_runs_and_divides_by_workers():
    one, two = (estimate(plan(axes={GAIN: linspace(0.0, 0.1, 10)}), workers=workers) for workers in (1, 2))
    assert one.runs == two.runs == 10
    assert one.run_s > 0.0
    assert one.total_s == 10 * one.run_s
    assert two.total_s == 5 * two.run_s
    assert one.engine.engine == "pinocchio"
    many = estimate(plan(axes={GAIN: linspace(0.0, 0.1, 1000)}), workers=1)
    assert many.engine.way == "lanes"
    assert many.run_s < one.run_s


def test_another_version_of_coop_pin_makes_another_key(monkeypatch):
    base = cp.Scenario.load("adept-paper")
    before = run_key(base), unresolved_key(base, {"duration": -1.0})
    monkeypatch.setattr(importlib.import_module("coop_pin.sweeps.run_key"), "__version__", "0.0.0")
    after = run_key(base), unresolved_key(base, {"duration": -1.0})
    assert before[0] != after[0]
    assert before[1] != after[1]
