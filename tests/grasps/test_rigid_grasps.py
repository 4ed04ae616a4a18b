"""Rigid grasps that open and close: impulse, momentum, energy and refusals; planar, and in space, turned."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS
from compliant_cells import anchored, mass_matrix, with_grasps
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base.errors import FieldError, NameNotFoundError
from coop_pin.base.schema.user_code import code_of
from coop_pin.base.spatial import spatial_inertia
from coop_pin.compiled import support
from coop_pin.results.energies import energy_balance
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

CYCLE = (
    cp.events.HandOver(time=0.02, arm="right", duration=0.02),
    cp.events.Regrasp(time=0.06, arm="right", duration=0.02, approach_time=0.01, wait=0.0, tolerance=0.02),
)


def scenario_with(name: str, *events, **changes) -> cp.Scenario:
    """A short run of a cell with rigid grasps, with events."""
    changes = {"plant.payload": "free", "duration": 0.1} | changes
    return anchored(name).override(changes).replace(events=events)


def simulation_at(scenario: cp.Scenario, time: float) -> Simulation:
    """Its simulation, at a time."""
    sim = Simulation(scenario, build_controller(scenario))
    while sim.time < time - 1e-9:
        sim.tick()
    return sim


@pytest.mark.parametrize("name", SCENARIOS)
def test_release_keeps_the_motion_and_leaves_no_wrench(name):
    plant = simulation_at(scenario_with(name, *CYCLE), 0.03).plant
    before = plant.state()
    assert np.abs(plant.interaction_wrenches()[1]).max() > 0.1
    plant.release(1)
    assert_array_equal(plant.q, before.q)
    assert_array_equal(plant.v, before.v)  # and with it the momentum
    assert_array_equal(plant.work, before.work)
    wrenches = plant.interaction_wrenches()
    assert not wrenches[1].any()
    assert np.abs(wrenches[0]).max() > 0.1
    plant.restore(before)
    assert np.abs(plant.interaction_wrenches()[1]).max() > 0.1


@pytest.mark.parametrize("name", SCENARIOS)
def test_velocities_meet_by_an_impulse_that_balances(name):
    """M dv = J^T L and J v = 0; the payload alone gets what the arms get, turned round; energy is booked."""
    plant = simulation_at(scenario_with(name, *CYCLE), 0.05).plant
    rng = np.random.default_rng(1)
    plant.v = plant.v + 0.05 * rng.normal(size=len(plant.v))
    plant.v = plant.chain.mechanism.project_velocity(plant.q, plant.v)
    q, before, work = plant.q, plant.v, plant.work
    assert CYCLE[1].act(plant, ["left", "right"]) is None
    chain, change = plant.chain, plant.v - before
    assert np.abs(change).max() > 1e-3
    assert_array_equal(plant.q, q)
    assert max(max(error) for error in plant.closure_errors()) < 1e-12
    state, M = chain.mechanism.closures.state(q, plant.v), mass_matrix(chain, q)
    assert_allclose(state.velocity, 0.0, atol=1e-12)
    impulse = np.linalg.lstsq(state.jacobian.T, M @ change, rcond=1e-9)[0]
    scale = np.abs(M @ change).max()
    assert_allclose(state.jacobian.T @ impulse, M @ change, rtol=0, atol=1e-10 * scale)
    on_arms = state.wrench_map @ impulse
    X_WP = pin.SE3(chain.payload_pose(q))
    total = np.zeros(6)
    for arm, slot, L in zip(chain.arms, chain.model.arms, on_arms, strict=True):
        total += (X_WP.inverse() * pin.SE3(arm.tip_pose(q[slot.q_slice]))).act(pin.Force(L)).vector
    cell, J = chain.cell, chain.payload_jacobian(q)
    inertia = spatial_inertia(cell.payload.mass, cell.payload.inertia_matrix, X_WP.rotation)
    gained = np.kron(np.eye(2), X_WP.rotation.T) @ inertia @ J @ change
    assert_allclose(gained, -total, rtol=0, atol=1e-10 * np.abs(total).max())
    lost = 0.5 * change @ M @ change
    assert_allclose(plant.work[3] - work[3], -lost, rtol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_energy_is_explained_through_release_and_grasp(name):
    """The impact takes energy, which is booked; the rest is explained to order four."""
    residuals = []
    for factor in (1, 2):
        scenario = scenario_with(name, *CYCLE)
        steps = factor * scenario.clock.steps_per_tick
        result = cp.run(scenario.override({"clock.steps_per_tick": steps}), warn=False)
        data = result.data
        assert "did not" not in result.summary()
        residuals.append(np.abs(energy_balance(data)).max())
        assert max(result.closure_error_max()) < 1e-11
    assert data["work_payload_change"].values[-1] < -1e-5
    print(f"\n{name}: {residuals} J; the impact takes {-data['work_payload_change'].values[-1]:.3g} J")
    assert residuals[0] < 1e-8
    assert residuals[1] < 0.1 * residuals[0]
    time, share = data["time"].values, data["load_share"].values
    free = (time > 0.0401) & (time < 0.0599)
    assert not np.nan_to_num(data["interaction_wrench"].values[free][:, 1]).any()
    assert_allclose(share[free], [[1.0, 0.0]] * free.sum(), atol=1e-12)
    assert_allclose(share[-1], scenario.cell.shares)


def test_a_rigid_grasp_opens_beside_a_compliant_one():
    scenario = with_grasps(anchored("spatial"), arms=["left"])
    scenario = scenario.override({"plant.payload": "free", "duration": 0.1}).replace(events=CYCLE)
    result = cp.run(scenario, warn=False)
    assert "did not" not in result.summary()
    assert np.abs(energy_balance(result.data)).max() < 1e-7


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_run_goes_on_from_any_state_with_the_same_bits(name):
    scenario = scenario_with(name, *CYCLE)
    sim, ends, whole = simulation_at(scenario, 0.0), [], cp.run(scenario, warn=False).data
    states = {}
    for time in (0.03, 0.05, 0.07):
        while sim.time < time - 1e-9:
            sim.tick()
        states[time] = sim.state()
    for state in reversed(states.values()):
        sim.restore(state)
        while not sim.is_finished:
            sim.tick()
        ends.append(sim.result().data["configuration"].values)
    for end in ends:
        assert_array_equal(end, whole["configuration"].values)


@pytest.mark.parametrize("name", SCENARIOS)
def test_grasp_out_of_reach_does_not_happen(name):
    near = cp.events.Regrasp(time=0.06, arm="right", duration=0.02, tolerance=1e-9)
    result = cp.run(scenario_with(name, CYCLE[0], near), warn=False)
    assert "did not happen" in result.summary()
    assert result.data["work_payload_change"].values[-1] == 0.0


def test_what_a_rigid_grasp_cannot_do_is_refused():
    with pytest.raises(FieldError, match="must be 'free'"):
        scenario_with("spatial", *CYCLE, **{"plant.payload": "welded"})
    with pytest.raises(FieldError, match=r"events\.1\.rest"):
        scenario_with("spatial", CYCLE[0], CYCLE[1].replace(rest="nominal"))
    assert "open and close" in support(scenario_with("spatial", *CYCLE))


# ------------------------------------------------------------ brakes, and events of one's own


@pytest.mark.parametrize(
    ("name", "compliant"),
    [
        *(("planar", False), ("spatial", True)),
        *(pytest.param(*other, marks=pytest.mark.gate) for other in (("planar", True), ("spatial", False))),
    ],
)
def test_brakes_hold_the_joints_and_their_impulse_is_booked(name, compliant):
    """No joint of the arm moves after it; the energy is explained to order four; nothing is booked twice."""
    scenario = anchored(name).replace(events=())
    if compliant:
        scenario = with_grasps(scenario).override({"clock.steps_per_tick": 40 if name == "planar" else 4})
    start = scenario.start
    goal = start.replace(xyz=tuple(np.array(start.xyz) + np.array((0.01, 0.01, 0.0))))
    scenario = scenario.replace(
        duration=0.1,
        motion=cp.motions.LineMotion(start=start, goal=goal, duration=0.1),
        events=(cp.events.LoseArm(time=0.05, arm="right", form="braked"),),
    )
    residuals = []
    for factor in (1, 2):
        steps = factor * scenario.clock.steps_per_tick
        data = cp.run(scenario.override({"clock.steps_per_tick": steps}), warn=False).data
        residuals.append(np.abs(energy_balance(data)).max())
    late = data["time"].values > 0.0501
    assert np.nanmax(np.ptp(data["joint_position"].values[late, 1], axis=0)) < 1e-12
    assert not np.nan_to_num(data["torque"].values[late, 1]).any()
    assert data["work_payload_change"].values[-1] < -1e-5
    assert residuals[0] < 1e-8
    assert residuals[1] < 0.1 * residuals[0]


def test_a_braked_arm_goes_on_from_a_state_and_is_refused_by_batches():
    event = cp.events.LoseArm(time=0.02, arm="right", form="braked")
    scenario = anchored("spatial").replace(events=(event,), duration=0.05)
    sim = simulation_at(scenario, 0.03)
    state = sim.state()
    other = simulation_at(scenario, 0.0)
    other.restore(state)
    for each in (sim, other):
        while not each.is_finished:
            each.tick()
    assert_array_equal(sim.plant.q, other.plant.q)
    assert "lose-arm" in support(scenario)


def let_go(plant, arms, *, arm):
    """Release an arm, and tell no law."""
    plant.release(arms.index(arm))


def test_an_event_of_ones_own_changes_the_plant():
    event = cp.events.UserEvent(time=0.02, target=let_go, options={"arm": "right"})
    scenario = scenario_with("spatial", event, duration=0.04)
    assert scenario.from_toml(scenario.to_toml()).events == (event,)
    data = cp.run(scenario, warn=False).data
    free = data["time"].values > 0.0199
    assert not data["interaction_wrench"].values[free, 1].any()
    assert np.abs(data["interaction_wrench"].values[~free, 1]).min() > 0.0
    assert "user's own" in support(scenario)
    assert "test_rigid_grasps:let_go" in code_of(scenario)
    with pytest.raises(NameNotFoundError, match="no_such"):
        cp.run(scenario.replace(events=(event.replace(target="test_rigid_grasps:no_such"),)), warn=False)
