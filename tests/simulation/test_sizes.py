"""Sizes: a run is measured against the free memory before it starts, and long runs keep every n-th tick."""

import itertools
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
from cells import SCENARIOS
from linkages import bennett

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.base.memory import free_memory
from coop_pin.chain.trajectory import time_grid
from coop_pin.description.events import PayloadChange
from coop_pin.description.plant import Clock
from coop_pin.description.scenario import Scenario
from coop_pin.results.run_result import RunResult
from coop_pin.running.cell_findings import record_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulate import simulate
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.timeline import Timeline


def finished(scenario):
    return simulate(scenario, build_controller(scenario))


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("changes", [{"duration": 1e8}, {"clock.rate_hz": 1e6, "duration": 1e5}])
def test_a_run_larger_than_the_memory_is_refused_before_anything_is_allocated(cell, changes):
    scenario = SCENARIOS[cell]().override({"events": (), **changes})
    started = time.monotonic()
    with pytest.raises(errors.NotEnoughMemoryError) as caught:
        Simulation(scenario, build_controller(scenario))
    assert time.monotonic() - started < 5.0
    assert caught.value.needed > caught.value.free > 0
    assert isinstance(caught.value, ValueError)
    assert all(word in str(caught.value) for word in ("record_every", "duration", "rate_hz"))


@pytest.mark.parametrize("field", ["duration", "clock.rate_hz", "clock.steps_per_tick"])
def test_sizes_of_a_billion_are_refused_by_field(field):
    with pytest.raises(errors.FieldError) as caught:
        SCENARIOS["planar"]().override({field: 10**9})
    assert caught.value.path == field


def test_the_memory_that_is_asked_for_is_what_a_run_takes():
    scenario = SCENARIOS["spatial"]().override({"duration": 8.0})
    run = Simulation(scenario, build_controller(scenario))
    run.tick()
    run.result().data.to_netcdf(engine="h5netcdf")  # what is loaded for the first file is no sample
    huge = scenario.override({"duration": 1e8})
    with pytest.raises(errors.NotEnoughMemoryError) as caught:
        Simulation(huge, build_controller(huge))
    asked = caught.value.needed / (1e8 * 250.0 + 1) * 2001
    record = run.recorder.state()
    samples = [np.repeat(of_one, 2001, axis=0) for of_one in record.samples]
    run.recorder.restore(record._replace(size=2001, samples=samples), scenario)
    kept = sum(of_all.nbytes for of_all in samples)
    del samples
    tracemalloc.start()
    result = run.result()
    content = result.data.to_netcdf(engine="h5netcdf")
    held = kept + tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert len(content) > 0
    assert 0.7 < held / asked < 1.3


def test_a_motion_of_a_billion_steps_is_refused():
    chain, start = bennett("full")
    with pytest.raises(errors.NotEnoughMemoryError):
        chain.integrate(*start, duration=1e9, step=1e-9)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_counts_beyond_the_memory_are_refused(cell):
    scenario = SCENARIOS[cell]().replace(events=())
    shift = cp.Pose(xyz=(0.0, 0.02, 0.0))
    goal = cp.Pose.from_matrix(scenario.start.matrix @ shift.matrix)
    for count in (10**12, 10**40):
        for function in (
            lambda: cp.carry.plan_carry(scenario.cell, scenario.start, goal, places=count),  # noqa: B023
            lambda: cp.suggest(scenario, poses=count),  # noqa: B023
            lambda: cp.feasibility.reachability(scenario, poses=count),  # noqa: B023
            lambda: cp.gym.VectorCellEnv(scenario, num_envs=count),  # noqa: B023
            lambda: cp.sweeps.linspace(0.0, 1.0, count),  # noqa: B023
        ):
            with pytest.raises(errors.NotEnoughMemoryError) as caught:
                function()
            assert caught.value.needed > caught.value.free


def test_a_time_grid_needs_its_times_and_what_goes_with_them(leave_free):
    """Five times of eight bytes, each with 92 more."""
    assert time_grid(1.0, 0.25, 92).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert 0.07 / 0.01 > 7.0  # by rounding
    np.testing.assert_allclose(time_grid(0.07, 0.01, 92), np.linspace(0.0, 0.07, 8), rtol=1e-14)
    leave_free(0)
    with pytest.raises(errors.NotEnoughMemoryError) as caught:
        time_grid(1.0, 0.25, 92)
    assert caught.value.needed == pytest.approx(500.0, rel=1e-8)


def test_free_memory_is_between_nothing_and_everything():
    assert 1 << 20 < free_memory() < 1 << 60


def test_free_memory_is_within_the_limit_of_the_address_space():
    script = """
import resource
from pathlib import Path
from coop_pin.base.memory import free_memory
from coop_pin.chain.trajectory import time_grid
limit = 1 << 30
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
print(free_memory(), limit - used)
"""
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    free, left = map(int, done.stdout.split())
    assert 0 < free <= left


@pytest.mark.parametrize(
    ("listed", "folder", "names"),
    [
        ("0::/batch/job", "", ("memory.max", "memory.current", "inactive_file")),
        (
            "9:cpu:/batch/job\n4:memory:/batch/job",
            "memory",
            ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
        ),
    ],
    ids=["version 2", "version 1"],
)
def test_free_memory_is_within_the_limits_of_every_control_group(listed, folder, names, control_groups):
    limit, used, cache = names
    job = control_groups(listed) / folder / "batch" / "job"
    job.mkdir(parents=True)
    for group, text in ((job, "max" if not folder else str(2**63 - 4096)), (job.parent, "9000000")):
        (group / limit).write_text(text + "\n")
        (group / used).write_text("3000000\n")
        (group / "memory.stat").write_text(f"anon 1\n{cache} 2000000\n")
    assert free_memory() == 9_000_000 - 3_000_000 + 2_000_000
    (job / limit).write_text("4000000\n")
    assert free_memory() == 3_000_000
    (job / used).write_text("8000000\n")
    assert free_memory() == 0


def test_steps_of_a_tick_are_made_one_at_a_time():
    clock = Clock(rate_hz=1e-3, steps_per_tick=10_000)
    tracemalloc.start()
    first = list(itertools.islice(Timeline(clock, 1e3, ()).steps(0), 3))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose([step.start for step in first], [0.0, 0.1, 0.2])
    assert peak < 20_000


# ---------------------------------------------------------------- every n-th tick


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("every", [7, 10**9])
def test_a_thinned_run_holds_samples_of_the_whole_one_and_its_last(cell, every):
    scenario = SCENARIOS[cell]().override({"events": (), "duration": 0.5})
    whole, thinned = finished(scenario), finished(scenario.override({"clock.record_every": every}))
    ticks = len(whole.data["time"]) - 1
    kept = [*range(0, ticks, every), ticks]
    assert len(thinned.data["time"]) == len(kept)
    for name, values in thinned.data.items():
        of_whole = whole.data[name].values
        np.testing.assert_array_equal(
            values.values, of_whole[kept] if "time" in values.dims else of_whole, err_msg=name
        )


@pytest.mark.parametrize(("name", "hours"), [("adept-paper", 10.0), ("two-pandas-box", 1.0)])
def test_a_record_that_is_large_is_told_with_what_makes_it_small(name, hours):
    scenario = Scenario.load(name, {"duration": 3600.0 * hours})
    (finding,) = _large(scenario)
    assert finding.remedy["clock.record_every"] > 1
    assert finding.value > finding.limit
    assert not _large(scenario.override(finding.remedy))


def _large(scenario):
    findings = record_findings(Simulation(scenario, build_controller(scenario)))
    return [finding for finding in findings if (finding.severity, finding.kind) == ("warning", "record size")]


def test_a_record_that_does_not_fit_names_what_fits(leave_free):
    leave_free(1 << 26)
    scenario = Scenario.load("two-pandas-box", {"duration": 600.0, "events": ()})
    with pytest.raises(errors.NotEnoughMemoryError) as caught:
        Simulation(scenario)
    every = int(str(caught.value).split("clock.record_every to ")[1].split()[0])
    Simulation(scenario.override({"clock.record_every": every}))


def limited(cell, duration):
    """A run with a late heavier payload, weak drives and a low limit of the condition number."""
    late = {"kind": "payload-change", "time": 0.75 * duration, "mass": 8.0}
    scenario = SCENARIOS[cell]().override({"duration": duration, "events": [late], "beyond_bound": True})
    peak = finished(scenario.override({"duration": 0.1, "events": ()})).data
    condition = float(peak["jacobian_condition"].max())
    torques = peak["torque"].isel(arm=0, time=0).values.tolist()
    limits = [0.9 * max(map(abs, torques)) for _ in torques]
    name = next(iter(scenario.cell.arms))
    changes = {f"cell.arms.{name}.torque_limits": limits, "trust.jacobian_condition": condition}
    return scenario.override(changes | {"trust.energy_floor": 1e-12, "trust.energy_share": 1e-15})


@pytest.mark.parametrize(("cell", "duration", "every"), [("planar", 10.0, 4), ("spatial", 1.0, 10**6)])
def test_metrics_verdict_and_limits_of_a_thinned_run_are_those_of_all_ticks(
    cell, duration, every, observe_together, tmp_path
):
    observe_together(23)
    scenario = limited(cell, duration)
    whole, thinned = finished(scenario), finished(scenario.override({"clock.record_every": every}))
    thinned.save(tmp_path / "result.nc")
    assert whole.breaches() or whole.task.deviations
    assert whole.limit_violations()
    for result in (thinned, RunResult.load(tmp_path / "result.nc")):
        assert list(result.metrics()) == list(whole.metrics())
        assert result.metrics() == pytest.approx(whole.metrics(), rel=1e-13, nan_ok=True)
        verdicts = ((run.simulation_sound, run.task.state) for run in (result, whole))
        assert len({*verdicts}) == 1
        everything = ((*run.breaches(), *run.task.deviations) for run in (result, whole))
        for found, expected in zip(*everything, strict=True):
            assert found[:3] == expected[:3]
            assert found[3:] == pytest.approx(expected[3:], rel=1e-12)
        assert result.limit_violations() == whole.limit_violations()
        assert result.end == whole.end
    assert len(thinned.data["time"]) < len(whole.data["time"]) / 3


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_thinned_run_that_is_stepped_restored_and_disturbed_has_the_metrics_of_the_whole_one(
    cell, observe_together
):
    """Restored into the middle of a block, with an event added after the last one."""
    observe_together(7)
    results = []
    for every in (1, 5):
        scenario = SCENARIOS[cell]().override(
            {"duration": 40 / 80.0, "events": (), "clock.record_every": every}
        )
        run = Simulation(scenario, build_controller(scenario))
        while run.ticks_done < 17:
            run.tick()
        state, early = run.state(), run.result()
        for _ in range(9):
            run.tick()
        run.restore(state)
        run.add_event(PayloadChange(time=run.time + 3.5 / 80.0, mass=3.0))
        while not run.is_finished:
            run.tick()
        results.append((early, run.result()))
    for whole, thinned in zip(*results, strict=True):
        assert thinned.metrics() == pytest.approx(whole.metrics(), rel=1e-13, nan_ok=True)
        assert thinned.breaches() == whole.breaches()
        ticks = np.round(whole.data["time"].values / scenario.clock.period)
        kept = np.flatnonzero((ticks % 5 == 0) | (ticks == ticks[-1]))
        np.testing.assert_array_equal(thinned.data["torque"], whole.data["torque"].values[kept])


def test_an_interrupted_thinned_run_has_its_last_tick_and_snapshots_are_of_every_tick():
    scenario = SCENARIOS["planar"]().override({"events": (), "clock.record_every": 100})
    run = Simulation(scenario, build_controller(scenario))
    for tick in range(6):
        run.tick()
        assert run.snapshot().time == pytest.approx(tick / 80.0)
    np.testing.assert_allclose(run.result().data["time"], [0.0, 5 / 80.0])


def test_full_turns_between_kept_samples_are_counted():
    scenario = Scenario.load("kinova-pair", {"duration": 1.0, "events": ()})
    run = Simulation(scenario.override({"clock.record_every": 10**6}), build_controller(scenario))
    run.tick()
    place = run.slots[0]
    joint = int(np.flatnonzero(place.angles.continuous)[0])
    inputs, applied = run.observe(), run.state().applied
    first, entry = run.recorder.state().angles[0][joint], place.angles.entry[joint] + place.q_slice.start
    for tick in range(1, 9):
        angle = first + 2.0 * tick
        run.plant.q[entry : entry + 2] = np.cos(angle), np.sin(angle)
        measurements = run.sensing.measure(run.time, run.plant, applied, inputs.signals.sensors)
        now = inputs._replace(measurements=measurements)
        run.recorder.record(tick / 80.0, now, applied, scenario.cell.shares)
    assert run.result().data["joint_position"].values[-1, 0, joint] == pytest.approx(first + 16.0)
