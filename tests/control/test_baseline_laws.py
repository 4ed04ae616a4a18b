"""Laws of other papers, tick by tick, against their equations written out by hand."""

import numpy as np
import pytest
from close import assert_close
from test_payload_space import inputs

from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.base.spatial import task_rows
from coop_pin.control import ControlledArm
from coop_pin.control.gains import gain_vector
from coop_pin.control.laws.leader_follower import LeaderFollower, LeaderFollowerState
from coop_pin.control.laws.prescribed_performance import PrescribedPerformance
from coop_pin.control.terms import InternalForceIntegral, is_new, spare_torque

ROWS = ["planar", "full"]
PERIOD, SHARES = 0.02, (0.3, 0.7)


def arm_of(rows, name, drives):
    """What the laws may know of an arm."""
    place = ["left", "right"].index(name)
    start, gravity = np.eye(4), np.zeros(3)
    return ControlledArm(name, place == 0, rows, PERIOD, SHARES[place], drives, None, gravity, start, 0)


def controller_of(law, arm):
    """The controller of one arm, built as a scenario's is."""
    return law.build(None, [arm]).controllers[arm.name]


def spare(m, start, stiffness, damping):
    """N^T (-k (q - q_0) - d v) with N = I - J^+ J; the null space of J by its singular vectors."""
    J = m.payload_jacobian
    free = np.linalg.svd(J)[2][len(J) :]
    return free.T @ (free @ (-stiffness * (m.q - start) - damping * m.v))


def test_spare_joints_return_to_where_they_started():
    rows = task_rows("planar")
    (m, _), (square, _) = inputs(rows, 5), inputs(rows, 3)
    start = m.q + 0.1 * np.arange(5.0)
    assert_close(spare_torque(m, start, (7.0, 3.0)), spare(m, start, 7.0, 3.0), atol=1e-12)
    assert_close(spare_torque(square, square.q + 1.0, (7.0, 3.0)), np.zeros(3), atol=0.0)


def test_a_gain_is_one_number_or_one_for_each_row():
    assert gain_vector(2, 3).tolist() == [2.0, 2.0, 2.0]
    assert gain_vector((1.0, 2.0, 3.0), 3).tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(FieldError) as refused:
        PrescribedPerformance(gains={"pose_gain": (1.0, 2.0)}).gains.sized(3, 6)
    assert refused.value.path == "controller.gains.pose_gain"
    with pytest.raises(ScenarioError):
        PrescribedPerformance(gains={"pose_gain": np.nan})


LEADER_FOLLOWER = {
    "pose_gain": 2.0,
    "sliding_gain": 400.0,
    "integral_rate": 5.0,
    "follower_damping": 100.0,
    "follower_stiffness": 500.0,
    "admittance_damping": 50.0,
    "admittance_rate": 50.0,
    "payload_weight": 0.0,
    "spare_gains": (40.0, 8.0),
}


def leader_follower(m, r, state, rows, place, gain):
    """Torque and next state by the equations of the law."""
    k_0, J = rows.size, m.payload_jacobian
    F_d = rows.turn(m.payload_pose, r.internal_wrench) + SHARES[place] * np.broadcast_to(
        gain["payload_weight"], k_0
    )
    V_c = state.velocity
    if place == 0:
        xtilde = rows.pose_error(m.payload_pose, r.pose)
        push = gain["sliding_gain"] * (m.payload_twist - r.twist + gain["pose_gain"] * xtilde)
        rate = gain["integral_rate"] * push
    else:
        if m.interaction_wrench is not None:
            p = np.exp(-gain["admittance_rate"] * PERIOD)
            V_c = p * V_c + (1.0 - p) / gain["admittance_damping"] * (m.interaction_wrench - F_d)
        push = gain["follower_damping"] * (m.payload_twist - V_c)
        rate = gain["follower_stiffness"] * (m.payload_twist - V_c)
    tau = -J.T @ (F_d + push + state.integral) + spare(m, state.start, *gain["spare_gains"])
    moves = not m.saturated.any()
    return tau, state.integral + moves * PERIOD * rate, V_c


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("arm", ["left", "right"])
@pytest.mark.parametrize("stated", [False, True])
def test_leader_and_follower_by_hand(name, arm, stated):
    rows = task_rows(name)
    k_0, rng = rows.size, np.random.default_rng(4)
    options = {}
    if stated:
        options = {key: rng.uniform(0.5, 3.0, k_0) for key in LEADER_FOLLOWER}
        options |= {"integral_rate": 0.7, "admittance_rate": 9.0, "spare_gains": (3.0, 0.4)}
    seated = arm_of(rows, arm, k_0 + 1)
    law, place = (
        controller_of(LeaderFollower(gains={"payload_weight": 0.0} | options), seated),
        int(not seated.leads),
    )
    m, r = inputs(rows, k_0 + 1)
    first = law.init(m, r)
    assert_close(np.concatenate((first.integral, first.velocity)), np.zeros(2 * k_0), atol=0.0)
    assert_close(first.start, m.q, atol=0.0)
    state = LeaderFollowerState(rng.normal(size=k_0), rng.normal(size=k_0), rng.normal(size=k_0 + 1))
    wrench, cut = rng.normal(size=k_0), np.arange(k_0 + 1) == 1
    for change in ({}, {"interaction_wrench": wrench}, {"interaction_wrench": wrench, "saturated": cut}):
        now = m._replace(**change)
        found = law.step(now, r, state)
        tau, integral, velocity = leader_follower(now, r, state, rows, place, LEADER_FOLLOWER | options)
        assert_close(found.torque, tau, atol=1e-9)
        assert_close(found.state.integral, integral, atol=1e-10)
        assert_close(found.state.velocity, velocity, atol=1e-12)
        assert_close(found.state.start, state.start, atol=0.0)


PRESCRIBED = {
    "pose_gain": 1e-3,
    "pose_funnel": 0.2,
    "pose_floor": 0.02,
    "velocity_gain": 2.0,
    "velocity_funnel": 1.0,
    "velocity_floor": 0.2,
    "funnel_rate": 1.0,
    "spare_gains": (40.0, 8.0),
}


def in_funnel(error, rho):
    """r eps / rho, with xi cut at 0.99."""
    xi = np.clip(error / rho, -0.99, 0.99)
    return 2.0 / (1.0 - xi**2) * np.log((1.0 + xi) / (1.0 - xi)) / rho


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("arm", ["left", "right"])
@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("near", [True, False])
def test_prescribed_performance_by_hand(name, arm, stated, near):
    """Near: errors of a tenth of the funnels; otherwise some are beyond them."""
    rows = task_rows(name)
    k_0, rng = rows.size, np.random.default_rng(6)
    options = {}
    if stated:
        options = {key: rng.uniform(0.5, 0.9, k_0) for key in PRESCRIBED}
        options |= {"pose_floor": 0.1, "velocity_floor": 0.3, "funnel_rate": 2.5, "spare_gains": (3.0, 0.4)}
    seated = arm_of(rows, arm, k_0 + 1)
    law, place = controller_of(PrescribedPerformance(gains=options), seated), int(not seated.leads)
    gain = PRESCRIBED | options
    m, r = inputs(rows, k_0 + 1, time=1.7)
    if near:
        pose = m.payload_pose.copy()
        pose[:2, 3] += (0.011, -0.007)
        twist = m.payload_twist
        r = r._replace(pose=pose)
        m = m._replace(payload_twist=0.05 * twist / np.abs(twist).max())
    assert law.init(m, r)[0] == 1.7
    assert_close(law.init(m, r)[1], m.q, atol=0.0)
    state = 0.9, rng.normal(size=k_0 + 1)
    decay = np.exp(-gain["funnel_rate"] * (1.7 - 0.9))
    rho = [
        (np.asarray(gain[f"{of}_funnel"]) - gain[f"{of}_floor"]) * decay + gain[f"{of}_floor"]
        for of in ("pose", "velocity")
    ]
    V_r = -gain["pose_gain"] * in_funnel(rows.pose_error(m.payload_pose, r.pose), rho[0])
    push = gain["velocity_gain"] * in_funnel(m.payload_twist - V_r, rho[1])
    f_d = rows.turn(m.payload_pose, r.internal_wrench)
    tau = -m.payload_jacobian.T @ (SHARES[place] * push + f_d) + spare(m, state[1], *gain["spare_gains"])
    found = law.step(m, r, state)
    assert_close(found.torque, tau, atol=1e-11 * max(1.0, np.abs(tau).max()))
    assert found.state is state


@pytest.mark.parametrize("name", ROWS)
def test_an_integral_of_the_internal_wrench_moves_once_for_each_new_measurement(name):
    rows = task_rows(name)
    m, r = inputs(rows, rows.size)
    loop = InternalForceIntegral(rows, 0.3)
    Z, age = loop.start()
    assert (Z.tolist(), age) == ([0.0] * rows.size, np.inf)
    f_d = rows.turn(m.payload_pose, r.internal_wrench)
    gap = m.internal_wrench + 0.5 - f_d
    state, Z = (np.ones(rows.size), 2.0), np.ones(rows.size)
    for age, moves in ((0.0, 1), (1.0, 0), (2.0, 0), (2.5, 1)):
        now = m._replace(internal_wrench=m.internal_wrench + 0.5, internal_wrench_age=age)
        f_r, state = loop.step(now, r, state)
        Z = Z - moves * 0.3 * gap
        assert_close(f_r, f_d + Z, atol=1e-13)
        assert_close(state[0], Z, atol=1e-13)
        assert state[1] == age
    assert_close(loop.step(m._replace(internal_wrench=None), r, state)[0], f_d, atol=0.0)
    assert [is_new(age, 1.0) for age in (0.0, 1.9, 2.0 - 1e-9, 2.0, 2.1)] == [True, True, False, False, False]


def test_what_the_laws_need():
    assert LeaderFollower().needs == ("own wrench", "role")
    assert PrescribedPerformance().needs == ()
