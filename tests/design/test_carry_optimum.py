"""Planned carries against optima that share no code with them: collocation by CasADi and IPOPT."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp

ca = pytest.importorskip("casadi")

LIMITS = np.array([75.0, 50.0, 12.5])
RESERVE, SQUEEZE = 0.05, 10.0
L_1, L_2, M_2, M_3, R_2, I_1, I_2, I_3, I_C = 0.425, 0.375, 15.0, 5.0, 0.165, 1.1, 0.3, 0.01, 0.57
VISCOUS, COULOMB, COULOMB_SPEED = np.array([1.35, 1.26, 1.215]), 0.01, 0.05
MASS, LENGTH = 11.2, 0.24
BASES, SIDES = (0.0, 1.0), (-1.0, 1.0)


def scenario():
    limits = {f"cell.arms.{arm}.torque_limits": tuple(LIMITS) for arm in ("left", "right")}
    fast = {"events": (), "clock.rate_hz": 1000.0, "clock.steps_per_tick": 1}
    return cp.Scenario.load("adept-anchored", fast | limits)


LINES = ["adept", "across", "up", "shift"]


def line_of(name):
    if name == "up":
        return cp.Pose(xyz=(0.5, 0.35, 0.0), rpy=(0, 0, 0.2)), cp.Pose(xyz=(0.5, 0.62, 0.0), rpy=(0, 0, 0.5))
    if name == "shift":
        return cp.Pose(xyz=(0.35, 0.4, 0.0)), cp.Pose(xyz=(0.65, 0.5, 0.0), rpy=(0, 0, 0.3))
    if name == "across":
        end = (0.45, 0.45 - np.sqrt(0.24), 0.0)
        return cp.Pose(xyz=(0.55, 0.45, 0.0), rpy=(0, 0, 0.1)), cp.Pose(xyz=end, rpy=(0, 0, 0.1 + np.pi / 3))
    start = scenario().start
    way = 0.5 * np.array([np.cos(-np.pi / 3), np.sin(-np.pi / 3), 0.0])
    return start, cp.Pose(xyz=np.add(start.xyz, way), rpy=(0.0, 0.0, start.rpy[2] - np.pi / 3))


def planar(pose):
    return np.array([pose.xyz[0], pose.xyz[1], pose.rpy[2]])


def arm_torques(X, base, side, rates):
    """Torques of one arm of the paper by its printed matrices, with absolute link angles."""
    s, v, u, way = rates
    offset = side * LENGTH / 2.0
    x, y = X[0] + offset * ca.cos(X[2]) - base, X[1] + offset * ca.sin(X[2])
    elbow = side * ca.acos((x * x + y * y - L_1**2 - L_2**2) / (2.0 * L_1 * L_2))
    q_1 = ca.atan2(y, x) - ca.atan2(L_2 * ca.sin(elbow), L_1 + L_2 * ca.cos(elbow))
    q = ca.vertcat(q_1, q_1 + elbow, X[2] - q_1 - elbow)
    q_s = ca.jacobian(q, s)
    qd, qdd = q_s * v, q_s * u + ca.jacobian(q_s, s) * v**2
    a, b = I_1 + (M_2 + M_3) * L_1**2, M_2 * L_1 * R_2 + M_3 * L_1 * L_2
    c = I_C + I_2 + I_3 + M_2 * R_2**2 + M_3 * L_2**2
    cos, sin = b * ca.cos(q[1] - q[0]), b * ca.sin(q[1] - q[0])
    M = ca.vertcat(ca.horzcat(a, cos, 0), ca.horzcat(cos, c, I_3), ca.horzcat(0, I_3, I_3))
    h = ca.vertcat(-sin * qd[1] ** 2, sin * qd[0] ** 2, 0)
    h += VISCOUS * qd + COULOMB * ca.tanh(qd / COULOMB_SPEED)
    J = ca.vertcat(
        ca.horzcat(-L_1 * ca.sin(q[0]), offset * ca.sin(X[2]) - L_2 * ca.sin(q[1]), offset * ca.sin(X[2])),
        ca.horzcat(L_1 * ca.cos(q[0]), L_2 * ca.cos(q[1]) - offset * ca.cos(X[2]), -offset * ca.cos(X[2])),
        ca.horzcat(0, 1, 1),
    )
    inertia = ca.vertcat(MASS, MASS, MASS * LENGTH**2 / 12.0)
    F = -0.5 * inertia * way * u + side * SQUEEZE * ca.vertcat(ca.cos(X[2]), ca.sin(X[2]), 0)
    return M @ qdd + h - J.T @ F


def torques(start, way):
    """All torques as a function of s, s' and s''."""
    s, v, u = ca.SX.sym("s"), ca.SX.sym("v"), ca.SX.sym("u")
    X = start + way * s
    parts = [arm_torques(X, base, side, (s, v, u, way)) for base, side in zip(BASES, SIDES, strict=True)]
    return ca.Function("torques", [s, v, u], [ca.vertcat(*parts)])


def optimum(name, duration=None, *, pieces=24, inside=8):
    """Least effort of a duration with s'' linear on pieces and 0 at both ends, or the least time."""
    start, goal = map(planar, line_of(name))
    tau, problem, N = torques(start, goal - start), ca.Opti(), pieces * inside
    T = problem.variable() if duration is None else duration
    s, v, knots, step = problem.variable(N + 1), problem.variable(N + 1), problem.variable(pieces + 1), T / N
    parts = [(k // inside, (k % inside) / inside) for k in range(N)] + [(pieces, 0.0)]
    u = [knots[i] * (1 - r) + (knots[i + 1] * r if r else 0.0) for i, r in parts]
    each, limit, effort = (
        [tau(s[k], v[k], u[k]) for k in range(N + 1)],
        np.tile(LIMITS, 2) * (1 - RESERVE),
        0.0,
    )
    for k in range(N):
        problem.subject_to(v[k + 1] == v[k] + step * (u[k] + u[k + 1]) / 2)
        problem.subject_to(s[k + 1] == s[k] + step * v[k] + step**2 * (2 * u[k] + u[k + 1]) / 6)
        effort += step * (ca.sumsqr(each[k]) + ca.sumsqr(each[k + 1])) / 2
    for torque in each:
        problem.subject_to(problem.bounded(-limit, torque, limit))
    ends = [(s[0], 0), (v[0], 0), (s[N], 1), (v[N], 0)]
    if duration is not None:
        ends += [(knots[0], 0), (knots[pieces], 0)]
    for value, end in ends:
        problem.subject_to(value == end)
    problem.subject_to(v >= 0)
    problem.subject_to(problem.bounded(0, s, 1))
    g, first = np.linspace(0, 1, N + 1), duration or 1.3
    problem.set_initial(s, 10 * g**3 - 15 * g**4 + 6 * g**5)
    problem.set_initial(v, (30 * g**2 - 60 * g**3 + 30 * g**4) / first)
    if duration is None:
        problem.set_initial(T, first)
        problem.subject_to(problem.bounded(0.2, T, 5.0))
    problem.minimize(T if duration is None else effort)
    problem.solver("ipopt", {"print_time": 0}, {"print_level": 0, "max_iter": 800, "tol": 1e-9})
    solution = problem.solve()
    return float(solution.value(T if duration is None else effort))


@pytest.mark.slow
@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("duration", [1.2, 2.0])
def test_least_effort_is_within_two_per_cent_of_the_optimum(name, duration):
    """s'' of the optimum is linear on 50 ms pieces; ours may be less, its pieces are shorter."""
    cell = scenario()
    plan = cp.carry.plan_carry(
        cell.cell, *line_of(name), squeeze=cell.squeeze, smoothing=0.03, duration=duration
    )
    least = optimum(name, duration, pieces=round(duration / 0.05))
    assert 0.96 * least < plan.effort < 1.02 * least
    finer = optimum(name, duration, pieces=min(round(duration / 0.03), 60), inside=4)
    assert_allclose(plan.effort, finer, rtol=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", LINES)
def test_least_time_is_within_one_per_cent_of_the_optimum(name):
    """With 1 ms of smoothing, which costs 2 ms; the optimum has one piece a sample, 240 of them."""
    cell = scenario()
    plan = cp.carry.plan_carry(cell.cell, *line_of(name), squeeze=cell.squeeze, smoothing=0.001, places=401)
    assert_allclose(plan.duration, optimum(name, pieces=240, inside=1), rtol=0.01)
