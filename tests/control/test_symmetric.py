"""The symmetric formulation: absolute and relative pose of arms, on one payload and with two things."""

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.errors import FieldError
from coop_pin.base.spatial import make_pose
from coop_pin.control import ArmMeasurement, PayloadSpace
from coop_pin.feasibility.reachability import reachability
from coop_pin.simulation.build_controller import build_controller
from coop_pin.stability import steady_errors
from coop_pin.stability.forecast import forecast


def law_of(cell, rho, **fields):
    stated = ANCHORED[cell].model_dump(exclude={"kind", "force_path"})
    return {"kind": "symmetric", "relative_gain": rho} | stated | fields


def views(X_d, k_0, drives, rng):
    """Measurements of two arms, each with an error and a twist of its own."""
    planar = k_0 == 3
    shifts = [rng.normal(size=3) * (0.01, 0.01, 0.0 if planar else 0.01) for _ in drives]
    turns = [rng.normal(size=3) * (0.0, 0.0, 0.3) if planar else 0.3 * rng.normal(size=3) for _ in drives]
    seen = []
    for k, shift, turn in zip(drives, shifts, turns, strict=True):
        J = rng.normal(size=(k_0, k)) + 2.0 * np.eye(k_0, k)
        q, v, V = rng.normal(size=k), rng.normal(size=k), rng.normal(size=k_0)
        seen.append(ArmMeasurement(0.0, q, v, placed(X_d, shift, turn), V, J, None, np.zeros(k, dtype=bool)))
    return seen, np.array(shifts), np.array(turns)


def placed(X_d, shift, turn):
    X = make_pose(X_d[:3, 3] + shift)
    X[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ X_d[:3, :3]
    return X


@pytest.mark.parametrize("rho", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_the_torque_is_the_payload_space_law_on_absolute_and_relative_errors_by_hand(cell, rho):
    shares = {"left": 0.3, "right": 0.7}
    scenario = SCENARIOS[cell]().override(
        {"events": [], "cell.load_shares": shares, "controller": law_of(cell, rho)}
    )
    controller = build_controller(scenario)
    fields = ANCHORED[cell].model_dump(exclude={"kind", "force_path"})
    alone = build_controller(scenario.replace(controller=PayloadSpace(**fields)))
    references = cp.Simulation(scenario, controller).references(0.0)
    X_d, drives = references[0].pose, [law.arm.drives for law in alone.controllers.values()]
    seen, shifts, turns = views(X_d, scenario.cell.task_rows.size, drives, np.random.default_rng(3))
    c, V = np.array([[0.3], [0.7]]), np.array([each.payload_twist for each in seen])
    moved = [(c * x).sum(axis=0) + rho * (x - (c * x).sum(axis=0)) for x in (shifts, turns, V)]
    agreed = [
        each._replace(payload_pose=placed(X_d, *pose), payload_twist=twist)
        for each, *pose, twist in zip(seen, *moved, strict=True)
    ]
    state, expected = controller.init(seen, references), alone.init(agreed, references)
    command, by_hand = controller.step(seen, references, state), alone.step(agreed, references, expected)
    assert_allclose(np.concatenate(command.torques), np.concatenate(by_hand.torques), rtol=1e-10)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_rho_moves_no_payload_that_all_hold(cell):
    """The sum of the wrenches of all arms is that of the absolute pose, whatever rho."""
    scenario = SCENARIOS[cell]().override({"events": [], "controller": law_of(cell, 1.0)})
    law = build_controller(scenario)
    references = cp.Simulation(scenario, law).references(0.0)
    drives = [one.arm.drives for one in law.law.controllers.values()]
    k_0 = scenario.cell.task_rows.size
    seen, *_ = views(references[0].pose, k_0, drives, np.random.default_rng(5))
    still, *_ = views(references[0].pose, k_0, drives, np.random.default_rng(6))
    sums = []
    for rho in (0.0, 0.4, 2.0):
        law = build_controller(scenario.override({"controller.relative_gain": rho}))
        command = law.step(seen, references, law.init(still, references))
        wrenches = [
            -np.linalg.pinv(m.payload_jacobian).T @ tau for m, tau in zip(seen, command.torques, strict=True)
        ]
        sums.append(np.sum(wrenches, axis=0))
    assert_allclose(sums[1:], [sums[0]] * 2, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.4, 2.5])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_the_law_takes_the_power_of_its_proof_out_of_two_things(cell, rho):
    """V' = -|e_a'|_K^2 - rho sum_i c_i |e_i' - e_a'|_K^2 on the reference, of a PD."""
    shares, c = {"left": 0.3, "right": 0.7}, np.array([0.3, 0.7])
    law = law_of(cell, rho)
    law["gains"] |= {"sign_gain": 0.0, "leak": 0.0, "anchor_gain": 0.0}
    scenario = SCENARIOS[cell]().override({"events": [], "cell.load_shares": shares, "controller": law})
    controller = build_controller(scenario)
    references = cp.Simulation(scenario, controller).references(0.0)
    references = [
        each._replace(twist=0.0 * each.twist, internal_wrench=0.0 * each.twist) for each in references
    ]
    k_0, rng = scenario.cell.task_rows.size, np.random.default_rng(7)
    seen, *_ = views(references[0].pose, k_0, [k_0, k_0], rng)
    at_rest = [m._replace(payload_pose=references[0].pose, payload_twist=np.zeros(k_0)) for m in seen]
    twists = rng.normal(size=(2, k_0))
    moving = [m._replace(payload_twist=V) for m, V in zip(at_rest, twists, strict=True)]
    command = controller.step(moving, references, controller.init(at_rest, references))
    wrenches = [
        np.linalg.solve(m.payload_jacobian.T, tau) for m, tau in zip(moving, command.torques, strict=True)
    ]
    K = scenario.controller.gains.sized(k_0, k_0).sliding_gain
    V_a, apart = c @ twists, twists - c @ twists
    expected = V_a @ K @ V_a + rho * sum(share * V @ K @ V for share, V in zip(c, apart, strict=True))
    assert_allclose(np.sum(twists * wrenches), -expected, rtol=1e-10)


BIASED = {
    "adept-anchored": {"duration": 3.0},
    "two-pandas-box": {"duration": 3.0, "clock.steps_per_tick": 1},
}


CASES = [("adept-anchored", 5.0, 0.1)]
LONGER = [(name, k_I, rho) for name in BIASED for k_I in (0.0, 5.0) for rho in (1.0, 0.1)]


@pytest.mark.parametrize(
    ("name", "k_I", "rho"),
    [*CASES, *(pytest.param(*each, marks=pytest.mark.slow) for each in LONGER if each not in CASES)],
)
def test_a_bias_leaves_rho_times_the_force_of_arms_by_themselves(name, k_I, rho):
    """rho c gamma K |b_i - bbar| of a PD law; anchored, rho c k_I K gamma |b_i - bbar| / beta."""
    base = cp.Scenario.load(name)
    gains = base.controller.gains.replace(sign_gain=0.05 * k_I, leak=0.0, anchor_gain=0.1 if k_I else 0.0)
    path = {"kind": "late" if k_I else "none"}
    law = {"kind": "symmetric", "relative_gain": rho, "gains": gains.model_dump(), "force_path": path}
    hold = {"motion": {"kind": "hold", "pose": base.start.model_dump()}, "controller": law, "events": []}
    biased = {"cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
    scenario = base.override(hold | BIASED[name] | biased)
    data = cp.run(scenario, warn=False, engine="compiled").data
    off = np.nan_to_num((data.internal_wrench - data.desired_internal_wrench).values[-1, 0, :3])
    K, gamma, beta = gains.sliding_gain[0], gains.pose_gain, 0.1 * base.clock.rate_hz
    expected = rho * 0.5 * K * gamma * 0.5e-3 * (k_I / beta if k_I else 1.0)
    assert_allclose(np.linalg.norm(off), expected, rtol=0.01, atol=1e-3)
    assert_allclose(steady_errors(scenario, bias=1e-3).force, expected, rtol=1e-9)


def test_errors_at_rest_scale_with_rho_and_so_do_the_biases_that_the_anchor_bears():
    base = cp.Scenario.load("adept-anchored").override({"events": []})
    fields = base.controller.model_dump(exclude={"kind"})
    alone = steady_errors(base, bias=1e-3)
    law = {"kind": "symmetric", "relative_gain": 0.25} | fields
    found = steady_errors(base.override({"controller": law}), bias=1e-3)
    assert_allclose([found.force, found.sag], [0.25 * alone.force, alone.sag], rtol=1e-9)
    assert_allclose([found.limit, found.free], [4.0 * alone.limit, 4.0 * alone.free], rtol=1e-9)
    at_zero = steady_errors(base.override({"controller": law | {"relative_gain": 0.0}}), bias=1e-3)
    assert at_zero.force == 0.0
    assert at_zero.product == 0.0
    assert "poses" in at_zero.needs


def test_messages_and_deflections_are_refused_by_name():
    base = cp.Scenario.load("adept-anchored")
    law = {"kind": "symmetric"} | base.controller.model_dump(exclude={"kind"})
    with pytest.raises(FieldError, match="mean-pose"):
        build_controller(base.override({"controller": law, "network": {}}))
    with pytest.raises(FieldError) as refused:
        cp.laws.Symmetric(gains=base.controller.gains, knows_deflection=True)
    assert refused.value.path.endswith("knows_deflection")
    scenario = base.override({"controller": law})
    assert "not for 'symmetric'" in forecast(scenario, reachability(scenario, poses=5)).summary()
