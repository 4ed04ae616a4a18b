"""Internal moments to expect against those of runs: where no row controls them, and where the anchor does."""

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from ur_cells import UR, UR5_OF_FIVE, carry, short

import coop_pin as cp
from coop_pin.cli import main
from coop_pin.design import gain_proposal
from coop_pin.feasibility import internal_moment, positional_torques, reachability

UR10 = {"urdf": "ur10", **UR}
POSITIONAL = {
    "two of five joints": [UR5_OF_FIVE] * 2,
    "two of six": [UR10] * 2,
    "six and five": [UR10, UR5_OF_FIVE],
}


def run_moments(scenario, start=0.0):
    """Largest difference of an arm's internal moment from the desired one at each tick, N m."""
    data = cp.run(scenario, warn=False).data.sel(time=slice(start, None))
    rows = [3, 4, 5] if scenario.cell.rows != "planar" else [5]
    error = (data.internal_wrench - data.desired_internal_wrench).values[..., rows]
    return data.time.values, np.linalg.norm(error, axis=-1).max(axis=1)


@pytest.mark.parametrize(
    "arms", [pytest.param(arms, marks=[pytest.mark.slow] * ("six" in arms)) for arms in POSITIONAL]
)
@pytest.mark.gate
def test_the_moment_that_no_row_controls_is_that_of_a_run(arms):
    scenario = short(carry("positional", POSITIONAL[arms], by=(0.0, 0.03, 0.05), rows="positional"))
    suggestion = cp.suggest(scenario, poses=21)
    scenario, expected = suggestion.scenario, suggestion.proposal.internal_moment
    times, moments = run_moments(scenario)
    assert_allclose(expected, moments.max(), rtol=0.05)
    found = internal_moment(scenario, reachability(scenario, poses=101), scenario.controller.posture)
    assert_allclose([found.moment, found.time], [moments.max(), times[moments.argmax()]], rtol=0.05)
    assert found.arm in scenario.cell.arms
    assert any(line.startswith("internal moment") for line in suggestion.limits)


@pytest.mark.parametrize("arms", ["two of five joints", pytest.param("six and five", marks=pytest.mark.slow)])
@pytest.mark.gate
def test_the_torques_on_positional_rows_are_those_of_a_run_and_the_drives_hold_the_spring(arms):
    """At rest, where the closures hold the spare joints against springs and squeeze."""
    scenario = short(carry("positional", POSITIONAL[arms], by=(0.0, 0.05, 0.15), rows="positional"))
    scenario = scenario.replace(squeeze=cp.squeezes.TipForceSqueeze(force=10.0), duration=3.0)
    suggested = cp.suggest(scenario, poses=21).scenario
    found = reachability(suggested, poses=61)
    expected = positional_torques(suggested, found, suggested.controller.posture)
    result = cp.run(suggested, warn=False)
    assert result.simulation_sound, result.verdict()
    for arm, torques in enumerate(expected):
        joints = torques.shape[1]
        final = result.data.torque.values[-1, arm, :joints]
        assert_allclose(torques[-1], final, atol=0.04 * np.abs(final).max())
        limits = result.data.torque_limit.values[arm, :joints]
        assert np.all(np.abs(torques) <= 0.905 * limits)  # at more poses than the 21 of the proposal


@pytest.mark.gate
def test_springs_of_single_joints_and_the_squeeze_count(capsys):
    """The cell of the catalogue has no spring on its first joints, and tip forces with moments about P."""
    scenario = cp.Scenario.load("five-joint-pair", {"duration": 4.0})
    found = internal_moment(scenario, reachability(scenario, poses=101), scenario.controller.posture)
    assert_allclose(found.moment, run_moments(scenario)[1].max(), rtol=0.05)
    one_spring = internal_moment(scenario, reachability(scenario, poses=101), cp.laws.PostureGains())
    assert one_spring.moment > 5.0 * found.moment
    main(["check", "five-joint-pair", "--duration", "4", "--poses", "101"])
    assert f"{found.moment:.3g} N m" in capsys.readouterr().out


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_the_moment_that_the_anchor_controls_is_expected_like_its_force(cell):
    """Along a slow line, over time: weights, friction that changes its sign, and the anchor's lag."""
    start = SCENARIOS[cell]().start
    goal = start.replace(xyz=tuple(np.add(start.xyz, (0.05, 0.03, 0.0))))
    motion = cp.motions.LineMotion(start=start, goal=goal, start_time=0.2, duration=1.5)
    changes = {"events": [], "duration": 2.0, "motion": motion, "squeeze": {"kind": "constant"}}
    scenario = SCENARIOS[cell]().override(changes | {"controller": ANCHORED[cell]})
    suggestion = cp.suggest(scenario, poses=21)
    expected = suggestion.proposal.internal_moment
    _, moments = run_moments(suggestion.scenario, 0.2)
    assert_allclose(moments.max(), expected, rtol=0.1)
    unmeasured = scenario.override({"controller.force_path": {"kind": "none"}})
    assert gain_proposal(unmeasured, reachability(unmeasured, poses=21)).internal_moment is None
