"""Stepping from outside: observe, step, state and restore, copies, and the same bits afterwards."""

import copy
import pickle
import time
import tracemalloc

import numpy as np
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, InvalidStateError, ShapeError
from coop_pin.compiled.plant.compiled_plant import CompiledPlant
from coop_pin.control import CellCommand
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.simulation import Simulation

EVERYTHING = {
    "sensors": {
        "encoder": {"noise": 1e-5, "resolution": 1e-5},
        "velocity": {"kind": "difference"},
        "wrist": {"noise": {"force": 0.1}, "rate_hz": 40.0, "delay": 1},
    },
    "actuators": {"lag": 0.01, "missed_ticks": 0.2, "torque_lost_at": 0.11},
    "events": [
        {"kind": "payload-change", "time": 0.06, "mass": 2.0},
        {"kind": "wrench-pulse", "time": 0.1, "duration": 0.03, "wrench": [3.0, 1.0, 0.0, 0.0, 0.0, 0.5]},
    ],
    "controller.force_path": {"kind": "late"},
    "clock.rate_hz": 80.0,
    "seed": 5,
}


def short(name, duration):
    return SCENARIOS[name]().replace(beyond_bound=True, events=(), duration=duration)


def stepped(scenario, ticks, plant=PinocchioPlant):
    simulation = Simulation(scenario, build_controller(scenario), plant=plant)
    for _ in range(ticks):
        simulation.tick()
    return simulation


def finished(simulation):
    while not simulation.is_finished:
        simulation.tick()
    return simulation.result().data


def disturbed(name):
    """A cell of the catalogue with noise, delay, lag, missed ticks, and its own events within some ticks."""
    scenario = cp.Scenario.load(name)
    T, servo = scenario.clock.period, scenario.actuators.servo
    short_of = {"duration": 2.0 * T, "retreat": 0.0}
    brief = [{name: short_of[name] for name in short_of if hasattr(each, name)} for each in scenario.events]
    own = [
        event.replace(time=(1 + 2 * k) * T, **change)
        for k, (event, change) in enumerate(zip(scenario.events, brief, strict=True))
    ]
    wrist = {"noise": {"force": 0.1}, "rate_hz": scenario.clock.rate_hz / 2.0, "delay": 1}
    push = {
        "kind": "wrench-pulse",
        "time": 5 * T,
        "duration": 2 * T,
        "wrench": [3.0, 1.0, 0.0, 0.0, 0.0, 0.5],
    }
    heavier = {"kind": "payload-change", "time": 2 * T, "mass": 1.1 * scenario.cell.payload.mass}
    changes = {
        "sensors": EVERYTHING["sensors"] | {"wrist": wrist},
        "actuators.missed_ticks": 0.2,
        "actuators.lag": 0.0 if servo else 0.01,
        "duration": (2 * len(own) + 9) * T,
        "seed": 5,
    }
    scenario = scenario.replace(beyond_bound=True, events=()).override(changes)
    return scenario.override({"events": [*own, push] if own else [heavier, push]})


@pytest.fixture(params=[*SCENARIOS, *cp.scenario_names()])
def scenario(request):
    name = request.param
    return short(name, 0.2).override(EVERYTHING) if name in SCENARIOS else disturbed(name)


def test_a_restored_run_goes_on_with_the_same_bits(scenario):
    """On rigid and compliant grasps, with patches, tables, a partner, and grasps that open and close."""
    simulation = stepped(scenario, 0)
    states = [pickle.loads(pickle.dumps(simulation.state()))]
    for _ in range(4):
        simulation.tick()
    states.append(pickle.loads(pickle.dumps(simulation.state())))
    clone = copy.deepcopy(simulation)
    expected = finished(simulation)
    assert finished(clone).identical(expected)
    for ticks, state in zip((0, 4), states, strict=True):
        simulation.restore(state)
        assert simulation.ticks_done == ticks
        assert finished(simulation).identical(expected)
    assert not np.shares_memory(simulation.result().data.torque.values, expected.torque.values)
    simulation.reset()
    assert finished(simulation).identical(expected)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_returns_to_any_of_its_ticks_with_the_noise_of_that_tick(name):
    simulation, states = stepped(short(name, 0.2).override(EVERYTHING), 0), []
    for _ in range(6):
        states.append(simulation.state())
        simulation.tick()
    expected = simulation.result().data
    for ticks in (2, 5, 0, 2):
        simulation.restore(states[ticks])
        simulation.tick()
        seen = simulation.result().data.measured_drive_position.values
        np.testing.assert_array_equal(seen, expected.measured_drive_position.values[: ticks + 1])
    other = stepped(simulation.scenario.replace(seed=6), 2)
    simulation.restore(other.state())
    for each in (simulation, other):
        each.tick()
    assert simulation.result().data.identical(other.result().data)


class SumsInPlace(cp.CellController):
    """A law that adds to the arrays of its state and returns them."""

    def init(self, measurements, references):
        return {"sums": [np.zeros_like(each.q) for each in measurements]}

    def step(self, measurements, references, state):
        for total, measured in zip(state["sums"], measurements, strict=True):
            total += 0.1 * measured.v
        return CellCommand([each.copy() for each in state["sums"]], state)


@pytest.mark.parametrize("name", SCENARIOS)
def test_arrays_that_a_law_changes_in_place_are_restored_each_time(name):
    scenario = short(name, 0.2)
    simulation = Simulation(scenario, SumsInPlace())
    for _ in range(5):
        simulation.tick()
    state = simulation.state()
    expected = finished(simulation)
    for _ in range(2):
        simulation.restore(state)
        assert finished(simulation).identical(expected)
    simulation.reset()
    assert finished(simulation).identical(expected)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_state_holds_the_record_of_its_own_branch(name):
    simulation = stepped(short(name, 0.2), 3)
    early = simulation.state()
    expected = finished(simulation)
    simulation.restore(early)
    for _ in range(4):
        command = simulation.controller.step(*simulation.observe()[:2], simulation.controller_state)
        simulation.step(CellCommand([1.1 * torque for torque in command.torques], command.state))
    late = simulation.state()
    branch = simulation.result().data
    simulation.restore(early)
    assert finished(simulation).identical(expected)
    simulation.restore(late)
    assert simulation.result().data.identical(branch)
    assert not np.array_equal(branch.torque.values, expected.torque.values[: len(branch.time)])


@pytest.mark.parametrize("name", SCENARIOS)
def test_commands_from_outside_are_those_of_the_controller(name):
    scenario = short(name, 0.1)
    law, outside = build_controller(scenario), Simulation(scenario)
    inputs, state = outside.reset(), None
    while not outside.is_finished:
        inputs = outside.observe()
        assert outside.observe() is inputs
        measured = inputs.measurements, inputs.references
        command = law.step(*measured, law.init(*measured) if state is None else state)
        outside.step(command)
        state = command.state
    inside, result = stepped(scenario, 0), outside.result()
    for variable, values in finished(inside).data_vars.items():
        np.testing.assert_array_equal(result.data[variable].values, values.values)
    assert "outside from t = 0 s" in result.scenario.summary


@pytest.mark.parametrize("name", SCENARIOS)
def test_another_seed_draws_other_numbers_and_the_first_one_the_same(name):
    scenario = short(name, 0.2).override(EVERYTHING)
    simulation = stepped(scenario, 0)
    expected = finished(simulation)
    simulation.reset(seed=6)
    other = finished(simulation)
    assert not np.array_equal(*(run.measured_drive_position.values for run in (other, expected)))
    assert finished(stepped(scenario.replace(seed=6), 0)).identical(other)
    simulation.reset()
    assert finished(simulation).identical(expected)


def test_the_compiled_plant_is_restored_too():
    simulation = stepped(
        cp.Scenario.load("two-pandas-box").replace(events=(), duration=0.05), 7, CompiledPlant
    )
    state = simulation.state()
    expected = finished(simulation)
    simulation.restore(state)
    assert finished(simulation).identical(expected)
    assert finished(pickle.loads(pickle.dumps(simulation))).identical(expected)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_hundred_thousand_steps_take_no_more_memory_than_ten_thousand(name):
    scenario = SCENARIOS[name]().replace(events=())
    every = scenario.clock.replace(record_every=1000)
    simulation = Simulation(scenario.replace(clock=every, duration=100_000 * scenario.clock.period))
    law, state, sizes = build_controller(scenario), None, []
    tracemalloc.start()
    while not simulation.is_finished:
        measured = simulation.observe()[:2]
        command = law.step(*measured, law.init(*measured) if state is None else state)
        simulation.step(command)
        state = command.state
        if simulation.ticks_done in (10_000, 100_000):
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    print(f"{name}: {sizes[0]} bytes after 10 000 steps, {sizes[1] - sizes[0]} more after 100 000")
    assert sizes[1] - sizes[0] < 100_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box"])
def test_stepping_from_outside_costs_at_most_a_tenth_of_a_tick(name):
    """Processor time of blocks of 100 ticks in turn: by ``tick``, and by observe, the law and ``step``."""
    blocks, ticks = 31, 100
    scenario = cp.Scenario.load(name).replace(events=(), duration=1e3)
    scenario = scenario.override({"clock.record_every": 1000})
    inside, outside, law = stepped(scenario, 10), Simulation(scenario), build_controller(scenario)
    measured = outside.observe()[:2]
    outside.step(command := law.step(*measured, law.init(*measured)))
    ratios = []
    for _ in range(blocks):
        began = time.process_time()
        for _ in range(ticks):
            inside.tick()
        between = time.process_time()
        for _ in range(ticks):
            command = law.step(*outside.observe()[:2], command.state)
            outside.step(command)
        ratios.append((time.process_time() - between) / (between - began))
    print(f"{name}: {np.median(ratios):.3f} of a tick {np.percentile(ratios, (25, 75)).round(3)}")
    assert np.median(ratios) < 1.1


def test_what_does_not_fit_is_refused():
    scenario = short("planar", 0.1)
    simulation = stepped(scenario, 2)
    with pytest.raises(ArgumentError, match="clock"):
        stepped(scenario.replace(duration=0.2), 0).restore(simulation.state())
    with pytest.raises(InvalidStateError, match="step"):
        Simulation(scenario).tick()
    with pytest.raises(ShapeError):
        simulation.step(CellCommand([np.zeros(3)], simulation.controller_state))
    with pytest.raises(cp.CoopPinError):
        simulation.step([np.zeros(3)] * 2)
    simulation.observe()
    push = cp.events.WrenchPulse(time=simulation.time, duration=0.01, wrench=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(FieldError, match="reached"):
        simulation.add_event(push)  # the tick was observed without it
    finished(simulation)
    with pytest.raises(InvalidStateError, match="finished"):
        simulation.observe()
