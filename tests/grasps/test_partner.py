"""A person or machine at a handle: element, runs, steps, and what is refused; planar and in space, turned."""

from __future__ import annotations

import numpy as np
import pytest
from cells import SCENARIOS
from compliant_cells import anchored, with_grasps
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import CoopPinError, DivergedError, FieldError
from coop_pin.base.spatial import exp3, make_pose
from coop_pin.compiled import support
from coop_pin.grasps.spring_damper import partner_matrices, partner_state
from coop_pin.results.energies import energy_balance
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability import step_stability

HANDLE = cp.Pose(xyz=(0.05, -0.08, 0.0), rpy=(0.3, -0.2, 0.5))
STIFFNESS, DAMPING = (400.0, 300.0, 500.0, 4.0, 3.0, 6.0), (20.0, 10.0, 15.0, 0.2, 0.1, 0.3)
STEPS = {"planar": 40, "spatial": 2}


def partner(scenario: cp.Scenario, **fields) -> cp.events.Partner:
    """A partner who turns the payload about an axis, beside its path."""
    centre = scenario.start.matrix
    motion = cp.motions.TurnMotion(pose=cp.Pose.from_matrix(centre), axis=(0, 0, 1), angle=0.3, duration=0.2)
    given = {"time": 0.01, "duration": 0.03, "motion": motion, "handle": HANDLE}
    return cp.events.Partner(**given | {"stiffness": STIFFNESS, "damping": DAMPING} | fields)


def with_partner(name: str, *, compliant=False, end=0.05, **fields) -> cp.Scenario:
    """A short run with a partner, in a cell with rigid or compliant grasps."""
    scenario = anchored(name)
    scenario = (
        with_grasps(scenario).override({"clock.steps_per_tick": STEPS[name]}) if compliant else scenario
    )
    return scenario.replace(events=(partner(scenario, **fields),), duration=end)


def test_wrench_is_power_consistent():
    """F.V of the handle = -d(energy)/dt + dissipated + supplied, by central differences along a motion."""
    scenario, h, rng = SCENARIOS["spatial"](), 1e-5, np.random.default_rng(3)
    one, V = partner(scenario), rng.normal(size=6)
    offset = make_pose((0.02, 0.01, -0.03), (0.1, -0.2, 0.15))

    def at(time: float):
        X = scenario.start.matrix @ offset
        X[:3, :3] = exp3((time - 0.1) * V[3:]) @ X[:3, :3]
        X[:3, 3] += (time - 0.1) * V[:3]
        return partner_state(one, time, X, V)

    behind, here, ahead = at(0.1 - h), at(0.1), at(0.1 + h)
    rate = (ahead.energy - behind.energy) / (2.0 * h)
    assert_allclose(here.wrench @ V, -rate + here.dissipated + here.supplied, rtol=1e-7)
    assert here.dissipated < 0.0
    assert here.energy > 0.0
    still = partner_state(one, 0.0, scenario.start.matrix, np.zeros(6))
    assert_allclose(still.wrench, 0.0, atol=1e-12)
    assert_allclose(still.deflection, 0.0, atol=1e-15)


def test_stiffness_is_that_of_the_handle_for_small_displacements():
    scenario, step = SCENARIOS["spatial"](), 1e-6 * np.random.default_rng(4).normal(size=6)
    one, X = partner(scenario), scenario.start.matrix
    near = X.copy()
    near[:3, :3], near[:3, 3] = exp3(step[3:]) @ X[:3, :3], X[:3, 3] + step[:3]
    K, D = partner_matrices(one, 0.0, np.eye(6))
    assert_allclose(partner_state(one, 0.0, near, np.zeros(6)).wrench, -K @ step, rtol=1e-4, atol=1e-9)
    assert_allclose(partner_state(one, 0.0, X, step).wrench, -D @ step, rtol=1e-7)


@pytest.mark.parametrize("compliant", [False, True], ids=["rigid", "compliant"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_energy_is_explained_while_a_partner_holds(name, compliant):
    """16 times less at half the step: its point moves within a step, too."""
    scenario, residuals = with_partner(name, compliant=compliant), []
    steps = scenario.clock.steps_per_tick
    for factor in (1, 2):
        data = cp.run(scenario.override({"clock.steps_per_tick": factor * steps}), warn=False).data
        residuals.append(np.abs(energy_balance(data)).max())
    assert np.abs(data["work_external"].values[-1]) > 1e-6
    print(f"\n{name}: {residuals} J, work {data['work_external'].values[-1]:.3g} J")
    assert residuals[0] < 1e-8
    assert residuals[1] < residuals[0] / 10.0 or residuals[1] < 2e-13


@pytest.mark.parametrize("name", SCENARIOS)
def test_partner_is_recorded_and_balances_the_arms(name):
    """F - sum F_i = m (a - g) of the payload alone, and the recorded wrench is K times the deflection."""
    scenario = with_partner(name, damping=(0.0,) * 6)
    data = cp.run(scenario, warn=False).data
    time, wrench = data["time"].values, data["partner_wrench"].values
    holds = (time > 0.0099) & (time < 0.0399)
    assert np.isnan(wrench[~holds]).all()
    assert_array_equal(data["external_wrench"].values[holds], wrench[holds])
    assert not data["external_wrench"].values[~holds].any()
    k = int(np.flatnonzero(holds)[-1])
    force = np.linalg.norm(wrench[k, :3])
    stretched = np.linalg.norm(np.array(STIFFNESS[:3]) * data["partner_deflection"].values[k, :3])
    assert force > 0.1
    assert_allclose(force, stretched, rtol=1e-12)
    forces = data["interaction_wrench"].values[:, :, :3]
    twist, cell = data["payload_twist"].values, scenario.cell
    a = (twist[k] - twist[k - 2])[:3] / (time[k] - time[k - 2])
    resultant = wrench[k - 1, :3] + cell.payload.mass * np.array(cell.gravity) - forces[k - 1].sum(axis=0)
    rows = [row for row in cell.task_rows.indices if row < 3]
    assert_allclose(resultant[rows], cell.payload.mass * a[rows], rtol=0, atol=0.1 * force)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_goes_on_from_a_state_within_the_hold_with_the_same_bits(name):
    scenario = with_partner(name)
    sim = Simulation(scenario, build_controller(scenario))
    while sim.time < 0.025:
        sim.tick()
    state, ends = sim.state(), []
    for _ in range(2):
        sim.restore(state)
        while not sim.is_finished:
            sim.tick()
        ends.append(sim.result().data)
    assert_array_equal(ends[0]["configuration"].values, ends[1]["configuration"].values)
    assert_array_equal(
        ends[0]["configuration"].values, cp.run(scenario, warn=False).data["configuration"].values
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_step_of_a_stiff_partner_is_checked(name):
    """Within the limit the run is sound; a tenth beyond, it grows."""
    scenario = with_partner(name, stiffness=(1e7, 1e7, 1e7, 1e4, 1e4, 1e4), damping=(0.0,) * 6)
    found = step_stability(Simulation(scenario, build_controller(scenario)))
    assert found.cause == "partner"
    ratio = found.value / found.limit
    for wanted in (0.95, 1.1):
        stiffness = np.array((1e7, 1e7, 1e7, 1e4, 1e4, 1e4)) * (wanted / ratio) ** 2
        changes = {
            "stiffness": tuple(stiffness.tolist()),
            "motion": cp.motions.HoldMotion(pose=scenario.start),
        }
        run = with_partner(name, damping=(0.0,) * 6, duration=0.09, end=0.1, **changes)
        if wanted < 1.0:
            assert np.abs(energy_balance(cp.run(run, warn=False).data)).max() < 1e-6
        else:
            with pytest.raises(DivergedError):
                cp.run(run, warn=False)


@pytest.mark.parametrize(
    "fields",
    [
        {"stiffness": (-1.0, 0, 0, 0, 0, 0)},
        {"stiffness": (0.0,) * 6},
        {"stiffness": (float("nan"),) * 6},
        {"damping": (-1.0,) * 6},
        {"duration": 0.0},
        {"time": -1.0},
        {"motion": {"kind": "nothing"}},
        {"handle": {"xyz": (1.0, 2.0)}},
    ],
    ids=str,
)
def test_fields_that_mean_nothing_are_refused(fields):
    with pytest.raises(CoopPinError):
        partner(SCENARIOS["spatial"](), **fields)


def test_two_partners_at_a_time_and_late_ones_are_refused():
    scenario = anchored("spatial")
    one, two = (partner(scenario, time=time) for time in (0.01, 0.02))
    with pytest.raises(CoopPinError, match=r"events\.1\.time"):
        scenario.replace(events=(one, two))
    with pytest.raises(CoopPinError, match="ends at"):
        scenario.replace(events=(partner(scenario, duration=9.0),))
    scenario.replace(events=(one, partner(scenario, time=0.04)))


def test_compiled_code_refuses_a_partner_before_the_run():
    scenario = with_partner("spatial")
    assert "partner" in support(scenario)
    assert "partner" not in (support(scenario.replace(events=())) or "")
    assert cp.run(scenario, warn=False, engine="auto").engine == "pinocchio"
    with pytest.raises(FieldError, match="'pinocchio'"):
        cp.run(scenario, warn=False, engine="compiled")


@pytest.mark.slow
def test_the_scenario_with_a_person_carries_on():
    """Half a second late and 3 cm lower: 14 N of the person at most, 0.84 mm, and no lasting error."""
    result = cp.run("human-partner", warn=False)
    data = result.data
    distance = 1e3 * np.linalg.norm(data["pose_error"].values[:, :3], axis=1)
    force = np.linalg.norm(data["partner_wrench"].values[:, :3], axis=1)
    internal = np.linalg.norm(data["internal_axial_error"].values[1000:], axis=1)
    print(f"\n{distance.max():.3f} mm, {np.nanmax(force):.2f} N, internal {internal.max():.3f} N")
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    assert distance.max() < 0.9
    assert 10.0 < np.nanmax(force) < 15.0
    assert internal.max() < 1.2
    assert distance[-1] < 0.02
