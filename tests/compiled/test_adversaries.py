"""Batches of adversarial controllers: each that differs from single runs is told or refused."""

import logging
import random

import adversaries
import numpy as np
import pytest
import stateful_laws
from cells import SCENARIOS
from ways import run_as_lane

import coop_pin as cp
from coop_pin.base.errors import TracingError
from coop_pin.compiled import simulate_batch
from coop_pin.compiled.laws.support import checked, difference, support
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.store import SweepStore

HERE = cp.Execution(workers=0, quiet=True)
GAINS = (0.2, 0.5, 0.9)
SILENT_PART = 0.01
"""Largest part of random laws that may differ in silence."""


@pytest.fixture(autouse=True)
def _forget():
    adversaries.reset()
    yield
    adversaries.reset()


def scenario_of(target, cell="planar", **options):
    controller = {"kind": "user", "target": f"adversaries:{target}", "options": options}
    changes = {"duration": 0.6, "events": (), "beyond_bound": True, "controller": controller}
    return SCENARIOS[cell]().override(changes)


def alone(scenario):
    """The torques of a single run, None if it fails."""
    adversaries.reset()
    try:
        return cp.run(scenario, warn=False).data["torque"].values
    except cp.CoopPinError:
        return None


def is_silent(target, cell="planar", gains=GAINS, **options):
    """Whether a batch of runs is returned of which one differs from its single run, both in a new process."""
    adversaries.reset()
    scenarios = [scenario_of(target, cell, gain=gain, **options) for gain in gains]
    try:
        batch = simulate_batch(scenarios)
    except TracingError:
        return False
    valid = np.flatnonzero(batch.is_valid)
    torques = {index: batch.samples["torque"][index] for index in valid}
    singles = {index: alone(scenarios[index]) for index in valid}
    return any(
        singles[index] is None
        or np.abs(torques[index] - singles[index]).max() > 1e-9 * np.abs(singles[index]).max()
        for index in valid
    )


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    "target",
    [
        pytest.param(
            name, marks=[] if name in random.Random(3).sample([*adversaries.ADVERSARIES], 4) else slow
        )
        for slow in [pytest.mark.slow]
        for name in adversaries.ADVERSARIES
    ],
)
def test_an_adversary_is_told_or_refused(target):
    assert len(adversaries.ADVERSARIES) >= 80
    assert adversaries.UNCHECKED in {*GAINS} - {*checked(GAINS)}
    assert not is_silent(target)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["CountByGlobals", "GainInEnvironment", "NanIsNotLess", "Underflow"])
def test_an_adversary_on_a_spatial_cell_is_told_or_refused(target):
    assert not is_silent(target, "spatial", GAINS[:2])


@pytest.mark.slow
def test_two_hundred_random_laws_do_not_differ_in_silence():
    silent = [seed for seed in range(200) if is_silent("RandomLaw", seed=seed)]
    assert len(silent) <= SILENT_PART * 200, silent


def test_a_random_law_does_not_differ_in_silence():
    assert not is_silent("RandomLaw", gains=GAINS[:1], seed=2026)


@pytest.mark.parametrize(
    ("target", "name"),
    [
        ("CountInObject", "'n' \\(left\\)"),
        ("CountInClass", "'n' of class CountInClass"),
        ("CountInModule", "'steps' of module adversaries"),
        ("CountInDefault", "'changed' of class CountInDefault"),
        ("CountInClosure", "'count' of class CountInClosure"),
        ("CountInFunction", "'counted' of module adversaries"),
        ("CountInNamespace", "'counter' of module adversaries"),
    ],
)
@pytest.mark.parametrize("cell", SCENARIOS)
def test_attributes_that_change_over_a_step_are_refused_by_name(target, name, cell):
    with pytest.raises(TracingError, match=name):
        simulate_batch([scenario_of(target, cell)])


def test_a_single_run_of_an_adversary_by_name_ends_with_its_law_interpreted(caplog):
    scenario = scenario_of("CountByGlobals", gain=GAINS[0])
    with pytest.raises(TracingError, match="globals"):
        run_as_lane(scenario)
    adversaries.reset()
    with caplog.at_level(logging.INFO, "coop_pin"):
        result = cp.run(scenario, engine="compiled", warn=False)
    assert (result.engine, result.end) == ("compiled", pytest.approx(scenario.duration))
    assert "interpreted" in caplog.text


# ---------------------------------------------------------------- sweeps


def plan(target, gains=GAINS, **fields):
    base = scenario_of(target, gain=0.0)
    return SweepPlan(base=base, axes={"controller.options.gain": list(gains)}, engine="compiled", **fields)


def records(folder):
    last = {record.key: record for record in SweepStore(folder).records()}
    return [record for record in last.values() if record.metrics]


@pytest.mark.parametrize(
    "target", ["GainInEnvironment", pytest.param("CountByGlobals", marks=pytest.mark.slow)]
)
def test_a_sweep_repeats_a_family_that_differs_singly_and_tells_why(target, tmp_path, caplog):
    with caplog.at_level(logging.WARNING, "coop_pin.sweeps"):
        batch = cp.sweep(plan(target), out=tmp_path / "batch", execution=HERE).table
    assert "differs from a single run" in caplog.text
    assert [record.engine for record in records(tmp_path / "batch")] == ["pinocchio"] * 3
    if target == "GainInEnvironment":  # a counter goes on counting, whatever runs it
        single = cp.sweep(
            plan(target).replace(engine="pinocchio"), out=tmp_path / "single", execution=HERE
        ).table
        metrics = [name for name in single.columns if single[name].dtype == float and not name.endswith("_s")]
        assert np.allclose(batch[metrics], single[metrics], rtol=1e-9, equal_nan=True)


def test_a_family_is_checked_once_in_a_folder(tmp_path, monkeypatch):
    looked = []
    place = "coop_pin.compiled.laws.support.difference"
    monkeypatch.setattr(place, lambda *pair: looked.append(pair) or difference(*pair))
    cp.sweep(plan("Spring"), out=tmp_path, execution=HERE)
    assert len(looked) == 2
    assert [record.engine for record in records(tmp_path)] == ["compiled"] * 3
    assert len({record.family for record in records(tmp_path)}) == 1
    cp.sweep(plan("Spring", (*GAINS, 1.0)), out=tmp_path, execution=HERE)
    assert len(looked) == 2


def test_runs_that_are_checked_are_the_first_and_another_one():
    assert checked([7]) == [7]
    assert [checked(range(n))[0] for n in (2, 3, 50)] == [0, 0, 0]
    assert all(0 < checked(range(n))[1] < n for n in range(2, 99))
    assert len({checked(range(n))[1] for n in range(50, 99)}) > 10


def test_the_other_run_that_is_checked_has_other_options_than_the_first():
    for masses in range(3, 26):
        grid = [(gain, mass) for gain in (0.0, 200.0, 400.0) for mass in range(masses)]
        first, other = checked(grid, lambda run: run[0])
        assert first == (0.0, 0)
        assert other[0] > 0.0
    assert len(checked([1, 2, 3], lambda _: 0)) == 2


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("Counter", "'n'"),
        ("Integral", "'integral'"),
        ("InBytes", "'buffer'"),
        ("Drawn", "'generator'"),
        ("Counted", "numbers"),
        ("InFile", "open"),
        ("InEnvironment", "os"),
        ("InCache", "cached"),
        ("NumpyRandom", "numpy.random"),
    ],
)
@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_compiled_run_of_a_law_that_remembers_is_refused_by_name(name, word, cell):
    """An integral is noticed, too, whose gain is 0."""
    controller, stateful_laws.buffer[0] = {"kind": "user", "target": f"stateful_laws:{name}"}, 0
    with pytest.raises(TracingError, match=word):
        run_as_lane(scenario_of("Spring", cell).replace(duration=9.0).override({"controller": controller}))


def test_a_grid_that_begins_with_a_gain_of_zero_has_the_metrics_of_single_runs(tmp_path):
    law = {"kind": "user", "target": "stateful_laws:Integral", "options": {"ki": 0.0}}
    base = scenario_of("Spring").override({"controller": law})
    axes = {"controller.options.ki": [0.0, 200.0, 400.0], "cell.payload.mass": [2.0, 2.5]}
    tables = {
        engine: cp.sweep(base, axes, out=tmp_path / engine, engine=engine, execution=HERE).table
        for engine in ("compiled", "pinocchio")
    }
    columns = ["moving_position_rms_m", "torque_peak_Nm"]
    assert tables["pinocchio"]["torque_peak_Nm"].round(6).nunique() == 5
    np.testing.assert_allclose(tables["compiled"][columns], tables["pinocchio"][columns], 1e-9, 1e-9)


def test_a_sweep_warns_once_of_what_its_runs_leave_to_the_next(tmp_path, caplog):
    base = scenario_of("Spring").override(
        {"controller": {"kind": "user", "target": "stateful_laws:ClassList"}}
    )
    plan = {"axes": {"cell.payload.mass": [2.0, 2.5]}, "engine": "pinocchio", "out": tmp_path}
    cp.sweep(base, **plan, execution=HERE)
    told = [record for record in caplog.messages if "'past' of class ClassList" in record]
    assert len(told) == 1


@pytest.mark.parametrize("cell", SCENARIOS)
def test_functions_of_pose_errors_and_turned_wrenches_are_traced(cell):
    law = {"kind": "user", "target": "stateful_laws:BoundedPush"}
    assert support(scenario_of("Spring", cell).override({"controller": law})) is None


def test_quantities_that_differ_are_named():
    assert difference({"a": 1.0, "b": np.nan}, {"a": 1.0 + 1e-10, "b": np.nan}) == ""
    assert difference({"a": np.array([1.0, 2.0])}, {"a": np.array([1.0, 2.1])}) == "a differs by 0.1"
    assert difference({"a": np.nan}, {"a": 1.0}).startswith("a ")
