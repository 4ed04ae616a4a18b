"""Proposals for random cells: check passes, runs are sound and kept, spare joints come to rest for 30 s."""

import numpy as np
import pytest
from forecast_cells import KINDS, drawn
from random_cells import random_cell

import coop_pin as cp
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.feasibility import distances, reachability, statics_along
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import loop_stability, start_stability, step_stability


def checked(number, seed=1):
    """The proposal for a cell, which ``coop-pin check`` passes."""
    suggestion = cp.suggest(random_cell(seed, number), poses=21)
    scenario = suggestion.scenario
    found = reachability(scenario, poses=101)
    simulation = Simulation(scenario, build_controller(scenario))
    findings = (
        *(found, statics_along(scenario, found)),
        *(start_stability(simulation), loop_stability(simulation, found)),
        step_stability(simulation, found),
    )
    assert all(finding.ok for finding in findings), scenario.name
    return suggestion


@pytest.mark.parametrize(
    "number", [pytest.param(1, marks=pytest.mark.slow), pytest.param(8, marks=pytest.mark.gate)]
)
def test_a_proposal_for_a_random_cell_passes_check(number):
    """Cells with redundant arms, one in which the robots carry their own weight and one in which not."""
    suggestion = checked(number)
    assert suggestion.proposal.posture.stiffness > 0.0
    assert any(line.startswith("null space") for line in suggestion.limits)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_forty_random_cells_run_as_proposed_or_are_refused_before_a_run(seed):
    """A motion whose forecast is beyond the task, as light arms' may be, is told and may be off."""
    refused, off, within = [], [], 0
    for number in range(40):
        try:
            suggestion = checked(number, seed)
        except InfeasibleMotionError as error:
            refused.append((number, error.cause))
            continue
        scenario = suggestion.scenario
        result = cp.compiled.simulate_batch([scenario]).result(0)
        assert result.simulation_sound, (scenario.name, result.verdict())
        if result.task.state == "off" and any(one.kind == "steady error" for one in suggestion.findings()):
            off.append(number)
            continue
        assert result.task.kept, (scenario.name, result.verdict())
        assert result.metrics()["joint_drift_rad"] < 1e-3, scenario.name
        error = np.linalg.norm(result.data.pose_error.values[:, :3], axis=1).max()
        moving = result.data.time.values > 0.5  # before, the squeeze comes in
        force = (result.data.internal_wrench - result.data.desired_internal_wrench).values[moving, :, :3]
        within += bool(error < 1e-3 and np.linalg.norm(force, axis=-1).max() < 0.5)
    print(f"seed {seed}: refused {refused}, off {off}, {within} of {40 - len(refused)} within 1 mm and 0.5 N")
    assert len(refused) <= 6
    assert len(off) <= 3
    assert within >= 30


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_proposal_for_a_cell_whose_bodies_are_apart_has_no_warning(kind, tmp_path):
    """Ten cells whose stated postures, bases and grasps keep bodies apart, which most draws do not."""
    passed, off = 0, 0
    for number in range(400):
        cell = drawn(tmp_path, 20261202, kind, number)
        along = distances(cell, reachability(cell, poses=5))
        if along.nearest is None or not along.ok:
            continue
        try:
            suggestion = cp.suggest(cell)
        except InfeasibleMotionError:
            continue
        warned = [finding.kind for finding in suggestion.findings().of("error", "warning")]
        if warned:  # of a motion that asks for more than the task allows, which a proposal keeps
            assert warned == ["steady error"], suggestion.scenario.name
            assert not cp.run(suggestion.scenario, warn=False).task.kept, suggestion.scenario.name
            off += 1
        passed += 1
        if passed == 10:
            assert off <= 1
            return
    pytest.fail(f"{passed} cells only")
