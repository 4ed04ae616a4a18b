"""What a controller measures: holding torques, and the random sources of sensors."""

import numpy as np
import pytest
from cells import SCENARIOS

from coop_pin.control import CellCommand
from coop_pin.run_scenario import build_controller
from coop_pin.simulation import Simulation
from coop_pin.simulation.noise import generator
from coop_pin.spatial import internal_wrenches


@pytest.mark.parametrize("robot", [None, {"mass_error": 0.0}, {"mass_error": -0.2}])
@pytest.mark.parametrize("name", SCENARIOS)
def test_holding_torques_keep_the_cell_at_rest_without_internal_wrench(name, robot):
    """As commands: the robot's own gravity compensation acts as well."""
    actuators = {"gravity_compensation": robot, "lag": 0.02}
    scenario = SCENARIOS[name]().override({"cell.gravity": [0.0, -3.0, -9.81], "actuators": actuators})
    simulation = Simulation(scenario, build_controller(scenario))
    plant, rows = simulation.plant, scenario.cell.task_rows
    first = simulation.sensing.start(plant.q, plant.v, simulation.references(0.0))
    torques = [measurement.holding_torque for measurement in first]
    assert max(np.abs(torque).max() for torque in torques) > 1.0
    plant.hold(simulation.actuation.apply(0.0, CellCommand(torques, None), plant.q).force)
    acceleration = plant.chain.mechanism.solver.acceleration(plant.q, plant.v, plant.generalised_force())
    assert np.abs(acceleration).max() < 1e-10
    internal = internal_wrenches(plant.interaction_wrenches(), scenario.cell.shares)
    assert np.abs([rows.select(wrench) for wrench in internal]).max() < 1e-10
    simulation.tick()
    later = simulation.sensing.measure(0.0, plant, [measurement.saturated for measurement in first])
    assert [measurement.holding_torque for measurement in later] == [None] * len(first)


def test_a_source_draws_the_same_whatever_other_sources_there_are():
    draws = {(seed, name): tuple(generator(seed, name).normal(size=4)) for seed in (0, 1) for name in "ab"}
    assert len(set(draws.values())) == 4
    assert draws[0, "a"] == tuple(generator(0, "a").normal(size=4))
