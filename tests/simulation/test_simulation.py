"""Simulation: the paper's experiment, reproducibility, exact events, energy, force paths, friction."""

import time
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from cells import SCENARIOS
from close import assert_close
from numpy.testing import assert_allclose
from ways import run_on

import coop_pin as cp
from coop_pin.base.errors import OpenClosureError, OutOfRangeError, UserCodeError
from coop_pin.base.spatial import internal_wrenches
from coop_pin.control import CellCommand, CellController
from coop_pin.description.events import PayloadChange, WrenchPulse
from coop_pin.description.plant import Clock
from coop_pin.grasps import CellChain
from coop_pin.model.transmission import Transmission
from coop_pin.results.energies import energy_balance
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.recorder import Recorder
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.timeline import Timeline


@pytest.fixture(scope="module")
def paper():
    return cp.run("adept-paper", warn=False)


def test_paper_experiment_is_a_good_run(paper):
    m = paper.metrics()
    assert m["settling_time_s"] < 2.5
    assert m["resettling_time_s"] < 2.5
    assert m["event_peak_position_error_m"] > 0.020
    assert m["moving_position_rms_m"] < 0.5e-3
    assert 20.0 < m["torque_peak_Nm"] < 140.0
    assert m["closure_error_max_m"] < 1e-8
    assert m["closure_error_max_rad"] < 1e-8
    assert m["energy_balance_max_J"] < 1e-6
    assert (paper.simulation_sound, paper.task.state) == (True, "kept"), paper.verdict()


def test_the_papers_internal_force_settles_at_its_squeeze_again_after_the_event(paper):
    """-10.08 N before it and -9.99 N from 14.2 s on, as the paper saw it: each number states its window."""
    before, after = (paper.internal_force(window=window) for window in ((4, 10), (14.2, 20)))
    assert before.axial_mean == pytest.approx(-10.08, abs=0.005)
    assert after.axial_mean == pytest.approx(-9.990, abs=0.005)
    assert (before.force_rms_error, after.force_rms_error) == pytest.approx((0.080, 0.032), abs=0.001)
    assert paper.windows_of("after_event_internal_axial_mean_N") == (pytest.approx((12.2, 20.0)),)
    assert paper.metrics()["after_event_internal_axial_mean_N"] == pytest.approx(-10.005, abs=0.002)


def test_a_hundred_times_the_sign_gain_leaves_another_internal_force_after_the_event():
    """-10.2 N before it, -7.7 N from 12 s on, and a task that is not kept."""
    run = cp.run("adept-paper", {"controller.gains.sign_gain": 0.2}, warn=False)
    assert run.internal_force(window=(4, 10)).axial_mean == pytest.approx(-10.15, abs=0.01)
    assert run.internal_force(window=(12, 20)).axial_mean == pytest.approx(-7.68, abs=0.1)
    assert (run.simulation_sound, run.task.state) == (True, "off"), run.verdict()


@pytest.mark.slow
def test_one_simulated_hour():
    """Closures stay closed at every tick, the energy audit drifts by a steady rate, and memory is flat.

    What a tick costs is printed (pytest -s) and never required: it is the machine's.
    """
    marks = []

    def watch(done, _ticks):
        if done and done % 8000 == 0:
            marks.append((time.process_time(), psutil.Process().memory_info().rss / 1e6))

    scenario = cp.Scenario.load("adept-paper", {"duration": 3600.0, "clock.record_every": 100})
    strict = scenario.override({"trust.closure_error": 1e-9})
    result = cp.run(strict, progress=watch, stop_at_breach=True, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert result.end == 3600.0
    late = result.data.time.values > 20.0
    closure = float(result.data.closure_distance.values[late].max())
    assert closure < 1e-13
    drift = energy_balance(result.data)
    assert np.abs(drift).max() < 1e-7
    first, second = np.ptp(drift[: len(drift) // 2]), np.ptp(drift[-len(drift) // 2 :])
    assert second < 1.2 * first
    clock, memory = np.array(marks).T
    assert len(memory) == 36
    assert memory[-1] - memory[0] < 10.0
    cost = np.diff(clock) / 8000 * 1e3
    growth = np.polyfit(result.data.time.values[late], drift[late], 1)[0]
    print(
        f"\nclosure error from 20 s on {closure:.1e} m, over the hour {result.closure_error_max()[0]:.1e} m"
        f"\nenergy minus work {drift[-1]:.1e} J at the end, growing by {growth:.1e} J/s"
        f"\na tick {np.median(cost[:9]):.2f} ms in the first 900 s, {np.median(cost[-9:]):.2f} ms in the last"
        f"\nmemory {memory[0]:.0f} MB after 100 s, {memory[-1]:.0f} MB after the hour"
        f"\nposition rms {result.position_rms(window=(20, 3600)) * 1e6:.0f} um, mean internal force"
        f" {result.internal_force(window=(20, 3600)).axial_mean:.1f} N"
    )


@pytest.mark.parametrize("cell", SCENARIOS)
def test_two_runs_give_the_same_bits(cell):
    scenario = SCENARIOS[cell]().replace(duration=0.5, events=())
    first, second = cp.run(scenario, warn=False).data, cp.run(scenario, warn=False).data
    for name in first:
        np.testing.assert_array_equal(first[name].values, second[name].values, err_msg=name)


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_samples_observed_at_every_tick_are_those_observed_together(
    cell, engine, observe_together, monkeypatch
):
    """With a mass drop, a push, and of three ticks the last kept."""
    scenario, together, at_once = SCENARIOS[cell](), [], Recorder.observe
    push = WrenchPulse(time=0.1031, duration=0.05, wrench=(40, -20, 0, 0, 0, 1))
    events = (push, PayloadChange(time=0.2017, mass=scenario.cell.payload.mass / 2))
    scenario = scenario.replace(events=events, duration=0.4, clock=scenario.clock.replace(record_every=3))

    def counted(recorder):
        state = recorder.state()
        together.append(state.size - state.observed)
        at_once(recorder)

    every = run_on(engine, scenario, view=lambda _: None, realtime_rate=np.inf).data
    monkeypatch.setattr(Recorder, "observe", counted)
    observe_together(5)
    blocks = run_on(engine, scenario).data
    assert max(together) == 5
    assert min(count for count in together if count) < 5  # before the mass drop
    for name in every:
        np.testing.assert_array_equal(blocks[name].values, every[name].values, err_msg=name)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_last_tick_whose_wrenches_overflow_is_refused_and_the_rest_is_kept(cell):
    """By a push that doubles cannot hold."""
    scenario = SCENARIOS[cell]().replace(duration=0.1, events=())
    end = scenario.clock.ticks(0.1) * scenario.clock.period
    run = Simulation(scenario, build_controller(scenario))
    while run.time < end - 1e-9:
        run.tick()
    run.recorder.observe()
    run.plant.surround(run.plant.surroundings._replace(push=np.full(6, 1.7e308)))
    with pytest.raises(OutOfRangeError):
        run.tick()
    assert run.result().end == pytest.approx(end - scenario.clock.period)


@pytest.mark.parametrize("integrator", ["rk4", "semi-implicit-euler"])
@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_energy_equals_power_in(cell, payload, integrator):
    """Through a push, a mass drop and friction; semi-implicit Euler has a first-order tolerance."""
    scenario = SCENARIOS[cell]()
    push = WrenchPulse(time=0.1031, duration=0.05, wrench=(40, -20, 0, 0, 0, 1))
    events = (push, PayloadChange(time=0.2017, mass=scenario.cell.payload.mass / 2))
    result = cp.run(
        scenario.replace(events=events, duration=0.5),
        {"plant.payload": payload, "plant.integrator": integrator},
        warn=False,
    )
    assert result.energy_balance_max() < (1e-6 if integrator == "rk4" else 0.1)
    assert abs(float(result.data.work_external[-1])) > 1e-3
    assert float(result.data.work_friction[-1]) < 0.0
    assert float(result.data.work_payload_change[-1]) != 0.0


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_welded_and_free_payload_run_the_same(cell, formulation):
    scenario = SCENARIOS[cell]().replace(duration=0.3, events=())
    scenario = scenario.override({"controller.gains.sign_gain": 0.0, "clock.steps_per_tick": 8})
    welded = cp.run(scenario, warn=False)
    free = cp.run(scenario, {"plant.payload": "free", "plant.formulation": formulation}, warn=False)
    assert_close(free.data.payload_position, welded.data.payload_position, atol=1e-9)
    difference = (free.data.internal_wrench - welded.data.internal_wrench).values
    assert_close(np.nan_to_num(difference), 0.0, atol=1e-5)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_projection_at_every_step_keeps_the_closures_at_rounding(cell):
    result = cp.run(SCENARIOS[cell]().replace(duration=0.2, events=()), {"plant.project": "step"}, warn=False)
    assert max(result.closure_error_max()) < 5e-12


def test_timeline_cuts_steps_at_events():
    clock = Clock(rate_hz=100.0, steps_per_tick=4)
    events = (
        PayloadChange(time=0.0231, mass=1.0),
        WrenchPulse(time=0.02, duration=0.00525, wrench=(1, 0, 0, 0, 0, 0)),
    )
    timeline = Timeline(clock, 0.1, events)
    starts = [step.start for step in timeline.steps(2)]
    assert_close(starts, [0.02, 0.0225, 0.0231, 0.025, 0.02525, 0.0275], atol=1e-15)
    for tick in range(timeline.ticks):
        assert sum(step.length for step in timeline.steps(tick)) == pytest.approx(0.01, abs=1e-15)
    assert all(map(timeline.happens_at, (0.02, 0.0231, 0.02525)))
    assert not any(map(timeline.happens_at, (0.0, 0.0225, 0.025, 0.03)))
    assert timeline.event_times() == [0.02, 0.0231, 0.02525]


def test_stages_of_a_tick_have_their_order_and_only_plant_steps_a_length():
    """Of 10 ms in two plant steps with a change at 7 ms; drives lag, and a servo samples at half of it."""
    drives = SimpleNamespace(response="lag", samples=lambda: [(1,)], due=lambda share: (1,) * (share == 0.5))
    clock, event = Clock(rate_hz=100.0, steps_per_tick=2), PayloadChange(time=0.007, mass=1.0)
    timeline = Timeline(clock, 0.01, (event,), drives=drives)
    stages = [(kind, round(time, 9), round(length, 9), due) for kind, time, length, due in timeline.stages(0)]
    assert stages == [
        ("measure", 0.0, 0.0, ()),
        ("command", 0.0, 0.0, ()),
        ("record", 0.0, 0.0, ()),
        ("drive", 0.0, 0.005, ()),
        ("advance", 0.0, 0.005, ()),
        ("sample", 0.005, 0.0, (1,)),
        ("drive", 0.005, 0.002, ()),
        ("advance", 0.005, 0.002, ()),
        ("happen", 0.007, 0.0, ()),
        ("drive", 0.007, 0.003, ()),
        ("advance", 0.007, 0.003, ()),
        ("release", 0.01, 0.0, ()),
    ]
    assert [kind for kind, *_ in timeline.stages(1)] == ["measure", "command", "record"]
    at_tick = Timeline(clock, 0.01, (event.replace(time=0.01),))
    assert [kind for kind, *_ in at_tick.stages(0)] == ["measure", "command", "record", "advance", "advance"]
    assert [*at_tick.before_command(1)] == [("measure", 0.01, 0.0, ()), ("happen", 0.01, 0.0, ())]


@pytest.mark.parametrize("beside", [0.0, 4e-12, -4e-12])
def test_an_event_within_a_part_in_1e9_of_a_plant_step_is_at_its_end(beside):
    """Plant steps of 5 ms; just_after says up to where."""
    timeline = Timeline(
        Clock(rate_hz=100.0, steps_per_tick=2), 0.02, (PayloadChange(time=0.005 + beside, mass=1.0),)
    )
    assert [step.start for step in timeline.steps(0)] == [0.0, 0.005]
    assert timeline.happens_at(0.005)
    assert timeline.just_after(0.005) - 0.005 == pytest.approx(5e-12, rel=1e-3)
    near = Timeline(
        Clock(rate_hz=100.0, steps_per_tick=2), 0.02, (PayloadChange(time=0.005 + 1e-11, mass=1.0),)
    )
    assert len([*near.steps(0)]) == 3
    assert not near.happens_at(0.005)


def test_push_between_ticks_has_its_exact_impulse():
    """The work of a push depends on its exact times; a smaller plant step changes it by RK4's error only."""
    push = {
        "events": [
            {"kind": "wrench-pulse", "time": 0.1031, "duration": 0.0507, "wrench": [200, 100, 0, 0, 0, 2]}
        ]
    }
    works = [
        float(
            cp.run(
                "adept-paper", push | {"duration": 0.2, "clock.steps_per_tick": steps}, warn=False
            ).data.work_external[-1]
        )
        for steps in (3, 24)
    ]
    assert works[0] == pytest.approx(works[1], rel=1e-6)


class Spy(CellController):
    """Hands everything on and keeps what it saw."""

    def __init__(self, inner):
        self.inner, self.seen = inner, []

    def init(self, measurements, references):
        return self.inner.init(measurements, references)

    def step(self, measurements, references, state):
        self.seen.append(measurements)
        return self.inner.step(measurements, references, state)


@pytest.mark.parametrize("cell", SCENARIOS)
@pytest.mark.parametrize("pole", [0.0, 0.6])
def test_force_path_delivers_the_wrench_of_one_tick_before(cell, pole):
    """f_m[k] = p f_m[k-1] + (1 - p) f(t_k^-), f_m[0] = f_d; f(t_k^-) from state and last torque."""
    scenario = SCENARIOS[cell]().replace(duration=0.1, events=())
    scenario = scenario.override(
        {"controller.force_path": {"kind": "low-pass", "pole": pole}, "controller.gains.force_gain": 0.5}
    )
    spy = Spy(build_controller(scenario))
    data = cp.simulate(scenario, spy).data
    chain = CellChain(scenario.cell, scenario.plant)
    drives = Transmission(scenario.cell, chain.model.arms, chain.mechanism.model.nv)
    rows = scenario.cell.task_rows
    expected = rows.select(data.desired_internal_wrench.values[0, 0])
    assert_close(spy.seen[0][0].internal_wrench, expected, atol=1e-12)
    for k in range(1, len(data.time)):
        q, v = data.configuration.values[k], data.velocity.values[k]
        tau = drives.torque(list(data.torque.values[k - 1])) + drives.friction(v)
        before = internal_wrenches(chain.interaction_wrenches(q, v, tau), scenario.cell.shares)[0]
        expected = pole * expected + (1 - pole) * rows.select(before)
        assert_close(spy.seen[k][0].internal_wrench, expected, atol=1e-8)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_friction_acts_in_drive_coordinates(cell):
    scenario = SCENARIOS[cell]()
    chain = CellChain(scenario.cell)
    drives = Transmission(scenario.cell, chain.model.arms, chain.mechanism.model.nv)
    v = np.random.default_rng(0).normal(size=chain.mechanism.model.nv)
    for place in chain.model.arms:
        friction, speeds = scenario.cell.arms[place.name].friction, place.drive @ v[place.v_slice]
        at_drive = -np.array(friction.viscous) * speeds - np.array(friction.coulomb) * np.tanh(
            speeds / friction.coulomb_velocity
        )
        assert_close(drives.friction(v)[place.v_slice], place.drive.T @ at_drive, atol=1e-12)


class Nothing(CellController):
    """No torque at all."""

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        return CellCommand([np.zeros(len(m.v)) for m in measurements], None)


class Started(Nothing):
    """Counts the calls of init, which returns None."""

    def __init__(self, scenario):
        self.starts = 0

    def init(self, measurements, references):
        self.starts += 1


def test_a_controller_without_state_starts_once():
    scenario = cp.Scenario.load("adept-paper").replace(events=(), duration=0.1)
    controller = Started(scenario)
    cp.simulate(scenario, controller)
    assert controller.starts == 1


def test_a_controller_in_python_is_the_one_of_a_scenario_file():
    scenario = cp.Scenario.load("adept-paper")
    gains = cp.laws.PayloadSpaceGains(pose_gain=2.0, sliding_gain=800.0, sign_gain=0.2, transient_rate=5.0)
    law = cp.laws.PayloadSpace(
        gains=gains, switching=cp.laws.Tanh(width=0.1), force_path=cp.laws.LowPassForcePath(pole=0.5)
    )
    typed = scenario.override({"controller": law})
    assert typed == scenario.override({"controller": law.model_dump()})
    assert typed.controller is law
    user = cp.UserController(target=Started)
    assert user == cp.UserController(target=f"{__name__}:Started")
    assert isinstance(build_controller(scenario.override({"controller": user})), Started)


def test_time_is_counted_from_tick_numbers(paper):
    """t_k = k T, not a sum of T: the last sample stands at exactly 20 s."""
    assert float(paper.data.time[-1]) == 20.0
    assert len(paper.data.time) == 1601


def test_without_torque_the_planar_cell_rests():
    """Gravity does no work in the plane: the bar stays where it is."""
    data = cp.simulate(cp.Scenario.load("adept-paper").replace(events=(), duration=0.5), Nothing()).data
    assert_close(
        data.payload_position.values, np.broadcast_to(data.payload_position.values[0], (41, 3)), atol=1e-13
    )


def test_gravity_is_the_scenarios():
    """pinocchio.appendModel forgets it."""
    moon = SCENARIOS["spatial"]().cell.replace(gravity=(0.1, 0.2, -1.6))
    assert_allclose(CellChain(moon).mechanism.model.gravity.linear, [0.1, 0.2, -1.6])


class Broken(Nothing):
    """Raises after a tenth of a second."""

    def step(self, measurements, references, state):
        if measurements[0].time > 0.1:
            raise ZeroDivisionError("my own mistake")
        return super().step(measurements, references, state)


def test_nothing_is_lost_when_a_users_controller_raises():
    with pytest.raises(UserCodeError, match="ZeroDivisionError: my own mistake") as caught:
        cp.simulate(cp.Scenario.load("adept-paper").replace(events=(), duration=0.5), Broken())
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert caught.value.result.end == pytest.approx(0.1)


def open_start(scenario, by):
    """Starting angles that hold the payload, but for the last arm, whose target is moved along y."""
    chain = CellChain(scenario.cell)
    q = chain.configuration(scenario.start.matrix)
    moved = scenario.start.matrix.copy()
    moved[1, 3] += by
    apart = chain.configuration(moved)
    first, last = chain.model.arms[0], chain.model.arms[-1]
    return {first.name: q[first.q_slice].tolist(), last.name: apart[last.q_slice].tolist()}


@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_open_start_is_refused_with_its_gap_and_closes_when_asked(cell, payload):
    scenario = (
        SCENARIOS[cell]()
        .replace(duration=0.1, events=())
        .override({"plant.payload": payload, "controller.gains.sign_gain": 0.0})
    )
    apart = scenario.replace(start_angles=open_start(scenario, 0.1))
    with pytest.raises(OpenClosureError, match="right") as caught:
        cp.run(apart, warn=False)
    assert caught.value.distance == pytest.approx(0.1, abs=1e-9)
    closed = cp.run(apart.replace(project_start=True), warn=False)
    assert max(closed.closure_error_max()) < 1e-8
    assert np.linalg.norm(closed.data.payload_position.values[0] - scenario.start.xyz) < 0.11
    held = cp.run(scenario.replace(start_angles=open_start(scenario, 0.0)), warn=False)
    assert_close(
        held.data.payload_position.values,
        cp.run(scenario, warn=False).data.payload_position.values,
        atol=1e-9,
    )
