"""Gravity that turns during a run: the plant of both engines, whole runs and a batch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from batches import require_same_samples
from cells import SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.batch import simulate_batch
from coop_pin.chain import CellChain
from coop_pin.description.plant import PlantOptions
from coop_pin.engine_choice import plant_of

pytest.importorskip("llvmlite", reason="llvmlite is not installed (extra 'fast')")

TURNED = np.array((0.8, -0.5, -9.0))
DURATIONS = {"planar": 0.1, "spatial": 0.04}


@pytest.mark.parametrize("engine", ["pinocchio", "traced"])
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
    plants[0].surround(plants[0].surroundings._replace(gravity=TURNED))
    pin_data = model.createData()
    centre = np.array(pin.centerOfMass(model, pin_data, q))
    lowered = -pin_data.mass[0] * (TURNED - np.array(scenario.cell.gravity)) @ centre
    assert_allclose(plants[0].work, [0.0, 0.0, 0.0, lowered], rtol=1e-10)
    for plant in plants:
        plant.v = v
        plant.hold(force)
    wrenches = [plant.interaction_wrenches()[:, rows] for plant in plants]
    assert_allclose(wrenches[0], wrenches[1], rtol=0, atol=1e-9)
    seen = [plant.observe(q[None], v[None], force[None]) for plant in plants]
    assert_allclose(seen[0].potential_energy, seen[1].potential_energy, rtol=1e-12)
    for plant in plants:
        plant.advance(0.0, 1e-3)
    assert_allclose(plants[0].v, plants[1].v, rtol=0, atol=1e-11)
    assert np.abs(plants[0].v - v).max() > 1e-4


def turning(name: str, gravity: np.ndarray = TURNED) -> cp.Scenario:
    """A short run in which gravity turns between two plant steps, and the payload is pushed and lighter."""
    scenario, duration = SCENARIOS[name](), DURATIONS[name]
    events = (
        cp.GravityTurn(time=0.3711 * duration, gravity=tuple(gravity)),
        cp.PayloadChange(time=0.6 * duration, mass=0.7 * scenario.cell.payload.mass),
        cp.WrenchPulse(time=0.2 * duration, duration=0.5 * duration, wrench=(2.0, 1.0, 0.0, 0.0, 0.0, 0.1)),
    )
    return scenario.replace(duration=duration, events=events)


@pytest.mark.parametrize("name", SCENARIOS)
def test_runs_of_all_engines_agree_and_keep_their_energy(name):
    scenarios = [turning(name), turning(name, -0.5 * TURNED)]
    ours = [cp.run(scenario) for scenario in scenarios]
    traced, batch = cp.run(scenarios[0], engine="traced"), simulate_batch(scenarios)
    require_same_samples(traced.data, ours[0].data)
    for index, result in enumerate(ours):
        require_same_samples(batch.result(index).data, result.data)
        assert result.energy_balance_max() < 1e-8
    assert abs(float(ours[0].data["work_payload_change"][-1])) > 1e-3
    still = cp.run(scenarios[0].replace(events=scenarios[0].events[1:])).data
    drift = np.abs((ours[0].data.payload_position - still.payload_position).values).max()
    assert drift > 1e-7
