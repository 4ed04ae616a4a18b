"""Changes of wrenches on loaded grasps against differences of the plant, and the squeeze that they bear."""

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS

import coop_pin as cp
from coop_pin.base.spatial import pose_error, shift_wrench
from coop_pin.feasibility import reachability
from coop_pin.laws import build_controller
from coop_pin.stability import eigenvalues
from coop_pin.stability.loaded_grasps import changes_under_load, give_way
from coop_pin.stability.motion_loop import MotionLoop

SOFT = (2e4, 1.5e4, 1e4, 300.0, 200.0, 100.0)


def loaded(name):
    """Chain of a cell, and a configuration in which its grasps bear some 100 N, or a squeeze of 60 N."""
    if name == "palms":
        scenario = cp.Scenario.load("two-pandas-palms", {"events": ()})
    else:
        cell = SCENARIOS[name]().cell
        grasps = {
            arm: cp.CompliantGrasp(xyz=grasp.xyz, rpy=grasp.rpy, stiffness=SOFT)
            for arm, grasp in cell.grasps.items()
        }
        scenario = SCENARIOS[name]().override({"cell.grasps": grasps, "events": ()})
    run = cp.Simulation(scenario, build_controller(scenario))
    chain, q = run.chain, run.plant.q
    by = [0.0] * 6 if name == "palms" else [4e-3, -3e-3, 2e-3 * (name == "spatial"), 0.0, 0.0, 0.0]
    return (
        scenario.cell,
        chain,
        pin.integrate(chain.mechanism.model, q, np.append(np.zeros(len(run.plant.v) - 6), by)),
    )


@pytest.mark.parametrize("name", [*SCENARIOS, "palms"])
def test_wrenches_of_loaded_grasps_turn_as_those_of_the_plant(name):
    """While the arms stand still, dW_i = (K + T - L - S) x of the payload, about its P."""
    cell, chain, q = loaded(name)
    rows, model = cell.task_rows, chain.mechanism.model
    X_WP, still, h = chain.payload_pose(q), np.zeros(model.nv), 1e-6

    def wrenches(at):
        if cell.patches:
            on_arms = chain.patches.at(at, still).on_bodies[: len(cell.arms)]
        else:
            on_arms = chain.springs.at(at, still).on_body
        return np.array([rows.select(shift_wrench(each, -chain.payload_pose(at)[:3, 3])) for each in on_arms])

    dx, dW = [], []
    for step in h * np.eye(model.nv)[-6:][list(rows.indices)]:
        a, b = pin.integrate(model, q, step), pin.integrate(model, q, -step)
        dx.append(rows.select(pose_error(chain.payload_pose(a), chain.payload_pose(b))))
        dW.append(wrenches(a) - wrenches(b))
    by_pose = np.einsum("kj,jmi->mik", np.linalg.inv(dx), np.array(dW))

    W, controlled = wrenches(q), np.ix_(rows.indices, rows.indices)
    K = np.array([np.linalg.inv(cell.compliance(arm))[controlled] for arm in cell.arms])
    Q = np.array([rows.turn(X_WP, row) for row in np.eye(rows.size)]).T
    _, r, K = give_way(cell, K, W @ Q)
    T, L, S = changes_under_load(rows, W, r @ X_WP[:3, :3].T)
    by_load = by_pose - Q @ K @ Q.T
    tips = (chain.tip_positions(q) - X_WP[:3, 3]) @ X_WP[:3, :3]
    assert np.abs(r - tips)[:, [k for k in rows.indices if k < 3]].max() < 1e-7
    assert np.abs(by_load).max() > 50.0
    assert np.abs(by_load - (T - L - S)).max() < 0.05 * np.abs(by_load).max()


@pytest.mark.gate
def test_growth_by_the_squeeze_is_that_of_the_linearised_tick():
    """Two palms of the catalogue hold 60 N; at 120 N they push each other sidewards."""
    for part, is_stable in ((1.0, True), (2.0, False)):
        scenario = cp.Scenario.load("two-pandas-palms", {"events": ()})
        scenario = scenario.replace(squeeze=scenario.squeeze.scaled(part))
        growth = MotionLoop(scenario, reachability(scenario, poses=5)).growth()
        tick = (eigenvalues(scenario).radius - 1.0) / scenario.clock.period
        assert (growth < 0.0) == is_stable
        assert growth == pytest.approx(tick, rel=0.05, abs=0.05)
