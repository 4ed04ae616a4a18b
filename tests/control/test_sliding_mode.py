"""Law (23): every sum by hand, the sampled-time conventions, and the closed loop on both cells."""

import numpy as np
import pytest
from cells import SCENARIOS, arm_of
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, SingularJacobianError
from coop_pin.base.spatial import make_pose, pose_error, task_rows
from coop_pin.control import (
    ArmMeasurement,
    ArmReference,
    Saturation,
    Sign,
    SlidingModeController,
    SlidingModeGains,
    Tanh,
)
from coop_pin.control.terms import jacobian_inverse
from coop_pin.simulation.build_controller import build_controller

PERIOD = 0.0125


def controller(rows, force_gain=0.7):
    k = rows.size
    rng = np.random.default_rng(3)
    gamma = np.diag(rng.uniform(1, 3, k))
    damping = rng.normal(size=(k, k))
    gains = SlidingModeGains(
        pose_gain=gamma,
        sign_gain=np.diag(rng.uniform(0.1, 1, k)),
        damping_gain=damping @ damping.T + np.eye(k),
        force_gain=force_gain,
        transient_rate=5.0,
    )
    return SlidingModeController(arm_of(rows, PERIOD), gains.sized(k, k), Sign())


def inputs(rows, time, seed, force=True):
    rng = np.random.default_rng(seed)
    k = rows.size
    turn = lambda: rng.normal(size=3) * 0.3 if rows.name == "full" else (0, 0, rng.normal())  # noqa: E731
    place = lambda: rng.normal(size=3) * (1 if rows.name == "full" else np.array([1, 1, 0]))  # noqa: E731
    J, v = rng.normal(size=(k, k)) + 2 * np.eye(k), rng.normal(size=k)
    measurement = ArmMeasurement(
        time,
        rng.normal(size=k),
        v,
        make_pose(place(), turn()),
        J @ v,
        J,
        rng.normal(size=k) if force else None,
        np.zeros(k, dtype=bool),
    )
    return measurement, ArmReference(
        make_pose(place(), turn()), rng.normal(size=k), rng.normal(size=k), rng.normal(size=k)
    )


def torque_by_hand(law, m, r, s0, sigma, t0):
    """Eqs. (19)-(23) entry by entry, with solves in place of the inverse."""
    rows, gains, J = law.arm.rows, law.gains, m.payload_jacobian
    k = rows.size
    chosen = list(rows.indices)
    xtilde = pose_error(m.payload_pose, r.pose)[chosen]
    s = np.linalg.solve(J, m.payload_twist - r.twist + gains.pose_gain @ xtilde)
    s_d = s0 * np.exp(-gains.transient_rate * (m.time - t0))
    R = m.payload_pose[:3, :3]
    f_d = (np.kron(np.eye(2), R) @ rows.expand(r.internal_wrench))[chosen]
    tau = np.zeros(k)
    qdot_r = np.linalg.solve(J, r.twist - gains.pose_gain @ xtilde) + s_d - np.diag(gains.sign_gain) * sigma
    feedback = f_d if m.internal_wrench is None else f_d - gains.force_gain * (m.internal_wrench - f_d)
    for i in range(k):
        tau[i] = -sum(gains.damping_gain[i, j] * (m.v[j] - qdot_r[j]) for j in range(k)) - sum(
            J[j, i] * feedback[j] for j in range(k)
        )
    return tau, s - s_d


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("name", ["planar", "full"])
def test_torque_is_the_printed_law(name, force):
    rows = task_rows(name)
    law = controller(rows)
    first, state = inputs(rows, 0.3, 0, force), None
    state = law.init(*first)
    sigma = np.zeros(rows.size)
    for tick in range(6):
        m, r = inputs(rows, 0.3 + tick * PERIOD, tick, force)
        expected, s_q = torque_by_hand(law, m, r, state.start_surface, sigma, 0.3)
        command = law.step(m, r, state)
        assert_allclose(command.torque, expected, rtol=1e-11, atol=1e-11)
        sigma = sigma + PERIOD * np.where(np.abs(s_q) <= 1e-9, 0.0, np.sign(s_q))
        state = command.state
        assert_close(state.sign_integral, sigma, atol=1e-15)


@pytest.mark.parametrize("name", ["planar", "full"])
def test_residual_is_surface_plus_sign_integral(name):
    """Eq. (21): s_r = s_q + alpha sigma when J is square and the twist is J v, read back from the torque."""
    rows = task_rows(name)
    law = controller(rows)
    m, r = inputs(rows, 0.0, 1, force=False)
    r = r._replace(internal_wrench=np.zeros(rows.size))
    state = law.init(*inputs(rows, 0.0, 2))._replace(sign_integral=np.linspace(-1, 1, rows.size))
    s_r = -np.linalg.solve(law.gains.damping_gain, law.step(m, r, state).torque)
    _, s_q = torque_by_hand(law, m, r, state.start_surface, state.sign_integral, 0.0)
    assert_close(s_r, s_q + law.gains.sign_gain @ state.sign_integral, atol=1e-10)


@pytest.mark.parametrize("name", ["planar", "full"])
def test_first_tick_leaves_the_sign_integral_at_zero(name):
    """s_q(t0) = 0 exactly and sgn(0) = 0."""
    rows = task_rows(name)
    law = controller(rows)
    m, r = inputs(rows, 4.2, 5)
    state = law.init(m, r)
    assert np.array_equal(law.step(m, r, state).state.sign_integral, np.zeros(rows.size))


@pytest.mark.parametrize("name", ["planar", "full"])
def test_the_sign_integral_of_a_saturated_joint_stands_still_and_the_others_go_on(name):
    rows = task_rows(name)
    law = controller(rows)
    state = law.init(*inputs(rows, 0.0, 0))._replace(sign_integral=np.linspace(-1.0, 1.0, rows.size))
    m, r = inputs(rows, PERIOD, 1)
    _, s_q = torque_by_hand(law, m, r, state.start_surface, state.sign_integral, 0.0)
    cut = np.arange(rows.size) % 2 == 0
    moved = law.step(m._replace(saturated=cut), r, state).state.sign_integral - state.sign_integral
    assert_close(moved, np.where(cut, 0.0, PERIOD * np.sign(s_q)), atol=1e-15)


def test_switching_functions():
    s = np.array([-2.0, -0.05, 0.0, 0.05, 2.0])
    assert Sign()(s).tolist() == [-1, -1, 0, 1, 1]
    assert Sign(dead_zone=0.05)(s).tolist() == [-1, 0, 0, 0, 1]
    assert Sign()(np.array([0.9e-9, 1.1e-9])).tolist() == [0, 1]
    assert_allclose(Saturation(width=0.1)(s), [-1, -0.5, 0, 0.5, 1])
    assert_allclose(Saturation()(np.array([0.005, 0.01, 0.02])), [0.5, 1, 1])
    assert_allclose(Tanh()(np.array([0.01])), np.tanh(1.0))
    assert_allclose(Tanh(width=0.1)(s), np.tanh(s / 0.1))


def test_sign_of_rounding_is_zero():
    """Ten times the default dead zone is a signal; rounding is none, unless the dead zone is 0; NaN stays."""
    s = np.array([-1e-8, -1e-16, 0.0, 1e-12, 1e-8])
    assert Sign()(s).tolist() == [-1, 0, 0, 0, 1]
    assert Sign(dead_zone=0)(s).tolist() == [-1, -1, 0, 1, 1]
    assert np.isnan(Sign()(np.array([np.nan]))).all()


@pytest.mark.parametrize("dead_zone", [-1e-9, np.nan, np.inf])
def test_dead_zone_is_validated(dead_zone):
    with pytest.raises(FieldError, match="dead_zone"):
        Sign(dead_zone=dead_zone)


def test_singular_jacobian_is_refused_with_numbers():
    rows = task_rows("planar")
    law = controller(rows)
    m, r = inputs(rows, 1.5, 0)
    J = m.payload_jacobian.copy()
    J[2] = J[1] * (1 + 1e-12)
    with pytest.raises(SingularJacobianError) as caught:
        law.init(m._replace(payload_jacobian=J), r)
    assert caught.value.time == 1.5
    assert caught.value.condition > 1e6


@pytest.mark.parametrize("shape", [(3, 4), (6, 3)])
def test_a_jacobian_that_is_not_square_is_refused(shape):
    with pytest.raises(ArgumentError, match=str(shape[1])):
        jacobian_inverse(np.ones(shape), 0.0)


@pytest.mark.parametrize("alpha", [0.0, 0.2])
@pytest.mark.parametrize("cell", SCENARIOS)
def test_law_holds_a_squeezed_payload(cell, alpha):
    """At rest without gravity, internal wrench and payload stay as they are: s is rounding, not a signal."""
    scenario = SCENARIOS[cell]()
    hold = {"kind": "hold", "pose": scenario.start.model_dump()}
    changes = {
        "motion": hold,
        "cell.gravity": (0, 0, 0),
        "controller.gains.sign_gain": alpha,
        "duration": 0.5,
        "events": [],
    }
    result = cp.run(scenario, changes, warn=False)
    error = (result.data.internal_wrench - result.data.desired_internal_wrench).values
    assert_close(np.nan_to_num(error), 0.0, atol=1e-8)
    assert_close(result.data.pose_error.values, 0.0, atol=1e-9)


@pytest.mark.parametrize("cell", SCENARIOS)
def test_law_brings_an_open_start_back(cell):
    """The transient follows xtildedot = -gamma xtilde + ...: the error shrinks to a small fraction."""
    scenario = SCENARIOS[cell]()
    away = scenario.start.replace(xyz=np.array(scenario.start.xyz) + np.array((0.02, -0.02, 0.0)))
    changes = {
        "motion": {"kind": "hold", "pose": away.model_dump()},
        "cell.gravity": (0, 0, 0),
        "duration": 3.0,
        "events": [],
    }
    error = cp.run(scenario, changes, warn=False).data.pose_error.values
    assert np.linalg.norm(error[-1]) < 0.05 * np.linalg.norm(error[0])


def test_arms_do_not_see_each_other():
    """Changing what the right arm measures leaves the left arm's torque as it is, bit for bit."""
    controller = build_controller(cp.Scenario.load("adept-paper"))
    rows = task_rows("planar")
    left, right, other = inputs(rows, 0.0, 0, False), inputs(rows, 0.0, 1, False), inputs(rows, 0.0, 2, False)
    torques = []
    for second in (right, other):
        measurements, references = (left[0], second[0]), (left[1], second[1])
        state = controller.init(measurements, references)
        torques.append(controller.step(measurements, references, state).torques[0])
    assert np.array_equal(*torques)
