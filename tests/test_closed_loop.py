"""Eigenvalues of the sampled closed loop: against runs at bounds, closed forms and sampled_motion."""

from dataclasses import replace

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.analysis import sampled_motion
from coop_pin.build_controller import build_controller
from coop_pin.control.bounds import anchor_gain_bound, force_gain_bound
from coop_pin.errors import ArgumentError, OutOfRangeError


def held(name, changes, controller=None):
    scenario = SCENARIOS[name]().replace(events=(), beyond_bound=True)
    scenario = scenario.replace(motion=cp.HoldMotion(pose=scenario.start))
    if controller is not None:
        return scenario.replace(controller=controller).override(changes)
    return scenario.override({"controller.gains.sign_gain": 0.0} | changes)


def torques(scenario, ticks, disturbance):
    """Torques of a run whose fifth command is disturbed."""
    simulation = cp.Simulation(
        scenario.replace(duration=ticks * scenario.clock.period), build_controller(scenario)
    )
    rng = np.random.default_rng(3)
    for tick in range(ticks):
        inputs = simulation.observe()
        if tick == 0:
            simulation.controller_state = simulation.controller.init(inputs.measurements, inputs.references)
        command = simulation.controller.step(
            inputs.measurements, inputs.references, simulation.controller_state
        )
        if tick == 5:
            moved = [torque + disturbance * rng.normal(size=torque.size) for torque in command.torques]
            command = replace(command, torques=moved)
        simulation.step(command)
    return simulation.result().data.torque.values.reshape(ticks, -1)


def growth(scenario, ticks):
    """Growth of a small disturbance from tick to tick over the last half of a run."""
    apart = np.linalg.norm(torques(scenario, ticks, 1e-4) - torques(scenario, ticks, 0.0), axis=1)
    quarter = ticks // 4
    early, late = (np.linalg.norm(apart[k : k + quarter]) for k in (ticks - 2 * quarter, ticks - quarter))
    return (late / early) ** (1.0 / quarter)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_force_gain_crosses_the_unit_circle_where_runs_begin_to_grow(name):
    bound = force_gain_bound(0.5)
    path = {"controller.force_path": {"kind": "low-pass", "pole": 0.5}}
    below, above = (held(name, path | {"controller.gains.force_gain": part * bound}) for part in (0.98, 1.02))
    loop = cp.eigenvalues(above)
    assert cp.eigenvalues(below).radius < 1.0 < loop.radius
    assert loop.slowest.name.startswith("internal")
    assert growth(below, 120) < 1.0
    assert_allclose(growth(above, 120), loop.radius, atol=3e-3)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_anchor_gain_with_delay_crosses_the_unit_circle_at_its_closed_form(name):
    bound, path = anchor_gain_bound(delay=2), {"controller.force_path": {"kind": "late", "delay": 2}}
    radii = [
        cp.eigenvalues(
            held(name, path | {"controller.gains.anchor_gain": part * bound}, ANCHORED[name])
        ).radius
        for part in (0.98, 1.02)
    ]
    assert radii[0] < 1.0 < radii[1]


def test_the_damping_crosses_the_unit_circle_where_runs_begin_to_grow():
    scenario = held("planar", {})
    gains = np.array(scenario.controller.gains.damping_gain)
    below, above = (
        scenario.override({"controller.gains.damping_gain": tuple((2.75818 * part * gains).tolist())})
        for part in (0.98, 1.02)
    )
    loop = cp.eigenvalues(above)
    assert cp.eigenvalues(below).radius < 1.0 < loop.radius
    assert growth(below, 150) < 1.0
    assert_allclose(growth(above, 150), loop.radius, atol=1e-3)


def test_the_motion_is_that_of_sampled_motion_where_that_applies():
    scenario = cp.Scenario.load("two-pandas-box")
    simulation = cp.Simulation(scenario, build_controller(scenario))
    motion = sampled_motion(simulation, simulation.plant.q, 0.0)
    expected = np.linalg.eigvals(motion.matrix(scenario.actuator_lag * scenario.clock.period))
    loop = cp.eigenvalues(scenario)
    assert not loop.structural
    for z in expected[np.abs(expected) > 0.05]:
        assert np.abs(loop.z - z).min() < 3e-4
    assert {"posture of left", "posture of right"} <= {mode.name for mode in loop.modes}


@pytest.mark.parametrize("name", SCENARIOS)
def test_integrals_without_anchor_and_leak_are_structural(name):
    """An integral of each arm, and one motion: m - 1 internal directions of each row rest at z = 1."""
    law = ANCHORED[name].override({"force_path": {"kind": "none"}, "gains.leak": 0.0})
    loop = cp.eigenvalues(held(name, {}, law))
    assert len(loop.structural) == {"planar": 3, "spatial": 6}[name]
    assert all(mode.startswith("internal") for mode in loop.structural)


def test_what_has_no_eigenvalues_is_refused():
    with pytest.raises(ArgumentError):
        cp.eigenvalues(cp.Scenario.load("adept-paper"))
    with pytest.raises(OutOfRangeError):
        cp.eigenvalues(cp.Scenario.load("adept-anchored"), time=-1.0)
