"""Arms that hold alone or nothing after a hand-over: findings before the run, and the run."""

import pytest

import coop_pin as cp
from coop_pin.description.catalogue import scenario_names
from coop_pin.errors import DivergedError
from coop_pin.running.check import run_findings
from coop_pin.running.release_findings import release_findings


def hand_over(name, **changes):
    """A light payload that stays, and whose left arm lets go."""
    scenario = cp.Scenario.load(name, {"plant.payload": "free", "cell.payload.mass": 1.0, "events": []})
    event = cp.events.HandOver(arm="left", time=1.0, duration=0.5, retreat=0.05, retreat_time=0.5)
    motion = cp.motions.HoldMotion(pose=scenario.start)
    return scenario.replace(motion=motion, duration=2.5, events=(event,)).override(changes)


CELLS = {"planar": "adept-anchored", "spatial": "two-pandas-box"}


@pytest.mark.filterwarnings("ignore::coop_pin.errors.ScenarioWarning")
@pytest.mark.parametrize("kind", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_an_arm_that_is_unstable_once_it_holds_nothing_is_an_error_with_a_remedy(kind):
    scenario = hand_over(CELLS[kind])
    errors = [*cp.check(scenario, poses=21).of("error")]
    assert {finding.kind for finding in errors} == {"sampled damping", "loop stability"}
    assert {finding.place for finding in errors} == {"events.0"}
    try:
        result = cp.run(scenario, warn=False)
    except DivergedError as error:
        result = error.result
    assert not result.task.kept
    assert {finding.place for finding in run_findings(scenario).of("error")} == {"events.0"}
    cured = scenario.override(errors[0].remedy)
    assert not [*cp.check(cured, poses=21).of("error")]
    result = cp.run(cured, warn=False)
    assert result.simulation_sound
    assert result.task.kept


def test_hand_overs_of_the_catalogue_leave_stable_arms():
    scenarios = [scenario for name in scenario_names() if (scenario := cp.Scenario.load(name)).grasp_events]
    assert len(scenarios) >= 2
    for scenario in scenarios:
        assert not [*release_findings(scenario)]


def test_cells_with_pads_idle_arms_or_a_tool_are_looked_at_without_an_error():
    pads = {arm: {"mu": 0.9, "radius": 0.02, "press": "x"} for arm in ("left", "right")}
    shares = {"left": 0.0, "right": 1.0}
    for changes in ({"cell.pads": pads}, {"cell.load_shares": shares}):
        assert [*release_findings(hand_over("adept-anchored").override(changes))]
    assert not [*release_findings(cp.Scenario.load("two-ur5-admittance"))]
