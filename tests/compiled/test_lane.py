"""Single runs as one lane of a batch: those of Pinocchio in cells, laws, sensors, drives and events."""

from __future__ import annotations

import gc
import random
import subprocess
import sys

import numpy as np
import pytest
from batches import require_same_samples
from cells import SCENARIOS
from sensing_settings import SETTINGS
from test_batch_laws import LAWS, scenario_with
from test_batch_sensing import in_setting
from test_engines import CASES, eventful
from ways import WAYS, run_as_lane, run_on

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.cli import main
from coop_pin.compiled import BatchSimulator, plant_reason
from coop_pin.compiled.engine_choice import choose_engine
from coop_pin.results.run_result import RunResult
from coop_pin.sweeps.store import SweepStore

ONLY_PINOCCHIO = {
    *("adept-hinges", "pick-carry-place", "three-rolling-ur5", "tiago-pro-tray", "two-pandas-door"),
    "two-pandas-hinges",
    "two-pandas-palms",
}
"""Scenarios whose plant has no compiled code."""
RUNS = {
    **{
        f"cell {name}": lambda name=name: cp.Scenario.load(name, {"duration": 0.1, "events": []})
        for name in cp.scenario_names()
        if name not in ONLY_PINOCCHIO
    },
    **{
        f"law {name} {index}": lambda case=case: scenario_with(*case)
        for name, cases in LAWS.items()
        for index, case in enumerate(cases)
    },
    **{
        f"{setting}, {law}, {cell}": lambda case=(cell, setting, law): in_setting(*case)
        for cell in ("planar", "spatial")
        for setting in SETTINGS
        for law in ("printed", "anchored")
    },
    **{f"events {name}": lambda name=name: eventful(name) for name in CASES},
    "gravity turns": lambda: cp.Scenario.load(
        "two-pandas-box",
        {"duration": 0.1, "events": [{"kind": "gravity-turn", "time": 0.043, "gravity": (1.0, 0.0, -9.7)}]},
    ),
}


def test_the_scenarios_without_a_compiled_plant_are_known():
    scenarios = {name: cp.Scenario.load(name) for name in cp.scenario_names()}
    reasons = {name: plant_reason(each.plant, each.cell) for name, each in scenarios.items()}
    assert {name for name, reason in reasons.items() if reason} == ONLY_PINOCCHIO


LARGEST = "everything at once, anchored, spatial"
ALWAYS = ["events planar", LARGEST]
QUICK = {*ALWAYS, *random.Random(31).sample(sorted({*RUNS} - {*ALWAYS, "cell two-pandas-box"}), 2)}


DIVERGING = {"law leader-follower 0"}


def finished(scenario, way):
    """The run, or the time at which it diverges."""
    try:
        return WAYS[way](scenario)
    except errors.DivergedError as error:
        return error.time


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=[pytest.mark.gate] if name == LARGEST else [] if name in QUICK else [pytest.mark.slow]
        )
        for name in RUNS
    ],
)
def test_a_lane_is_the_run_on_pinocchio(name):
    scenario = RUNS[name]()
    lane, single = (finished(scenario, way) for way in ("lanes", "pinocchio"))
    if name in DIVERGING:  # the run on a compiled plant tells its error
        assert lane is None
        assert finished(scenario, "plant") == single
        return
    assert (lane.engine, single.engine) == ("compiled", "pinocchio")
    require_same_samples(lane.data, single.data)
    remarks = [result.data.attrs.get(RunResult.REMARKS) for result in (lane, single)]
    assert remarks[0] == remarks[1]


def test_other_gains_need_no_other_code(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = []
    for gain in (0.05, 0.13, 0.2):
        changes = {"duration": 0.2, "events": [], "controller.gains.sign_gain": gain}
        scenario = cp.Scenario.load("adept-anchored", changes)
        lane, single = run_as_lane(scenario), cp.run(scenario, warn=False)
        require_same_samples(lane.data, single.data)
        kept.append(sorted((tmp_path / "coop_pin" / "compiled").glob("*")))
    assert kept[0] == kept[1] == kept[2]


@pytest.mark.parametrize("every", [1, 7])
def test_an_interrupted_lane_keeps_its_first_chunks(every):
    scenario = cp.Scenario.load("adept-paper", {"duration": 15.0, "clock.record_every": every})
    done = []

    def watch(ticks, _total):
        done.append(ticks)
        if len(done) == 2:
            raise KeyboardInterrupt

    with pytest.raises(errors.RunInterruptedError) as caught:
        run_as_lane(scenario, progress=watch)
    kept, whole = caught.value.result.data, run_as_lane(scenario).data
    assert 0 < done[0] < done[1] < 1200
    ticks = np.round(kept.time.values * scenario.clock.rate_hz).astype(int)
    assert ticks.tolist() == [tick for tick in range(done[1] + 1) if tick % every == 0 or tick == done[1]]
    common = np.flatnonzero(ticks % every == 0)
    for name, values in kept.data_vars.items():
        is_timed = "time" in values.dims
        expected = whole[name].isel(time=ticks[common] // every) if is_timed else whole[name]
        found = values.isel(time=common) if is_timed else values
        np.testing.assert_array_equal(found, expected, err_msg=name)


@pytest.mark.gate
@pytest.mark.parametrize("name", SCENARIOS)
def test_code_for_few_ticks_has_the_bits_of_code_for_many(name):
    scenario = in_setting(name, "everything at once", "anchored")
    brief, lasting = (BatchSimulator(width=1, is_brief=brief).run([scenario]) for brief in (True, False))
    for quantity, values in brief.samples.items():
        np.testing.assert_array_equal(values, lasting.samples[quantity], quantity)


@pytest.fixture
def in_parts(monkeypatch):
    """Makes lanes from its call on in parts of 20 ticks."""
    from coop_pin.compiled import lane

    def begin():
        monkeypatch.setattr(lane, "_LONG", 10)
        monkeypatch.setattr(lane, "_PART", 20)

    return begin


@pytest.mark.parametrize(
    ("case", "every"), [("planar", 1), pytest.param("spatial", 7, marks=pytest.mark.gate)]
)
def test_a_lane_in_parts_is_the_run_on_pinocchio(case, every, in_parts):
    """With squeeze, payload and torque that change in later parts than the first."""
    from coop_pin.compiled import lane

    in_parts()
    scenario = in_setting(case, "everything at once", "anchored")
    period, squeeze = scenario.clock.period, scenario.squeeze_wrenches
    late = {"kind": "payload-change", "time": 31.4 * period, "mass": 2.0}
    scenario = scenario.override({"duration": 50 * period, "clock.record_every": every, "events": [late]})
    arms = list(scenario.cell.arms)
    tables = [dict(zip(arms, (k * squeeze).tolist(), strict=True)) for k in (1.0, 1.5)]
    ramp = {"kind": "ramp", "start": tables[0], "goal": tables[1], "duration": 0.1, "start_time": 25 * period}
    scenario = scenario.override({"squeeze": ramp})
    run, whole = lane.Lane(scenario), finished(scenario, "pinocchio")
    lane._simulators[True]._families.clear()
    gc.collect()  # the machine's memory with it, if nothing else held it
    result = run.run()
    require_same_samples(result.data, whole.data)
    assert (result.every_tick is None) == (every == 1)
    assert list(result.metrics()) == list(whole.metrics())
    assert result.metrics() == pytest.approx(whole.metrics(), rel=1e-9, abs=1e-9, nan_ok=True)
    assert [breach[:3] for breach in result.breaches()] == [breach[:3] for breach in whole.breaches()]
    assert [limit[:3] for limit in result.limit_violations()] == [v[:3] for v in whole.limit_violations()]


HOUR = """
import resource, sys
import coop_pin as cp
changes = {"duration": 3600.0, "clock.record_every": 10}
result = cp.run("two-pandas-box", changes, engine="auto", warn=False)
result.save(sys.argv[1])
print(result.engine, len(result.data.time), result.simulation_sound)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
cp.viz.save_replay(result, sys.argv[2])
"""


@pytest.mark.slow
def test_an_hour_of_two_pandas_takes_less_than_1_gb_and_its_page_less_than_4_mb(tmp_path):
    files = tmp_path / "result.nc", tmp_path / "replay.html"
    words = [sys.executable, "-c", HOUR, *map(str, files)]
    done = subprocess.run(words, check=True, capture_output=True, text=True)
    said, peak_kb = done.stdout.splitlines()
    print(said, f"{int(peak_kb) / 1024:.0f} MB, page {files[1].stat().st_size / 1e6:.2f} MB")
    assert said == "compiled 180001 True"
    assert int(peak_kb) * 1024 < 1e9
    assert files[1].stat().st_size < 4e6


@pytest.mark.gate
def test_a_run_says_what_auto_would_have_saved(monkeypatch, caplog):
    from coop_pin.running import run_scenario

    cp.run("adept-paper", {"duration": 1.0, "events": []})
    assert "auto" not in caplog.text
    monkeypatch.setattr(run_scenario, "_WORTH_A_HINT", 0.0)
    cp.run("adept-paper", {"duration": 1.0, "events": []})
    assert "auto" not in caplog.text  # compiling takes longer
    cp.run("adept-paper", {"duration": 30.0})
    assert "engine 'auto' would have saved" in caplog.text


def test_progress_ends_with_the_last_tick_and_its_errors_carry_the_result():
    scenario, told = cp.Scenario.load("adept-paper", {"duration": 15.0}), []
    run_as_lane(scenario, progress=lambda *ticks: told.append(ticks))
    assert told[-1] == (1200, 1200)
    assert told == sorted(told)

    def fail(_done, _total):
        raise errors.RunTimeoutError(1.0)

    with pytest.raises(errors.RunTimeoutError) as caught:
        run_as_lane(scenario, progress=fail)
    assert caught.value.result.data.attrs[RunResult.ENDED_BY] == "RunTimeoutError"
    assert caught.value.result.data.sizes["time"] == told[0][0] + 1


def test_a_lane_that_diverges_has_the_error_of_a_single_run():
    changes = {"controller.gains.pose_gain": 400.0, "beyond_bound": True, "duration": 2.0, "events": []}
    found = []
    for engine in ("pinocchio", "compiled"):
        with pytest.raises(errors.CoopPinError) as caught:
            cp.run("adept-paper", changes, engine=engine, warn=False)
        found.append((type(caught.value), caught.value.time, caught.value.result.end))
    assert found[0] == found[1]


def test_auto_chooses_by_length_law_and_what_happens_at_ticks():
    long, short = (
        cp.Scenario.load("adept-paper"),
        cp.Scenario.load("adept-paper", {"duration": 2.0, "events": []}),
    )
    based = long.override(
        {"controller": {"kind": "computed-torque", "gains": {"position_gain": 9.0, "velocity_gain": 6.0}}}
    )
    cases = {
        ("lanes", None): (long.replace(duration=2000.0), False),
        ("pinocchio", "few runs"): (short, False),
        ("plant", "live"): (long, True),
        ("plant", "law"): (based, False),
        ("pinocchio", "plant"): (long.override({"plant.payload": "free"}), False),
    }
    for expected, (scenario, is_live) in cases.items():
        assert choose_engine(scenario, is_live=is_live)[:2] == expected
        if expected != ("pinocchio", "plant"):  # by its name, however few ticks
            named = choose_engine(scenario, "compiled", is_live=is_live)
            assert (named.engine, named.way) == ("compiled", expected[0].replace("pinocchio", "lanes"))


def test_auto_takes_compliant_grasps_and_leaves_their_events_to_single_runs():
    assert choose_engine(cp.Scenario.load("adept-compliant"))[0] == "lanes"
    assert choose_engine(cp.Scenario.load("three-ur5-handover"))[:2] == ("plant", "plant")
    assert choose_engine(cp.Scenario.load("human-partner"))[:2] == ("pinocchio", "plant")


def test_auto_runs_what_it_chooses():
    assert cp.run("adept-paper", engine="auto", warn=False).engine == "compiled"
    assert (
        cp.run("adept-paper", {"duration": 1.0, "events": []}, engine="auto", warn=False).engine
        == "pinocchio"
    )


@pytest.mark.parametrize(
    "asked",
    [{"view": lambda _: None}, {"realtime_rate": 1.0}, {"stop_at_breach": True}],
    ids=lambda each: next(iter(each)),
)
def test_the_law_is_interpreted_where_something_happens_at_every_tick(asked, caplog):
    changes = {"duration": 0.2, "events": []}
    with caplog.at_level("INFO", "coop_pin"):
        result = cp.run("adept-paper", changes, engine="compiled", warn=False, **asked)
    plant = run_on("compiled", cp.Scenario.load("adept-paper", changes))
    assert result.data.identical(plant.data)
    assert "interpreted" in caplog.text


def test_a_law_that_cannot_be_compiled_is_interpreted():
    changes = {
        "controller": {"kind": "computed-torque", "gains": {"position_gain": 9.0, "velocity_gain": 6.0}},
        "duration": 0.2,
        "events": [],
    }
    scenario = cp.Scenario.load("adept-paper", changes)
    with pytest.raises(errors.TracingError, match="computed-torque"):
        run_as_lane(scenario)
    result = cp.run(scenario, engine="compiled", warn=False)
    assert result.engine == "compiled"
    assert result.data.identical(run_on("compiled", scenario).data)


class Damper(cp.ArmController):
    """Damps the drives."""

    def __init__(self, scenario, arm, damping=5.0):
        self.damping = damping

    def init(self, measurement, reference):
        return None

    def step(self, measurement, reference, state):
        return cp.ArmCommand(-self.damping * measurement.v + 0.3, state)


class Forgetful(Damper):
    """Counts ticks besides its state, which no random ticks show."""

    seen = 0

    def step(self, measurement, reference, state):
        Forgetful.seen += 1
        strength = 1.0 if Forgetful.seen < 150 else 2.0
        return cp.ArmCommand(-self.damping * strength * measurement.v + 0.3, state)


def users(target):
    return cp.Scenario.load("adept-paper").override(
        {"controller": {"kind": "user", "target": target}, "events": [], "duration": 4.0}
    )


def test_a_users_law_runs_as_a_lane_by_name(caplog):
    with caplog.at_level("INFO", "coop_pin"):
        lane, single = (
            cp.run(users(Damper), engine=engine, warn=False) for engine in ("compiled", "pinocchio")
        )
    assert "interpreted" not in caplog.text
    assert lane.data.identical(run_as_lane(users(Damper)).data)
    require_same_samples(lane.data, single.data)


def test_a_users_law_with_hidden_state_is_no_lane(caplog):
    with pytest.raises(errors.TracingError):
        run_as_lane(users(Forgetful))
    with caplog.at_level("INFO", "coop_pin"):
        result = cp.run(users(Forgetful), engine="compiled", warn=False)
    assert (result.engine, result.end) == ("compiled", 4.0)
    assert "interpreted" in caplog.text


def test_the_command_tells_what_auto_chose(tmp_path, capsys):
    words = ["run", "adept-paper", "--engine", "auto", "--no-figures", "--no-replay", "--out", str(tmp_path)]
    assert main(words) == 0
    assert "engine compiled, whole runs as lanes: " in capsys.readouterr().out
    assert cp.RunResult.load(tmp_path / "result.nc").engine == "compiled"


def test_a_sweep_of_a_law_that_cannot_be_compiled_runs_on_compiled_plants(tmp_path):
    axes = {"controller.gains.position_gain": [9.0, 16.0]}
    law = {"kind": "computed-torque", "gains": {"position_gain": 9.0, "velocity_gain": 6.0}}
    plan = {
        "changes": {"duration": 0.2, "events": [], "controller": law},
        "execution": cp.Execution(workers=0, quiet=True),
    }
    tables = {
        engine: cp.sweep("adept-paper", axes, out=tmp_path / engine, engine=engine, **plan).table
        for engine in ("compiled", "pinocchio")
    }
    columns = ["moving_position_rms_m", "closure_error_max_m"]
    np.testing.assert_allclose(tables["compiled"][columns], tables["pinocchio"][columns], rtol=0, atol=1e-9)
    for engine in tables:
        assert {record.engine for record in SweepStore(tmp_path / engine).records()} == {engine}


def test_of_a_sweep_in_lanes_other_laws_run_on_compiled_plants_and_other_plants_on_pinocchio(tmp_path):
    base = cp.Scenario.load("adept-paper", {"duration": 0.1, "events": []})
    model = {"kind": "computed-torque", "gains": {"position_gain": 9.0, "velocity_gain": 6.0}}
    cases = {"own": {}, "model": {"controller": model}, "free": {"plant.payload": "free"}}
    here = cp.Execution(workers=0, quiet=True, engine="compiled")
    result = cp.sweep(base, cases={"case": cases}, out=tmp_path, execution=here)
    engines = {record.key: record.engine for record in SweepStore(tmp_path).records()}
    assert [engines[key] for key in result.table["key"]] == ["compiled", "compiled", "pinocchio"]
    assert result.counts()["ok"] == 3


@pytest.mark.gate
def test_a_long_run_has_the_bits_of_a_short_one(in_parts):
    """Squeeze and motion that stay fold in the code of a part, whose zeros may have another sign."""
    from coop_pin.compiled.lane import Lane

    changes = {"sensors.encoder.noise": 1e-5, "duration": 0.16}
    scenario = cp.Scenario.load("two-ur5-admittance", changes)
    whole = Lane(scenario).run().data
    in_parts()
    parts = Lane(scenario).run().data
    for name in whole.data_vars:
        if whole[name].dtype == float:
            bits = [np.ascontiguousarray(data[name].values).view(np.uint64) for data in (whole, parts)]
            np.testing.assert_array_equal(*bits, name)
