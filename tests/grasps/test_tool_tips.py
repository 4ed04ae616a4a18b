"""Arms with two things: a payload that one holds, and a tool of the other beside it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tool_cells import NAMES, RATES, tool_pose, two_things, with_gains

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, InfeasibleMotionError, ScenarioError
from coop_pin.compiled.kind import pinocchio_reason
from coop_pin.description.cell.grasp import ToolTip
from coop_pin.design.grasp_gains import with_tool_gains
from coop_pin.feasibility import reachability
from coop_pin.grasps import CellChain
from coop_pin.model import CellArm
from coop_pin.reference.motions import CircleMotion, SwingMotion
from coop_pin.reference.pose_reference import PoseReference, check_consistency
from coop_pin.simulation.build_controller import build_controller
from coop_pin.stability import eigenvalues, steady_errors
from coop_pin.stability.modes import damping_ratio
from coop_pin.stability.sampled_motion import tick_matrix
from coop_pin.stability.sampled_stability import sampled_stability

SHORT = {"planar": 1.2, "spatial": 0.4}
FAST = {"planar": 6.0, "spatial": 20.0}
FORCE = 0.05


def pushed(cell, rho, duration, **gains):
    """Largest stiffness of single arms, without integral; a push on the payload from the start on."""
    scenario = with_gains(two_things(cell, rho=rho), sign_gain=0.0, **gains)
    push = {"kind": "wrench-pulse", "time": 0.0, "duration": duration, "wrench": [0.0, FORCE, 0, 0, 0, 0]}
    return scenario.override({"events": [push], "duration": duration})


def stiffness_of_holder(scenario):
    """Gamma G_1 in world axes on the task rows at the start, shape (k_0, k_0)."""
    gains = scenario.controller.arm_gains["left"].sized(scenario.cell.task_rows.size, 0)
    R = scenario.start.matrix[:3, :3]
    turn = np.kron(np.eye(2), R)[np.ix_(scenario.cell.task_rows.indices, scenario.cell.task_rows.indices)]
    return 0.5 * gains.pose_gain[0, 0] * turn @ gains.sliding_gain @ turn.T


BOTH = ["planar", pytest.param("spatial", marks=pytest.mark.slow)]
LONGER = [pytest.param("planar", 1.0, marks=pytest.mark.slow), ("planar", 3.0)]


@pytest.mark.parametrize(("cell", "rho"), [*LONGER, pytest.param("spatial", 2.0, marks=pytest.mark.slow)])
def test_a_push_on_the_payload_leaves_a_relative_error_that_falls_with_rho(cell, rho):
    """At rest G_1 gamma (e_a + rho (e_1 - e_a)) = F, e_a + rho (e_2 - e_a) = 0: e_2 - e_1 = -e / rho."""
    scenario = pushed(cell, rho, SHORT[cell], pose_gain=FAST[cell])
    result = cp.run(scenario, warn=False)
    rows = list(scenario.cell.task_rows.indices)
    e = np.zeros(6)
    e[rows] = np.linalg.solve(stiffness_of_holder(scenario), np.array((0, FORCE, 0, 0, 0, 0.0))[rows])
    e_1 = e * (1.0 + 1.0 / rho) / 2.0
    assert_allclose(result.data.pose_error.values[-1], e_1, atol=0.02 * np.abs(e).max())
    shown, X_PE = result.data.relative_error.values[-1], tool_pose(result)
    grasp = scenario.cell.grasps["right"].matrix
    assert_allclose(shown[1, :3], (X_PE - grasp)[:3, 3], atol=1e-9)
    assert_allclose(shown[0], 0.0, atol=1e-9)
    r = scenario.start.matrix[:3, :3] @ grasp[:3, 3]
    at_tip = -(e[:3] + np.cross(e[3:], r)) / rho
    assert_allclose(scenario.start.matrix[:3, :3] @ shown[1, :3], at_tip, atol=0.03 * np.abs(at_tip).max())
    metrics = result.metrics()
    assert metrics["relative_position_error_max_m"] >= np.linalg.norm(shown[1, :3])
    assert metrics["simulation_sound"] == 1.0
    assert np.all(result.data.internal_wrench.fillna(0.0) == 0.0)
    assert abs(metrics["energy_balance_max_J"]) < 1e-6
    thinned = cp.run(scenario.override({"clock.record_every": 7}), warn=False).metrics()
    for name in ("relative_position_error_max_m", "absolute_position_error_max_m"):
        assert_allclose(thinned[name], metrics[name], rtol=1e-12)


def sampled_rates(lam, gamma, T):
    """Decays of x+ = x + T v - (T^2/2) lam (v + gamma x), v+ = v - T lam (v + gamma x), 1/s, slow first."""
    A = np.array(
        [[1.0 - T * T * lam * gamma / 2.0, T - T * T * lam / 2.0], [-T * lam * gamma, 1.0 - T * lam]]
    )
    return np.sort(-np.log(np.abs(np.linalg.eigvals(A))) / T)


@pytest.mark.parametrize("cell", NAMES)
def test_absolute_and_relative_errors_decay_at_the_rates_of_their_gains(cell):
    """With gains kappa / (T rho) Lambda_i both motions decouple, at kappa / (T rho) and kappa / T."""
    rho, light = 2.0, {"cell.payload.mass": 1e-5, "cell.payload.inertia": [1e-8] * 3 + [0.0] * 3}
    T, kappa = 1.0 / RATES[cell], 0.5
    stated = two_things(cell, rho=rho, **light)
    gamma = 0.15 * kappa / (T * rho)
    scenario = with_gains(stated, sign_gain=0.0, pose_gain=gamma)
    scenario = scenario.override({"controller.posture": {"stiffness": 0.0, "damping": 0.0}})
    assert_allclose(sampled_stability(scenario).value, kappa, rtol=1e-3)
    found = np.array([mode.rate for mode in eigenvalues(scenario).modes])
    slow_a, slow_r = (sampled_rates(lam, gamma, T)[0] for lam in (kappa / (T * rho), kappa / T))
    assert abs(slow_a - slow_r) > 0.08 * slow_r
    for rate in (slow_a, slow_r):
        assert np.sum(np.abs(found - rate) < 0.05 * rate) >= scenario.cell.task_rows.size


def both_moving(cell: str, rho: float, **changes) -> cp.Scenario:
    """Part and tool on circles of 1 cm, at 6 and, on the part, at 9 rad/s; a PD of single arms' inertia."""
    base = two_things(cell)
    grasp = base.cell.grasps["right"]
    tip = {"xyz": grasp.xyz, "rpy": grasp.rpy}
    circles = [
        {"kind": "circle", "pose": pose, "radius": 0.01, "angular_rate": rate, "ramp": 0.3}
        for pose, rate in ((base.start.model_dump(), 6.0), (tip, 9.0))
    ]
    stated = two_things(cell, rho=rho, motion=circles[1], **changes)
    slowest = 0.5 * RATES[cell] * min(1.0, rho) / max(1.0, rho)
    scenario = with_gains(stated, sign_gain=0.0, pose_gain=0.1 * slowest)
    still = {"controller.posture": {"stiffness": 0.0, "damping": 0.0}}
    return scenario.override(still | {"motion": circles[0], "duration": 1.0})


def accelerations(scenario: cp.Scenario, times) -> np.ndarray:
    """Desired accelerations of the two payload frames, shape (n, 2, 6)."""
    tool, motion = scenario.cell.tools["right"], scenario.motion
    parts = [motion.at(float(t)) for t in times]
    return np.array(
        [(part.A_WP_d, tool.carried(part, float(t)).A_WP_d) for part, t in zip(parts, times, strict=True)]
    )


def tracked(scenario: cp.Scenario, times) -> np.ndarray:
    """Errors of L_i (e_i'' + a_i) = -c_i K_i [s_a + rho (s_i - s_a)] by small steps, shape (n, 2, k_0)."""
    rows, cell, rho = list(scenario.cell.task_rows.indices), scenario.cell, scenario.controller.relative_gain
    chain = CellChain(cell, scenario.plant)
    q, R = chain.configuration(scenario.start.matrix), scenario.start.matrix[:3, :3]
    turn = np.kron(np.eye(2), R)[np.ix_(rows, rows)]
    L, G = [], []
    for arm, slot in zip(chain.arms, chain.model.arms, strict=True):
        J = arm.payload_jacobian(q[slot.q_slice])[rows]
        L.append(np.linalg.inv(J @ np.linalg.solve(arm.mass_matrix(q[slot.q_slice]), J.T)))
        gains = scenario.controller.arm_gains[arm.name].sized(len(rows), 0)
        G.append(0.5 * turn @ gains.sliding_gain @ turn.T)
        gamma = float(gains.pose_gain[0, 0])
    body = np.diag([cell.payload.mass] * 3 + [0.0] * 3)
    body[3:, 3:] = R @ cell.payload.inertia_matrix @ R.T
    L[0] = L[0] + body[np.ix_(rows, rows)]
    lead = [np.linalg.solve(L_i, G_i) for L_i, G_i in zip(L, G, strict=True)]
    e, v, errors, n = np.zeros((2, len(rows))), np.zeros((2, len(rows))), [], 20
    h = (times[1] - times[0]) / n
    for a in accelerations(scenario, times)[:, :, rows]:
        errors.append(e.copy())
        for _ in range(n):
            s = v + gamma * e
            s = s.mean(axis=0) + rho * (s - s.mean(axis=0))
            v = v - h * (a + np.array([each @ s_i for each, s_i in zip(lead, s, strict=True)]))
            e = e + h * v
    return np.array(errors)


@pytest.mark.parametrize("rho", [0.5, 2.0])
@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_a_part_and_a_tool_that_move_are_tracked_as_their_linear_loops_say(cell, rho):
    scenario = both_moving(cell, rho)
    result = cp.run(scenario, warn=False)
    data, rows = result.data, list(scenario.cell.task_rows.indices)
    e = np.zeros((len(data.time), 2, 6))
    e[:, :, rows] = tracked(scenario, data.time.values)
    assert_allclose(data.pose_error.values, e[:, 0], atol=0.15 * np.abs(e[:, 0]).max())
    R, grasp = scenario.start.matrix[:3, :3], scenario.cell.grasps["right"].matrix
    apart = e[:, 1] - e[:, 0]
    at_tip = (apart[:, :3] + np.cross(apart[:, 3:], R @ grasp[:3, 3])) @ R
    shown = data.relative_error.values[:, 1, :3]
    assert np.abs(at_tip).max() > 1e-4
    assert_allclose(shown, at_tip, atol=0.15 * np.abs(at_tip).max())


@pytest.mark.parametrize("rho", [0.5, 2.0])
@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_errors_of_a_light_part_and_a_tool_that_move_stay_below_their_bound(cell, rho):
    """From rest ``|e| <= max |a| / (lambda gamma)`` where lambda >= 4 gamma: a response that is positive."""
    light = {"cell.payload.mass": 1e-5, "cell.payload.inertia": [1e-8] * 3 + [0.0] * 3}
    scenario = both_moving(cell, rho, **light)
    data = cp.run(scenario, warn=False).data
    a = accelerations(scenario, data.time.values)[:, :, :3]
    gamma = scenario.controller.gains.pose_gain
    rates = {"absolute": 0.5 * RATES[cell] / max(1.0, rho)}
    rates["relative"] = rho * rates["absolute"]
    for name, motion in (("absolute", a.mean(axis=1)), ("relative", a[:, 1] - a[:, 0])):
        bound = np.linalg.norm(motion, axis=1).max() / (rates[name] * gamma)
        errors = data[f"{name}_error"].values.reshape(len(a), -1, 6)[:, -1, :3]
        assert rates[name] >= 4.0 * gamma
        assert 0.3 * bound < np.linalg.norm(errors, axis=1).max() < 1.01 * bound  # arms turn as they move


class Seen(PoseReference):
    """Motion of the payload as the arm with a tool is to see it."""

    kind: str = "seen"
    tool: ToolTip
    payload: SwingMotion

    def at(self, time):
        return self.tool.carried(self.payload.at(time), time)


def test_the_frame_that_a_tool_carries_moves_as_its_twist_and_acceleration_say():
    pose = cp.Pose(xyz=(0.1, -0.2, 0.05), rpy=(0.4, -0.3, 0.9))
    circle = CircleMotion(pose=pose, radius=0.05, angular_rate=2.0, normal=(1.0, 2.0, 0.5))
    start = cp.Pose(xyz=(0.3, 0.1, 0.4), rpy=(-0.2, 0.5, 0.1))
    swing = SwingMotion(pose=start, axis=(0.3, 1.0, -0.4), amplitude=0.6, period=1.5)
    tool = ToolTip(xyz=pose.xyz, rpy=pose.rpy, motion=circle)
    gaps = check_consistency(Seen(tool=tool, payload=swing), np.linspace(0.1, 2.9, 15))
    assert max(gaps) < 1e-4
    X, X_r = swing.at(1.3).X_WP_d, circle.at(1.3).X_WP_d
    carried = Seen(tool=tool, payload=swing).at(1.3).X_WP_d
    assert_allclose(carried @ pose.matrix, X @ X_r, atol=1e-12)
    turning = ToolTip(xyz=pose.xyz, rpy=pose.rpy, motion=swing.replace(pose=pose))
    assert max(check_consistency(Seen(tool=turning, payload=swing), np.linspace(0.1, 2.9, 15))) < 1e-4


@pytest.mark.parametrize("cell", BOTH)
def test_the_tool_follows_its_motion_on_the_payload_and_the_replay_shows_it(cell, tmp_path):
    grasp = cp.Scenario.load(NAMES[cell]).cell.grasps["right"]
    circle = {"kind": "circle", "pose": grasp.model_dump(), "radius": 0.01, "angular_rate": 6.0, "ramp": 0.2}
    scenario = with_gains(two_things(cell, motion=circle), leak=0.0).override({"duration": SHORT[cell]})
    result = cp.run(scenario, warn=False)
    end = float(result.data.time[-1])
    X_PE_d = scenario.cell.tools["right"].motion.at(end).X_WP_d
    assert np.linalg.norm((X_PE_d - grasp.matrix)[:3, 3]) > 3e-3
    assert_allclose(tool_pose(result)[:3, 3], X_PE_d[:3, 3], atol=1e-3)
    assert_allclose(result.data.pose_error.values[-1], 0.0, atol=1e-3)
    cp.viz.save_replay(result, tmp_path / "run.html")
    assert (tmp_path / "run.html").stat().st_size > 1e5


def test_what_tools_cannot_have_is_refused_by_name():
    scenario = two_things("planar")
    assert "tools" in pinocchio_reason(scenario)
    with pytest.raises(ScenarioError, match="tool"):
        scenario.override({"events": [{"kind": "release", "time": 0.1, "arm": "right"}]})
    with pytest.raises(ScenarioError, match="last arm"):
        scenario.override({"events": [{"kind": "release", "time": 0.1, "arm": "left"}]})
    left = {"kind": "tool", **scenario.cell.grasps["left"].model_dump()}
    with pytest.raises(ScenarioError, match="tools"):
        scenario.override({"cell.grasps.left": left})
    with pytest.raises(ScenarioError, match="joints"):
        ToolTip(motion={"kind": "joints", "path": "angles.csv"})
    for kind in ("mean-pose", "leader-follower", "computed-torque"):
        gains = scenario.controller.gains.model_dump() if kind == "mean-pose" else {}
        with pytest.raises(FieldError, match="symmetric"):
            build_controller(scenario.override({"controller": {"kind": kind, "gains": gains}}))
    with pytest.raises(ArgumentError, match="tools"):
        steady_errors(scenario)
    with pytest.raises(ArgumentError, match="tools"):
        scenario.cell.require_rigid("this")
    assert not scenario.cell.rigid.tools
    with pytest.raises(InfeasibleMotionError, match="relative_gain"):
        cp.suggest(two_things("planar", rho=0.0), poses=5)


@pytest.mark.parametrize("cell", BOTH)
def test_gains_of_single_arms_hold_where_those_of_the_cell_do_not(cell):
    """Arms are lighter alone than together with a payload that both hold."""
    stated = two_things(cell)
    of_cell = stated.override(
        {
            "controller": {
                "kind": "symmetric",
                "gains": cp.Scenario.load(NAMES[cell]).controller.gains.model_dump(),
            }
        }
    )
    suggested = cp.suggest(stated, poses=5)
    assert suggested.changes == ()
    assert "each arm alone" in suggested.summary()
    assert "((" not in suggested.summary()
    alone, together = sampled_stability(suggested.scenario), sampled_stability(of_cell)
    assert alone.value < 1.0
    assert together.value > 3.0 * alone.value
    report = cp.check(suggested.scenario, poses=5)
    assert not report.of("error"), report.summary()
    assert "beside tools" in report.summary()


@pytest.mark.parametrize("rho", [0.5, 2.0])
@pytest.mark.parametrize("cell", NAMES)
@pytest.mark.parametrize("lag", [0.0, 0.8])
def test_proposed_gains_are_parts_of_each_arms_inertia(cell, rho, lag):
    """G_i = kappa / (T max(1, rho)) Lambda_i at the start; k_I and gamma by the damping of their modes."""
    scenario = two_things(cell, rho=rho, **{"actuators.lag": lag / RATES[cell]})
    proposed, _ = with_tool_gains(scenario, reachability(scenario, poses=3))
    law, T, payload = proposed.controller, scenario.clock.period, scenario.cell.payload
    rows, kappa = list(scenario.cell.task_rows.indices), 0.5 / (1.0 + 2.0 * lag)
    Q = np.kron(np.eye(2), scenario.start.matrix[:3, :3])[np.ix_(rows, rows)]
    spread, held = [], []
    for name, c in zip(scenario.cell.arms, scenario.cell.gain_shares, strict=True):
        arm = CellArm(scenario.cell, name)
        q = cp.solve_ik(arm, scenario.start.matrix, posture=scenario.cell.arms[name].posture)
        J = arm.rows.select(arm.payload_jacobian(q))
        Lambda = Q.T @ np.linalg.inv(J @ np.linalg.solve(arm.mass_matrix(q), J.T)) @ Q
        G = c * np.array(law.arm_gains[name].sliding_gain)
        spread.append(T * max(1.0, rho) * np.linalg.solve(Lambda, G))
        if name not in scenario.cell.tools:
            M_0 = np.zeros((6, 6))
            M_0[:3, :3], M_0[3:, 3:] = payload.mass * np.eye(3), payload.inertia_matrix
            held = np.linalg.eigvals(np.linalg.solve(M_0[np.ix_(rows, rows)] + Lambda, G)).real
    of_arms = spread[0][0, 0]
    assert 0.99 * kappa < of_arms <= kappa * (1.0 + 1e-9)
    assert_allclose(spread, np.broadcast_to(of_arms * np.eye(len(rows)), np.shape(spread)), atol=2e-3 * kappa)
    gains, slowest, fastest = law.gains, min(held) * min(1.0, rho), of_arms / T
    gamma, k_I = float(np.max(gains.pose_gain)), np.max(gains.sign_gain) / law.switching.width
    assert_allclose(k_I / gamma, 4.0, rtol=0.02)
    assert gamma <= 0.1 * slowest
    by_motion = [T * rate * np.array([[T * gamma, 1.0]]) for rate in np.geomspace(slowest, fastest, 12)]
    ticks = [tick_matrix(-part, -T * k_I * part, 1.0, lag=lag) for part in by_motion]
    least = min(damping_ratio(z) for tick in ticks for z in np.linalg.eigvals(tick))
    assert least >= 0.58 - 1e-3
    assert gamma > 0.098 * slowest or least < 0.6
    assert gains.transient_rate == pytest.approx(2.0 * gamma)
    assert {one.leak for one in law.arm_gains.values()} == {0.0}  # nothing to pull against
