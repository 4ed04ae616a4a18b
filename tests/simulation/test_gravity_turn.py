"""Gravity that turns during a run: the plant of both engines, whole runs and a batch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from batches import require_same_samples
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from tiers import by_default
from ways import run_on

import coop_pin as cp
from coop_pin.compiled import plant_of, simulate_batch
from coop_pin.compiled.constants import changes
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.proof import theorem_monitor
from coop_pin.simulation.timeline import Timeline

TURNED = np.array((0.8, -0.5, -9.0))
DURATIONS = {"planar": 0.1, "spatial": 0.04}


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_plant_in_turned_gravity_is_one_built_with_it(name, engine):
    """Acceleration, wrenches and potential; the work is that of lowering the mass centre along the change."""
    scenario, rng = SCENARIOS[name](), np.random.default_rng(4)
    turned, built = (
        CellChain(cell) for cell in (scenario.cell, scenario.cell.replace(gravity=tuple(TURNED)))
    )
    model = turned.mechanism.model
    q = turned.configuration(scenario.start.matrix)
    v = turned.mechanism.project_velocity(q, 0.1 * rng.normal(size=model.nv))
    force, rows = rng.normal(size=model.nv), list(scenario.cell.task_rows.indices)
    plants = [plant_of(engine)(chain, PlantOptions(), q) for chain in (turned, built)]
    plants[0].surround(plants[0].state().surroundings._replace(gravity=TURNED))
    pin_data = model.createData()
    centre = np.array(pin.centerOfMass(model, pin_data, q))
    lowered = -pin_data.mass[0] * (TURNED - np.array(scenario.cell.gravity)) @ centre
    assert_allclose(plants[0].work, [0.0, 0.0, 0.0, lowered], rtol=1e-10)
    for plant in plants:
        plant.restore(plant.state()._replace(v=v, force=force))
    wrenches = [plant.interaction_wrenches()[:, rows] for plant in plants]
    assert_allclose(wrenches[0], wrenches[1], rtol=0, atol=1e-9)
    seen = [plant.observe(q[None], v[None], force[None], np.zeros(1)) for plant in plants]
    assert_allclose(seen[0].potential_energy, seen[1].potential_energy, rtol=1e-12)
    for plant in plants:
        plant.advance(0.0, 1e-3)
    assert_allclose(plants[0].v, plants[1].v, rtol=0, atol=1e-11)
    assert np.abs(plants[0].v - v).max() > 1e-4


def test_surroundings_follow_the_times_of_all_events_whatever_their_order():
    scenario, g = SCENARIOS["spatial"](), (0.0, 1.0, -9.0)
    push = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
    events = (
        cp.events.WrenchPulse(time=0.2, duration=0.2, wrench=push),
        cp.events.GravityTurn(time=0.3, gravity=g),
        cp.events.WrenchPulse(time=0.1, duration=0.2, wrench=push),
        cp.events.PayloadChange(time=0.3, mass=2.0 * scenario.cell.payload.mass),
    )
    scenario, start = scenario.replace(duration=1.0, events=events), scenario.cell.surroundings
    pushes = {0.0: 0, 0.1: 1, 0.2: 2, np.nextafter(0.3, 0.0): 2, 0.30000001: 1, 0.39: 1, 0.4: 0}
    for time, count in pushes.items():
        now, is_later = scenario.surroundings_at(time), time >= 0.3
        assert_allclose(now.push, count * np.array(push), rtol=1e-15)
        assert_allclose(now.gravity, g if is_later else start.gravity, rtol=0)
        assert_allclose(now.mass, (1 + is_later) * start.mass, rtol=1e-15)
        assert_allclose(now.inertia, (1 + is_later) * start.inertia, rtol=1e-15)


def test_only_what_events_change_is_state_of_a_batch_even_if_its_numbers_stay():
    scenario = SCENARIOS["planar"]().replace(duration=0.1, events=())
    mass, gravity = scenario.cell.payload.mass, scenario.cell.gravity
    fields = {
        (): set(),
        (cp.events.WrenchPulse(time=0.03, duration=0.01, wrench=(0.0,) * 6),): {"push"},
        (cp.events.PayloadChange(time=0.03, mass=mass),): {"mass", "inertia"},
        (cp.events.GravityTurn(time=0.03, gravity=gravity), cp.events.PayloadChange(time=0.05, mass=mass)): {
            *("gravity", "mass", "inertia")
        },
    }
    for events, names in fields.items():
        run = scenario.replace(events=events)
        timeline = Timeline(run.clock, run.duration, run.events)
        found = changes(run, timeline)
        assert all(set(changed) == names for changed in found)
        assert len(found) == 1 + len(timeline.event_times())


def turning(name: str, gravity: np.ndarray = TURNED) -> cp.Scenario:
    """A short run in which gravity turns between two plant steps, and the payload is pushed and lighter."""
    scenario, duration = SCENARIOS[name](), DURATIONS[name]
    events = (
        cp.events.GravityTurn(time=0.3711 * duration, gravity=tuple(gravity)),
        cp.events.PayloadChange(time=0.6 * duration, mass=0.7 * scenario.cell.payload.mass),
        cp.events.WrenchPulse(
            time=0.2 * duration, duration=0.5 * duration, wrench=(2.0, 1.0, 0.0, 0.0, 0.0, 0.1)
        ),
    )
    return scenario.replace(duration=duration, events=events)


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_runs_of_all_engines_agree_and_keep_their_energy(name):
    scenarios = [turning(name), turning(name, -0.5 * TURNED)]
    ours = [cp.run(scenario, warn=False) for scenario in scenarios]
    traced, batch = run_on("compiled", scenarios[0]), simulate_batch(scenarios)
    require_same_samples(traced.data, ours[0].data)
    for index, result in enumerate(ours):
        require_same_samples(batch.result(index).data, result.data)
        assert result.energy_balance_max() < 1e-8
    assert abs(float(ours[0].data["work_payload_change"][-1])) > 1e-3
    assert all(np.ptp(ours[0].data[f"work_{name}"].values) > 0.0 for name in ("external", "payload_change"))


@pytest.mark.parametrize("name", SCENARIOS)
def test_static_torques_are_those_of_the_gravity_of_their_time(name):
    scenario = SCENARIOS[name]().replace(duration=0.5, events=())
    there = scenario.replace(cell=scenario.cell.replace(gravity=tuple(TURNED)))
    turned = scenario.replace(events=(cp.events.GravityTurn(time=0.2, gravity=tuple(TURNED)),))
    before, after, found = (
        cp.feasibility.static_torques(each, poses=3).arms for each in (scenario, there, turned)
    )
    for arm_before, arm_after, arm in zip(before, after, found, strict=True):
        for part in ("weight", "load", "squeeze"):
            values, first, last = (getattr(each, part) for each in (arm, arm_before, arm_after))
            assert_allclose(values[0], first[0], rtol=0, atol=1e-12)
            assert_allclose(values[-1], last[-1], rtol=0, atol=1e-12)
    assert np.abs(before[0].load[-1] - after[0].load[-1]).max() > 1e-2


@pytest.mark.parametrize("law", ["sliding-mode", "payload-space"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_identities_of_a_monitor_close_in_turned_gravity(name, law):
    """Eq. (25) of the sliding mode, eq. (2) of the payload-space law."""
    late = {"controller.gains.force_gain": 0.5, "controller.force_path.kind": "late"}
    changes = late if law == "sliding-mode" else {"controller": ANCHORED[name]}
    result = cp.run(turning(name), changes, warn=False)
    residual = theorem_monitor(result)["balance_25" if law == "sliding-mode" else "balance_2"]
    error = result.data["internal_wrench"] - result.data["desired_internal_wrench"]
    assert float(residual.max()) < 1e-6 * float(np.abs(error).max())
