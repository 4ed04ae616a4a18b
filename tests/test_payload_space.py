"""The payload-space law and the redundant variant of law (23): equations by hand, and their properties."""

import numpy as np
import pytest
from cells import SCENARIOS
from close import assert_close
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.control import (
    ArmMeasurement,
    ArmReference,
    PayloadSpaceController,
    Posture,
    RedundantSlidingModeController,
    Sign,
    SlidingModeController,
)
from coop_pin.control.terms import force_gain_bound, jacobian_inverse, right_inverse
from coop_pin.errors import ArgumentError, SingularJacobianError
from coop_pin.spatial import internal_wrenches, make_pose, task_rows

ROWS = ["planar", "positional", "full"]


def inputs(rows, joints, seed=0, time=0.0):
    rng = np.random.default_rng(seed)
    turn = (0.0, 0.0, rng.normal()) if rows.name == "planar" else rng.normal(size=3) * 0.3
    J, v = rng.normal(size=(rows.size, joints)) + 2 * np.eye(rows.size, joints), rng.normal(size=joints)
    wrench = rng.normal(size=rows.size)
    measurement = ArmMeasurement(
        time,
        rng.normal(size=joints),
        v,
        make_pose((*rng.normal(size=2), 0), turn),
        J @ v,
        J,
        wrench,
        np.zeros(joints, dtype=bool),
    )
    return measurement, ArmReference(
        make_pose((0.1, 0.2, 0)), rng.normal(size=rows.size), wrench, rng.normal(size=rows.size)
    )


def law(rows, share=0.4, posture=None, force_gain=0.5):
    k = rows.size
    K_x, alpha, gamma = np.diag(np.arange(1.0, k + 1)), 0.3 * np.eye(k), 2.0 * np.eye(k)
    return PayloadSpaceController(rows, 0.01, share, gamma, K_x, alpha, force_gain, 5.0, Sign(), posture)


@pytest.mark.parametrize("name", ROWS)
def test_torque_is_the_law_by_hand(name):
    rows = task_rows(name)
    controller = law(rows)
    (m, r), (m1, r1) = inputs(rows, rows.size), inputs(rows, rows.size, seed=1, time=0.01)
    state = controller.init(m, r)
    state = controller.step(m, r, state).state
    assert_allclose(state.sign_integral, 0.0)
    s0 = m.payload_twist - r.twist + 2.0 * rows.pose_error(m.payload_pose, r.pose)
    for _ in range(2):
        s = m1.payload_twist - r1.twist + 2.0 * rows.pose_error(m1.payload_pose, r1.pose) - s0 * np.exp(-0.05)
        motion = np.arange(1, rows.size + 1) * (s + 0.3 * state.sign_integral)
        f_d = rows.turn(m1.payload_pose, r1.internal_wrench)
        wrench = 0.4 * motion + f_d - 0.5 * (m1.internal_wrench - f_d)
        command = controller.step(m1, r1, state)
        assert_close(command.torque, -m1.payload_jacobian.T @ wrench, atol=1e-12)
        assert_allclose(command.state.sign_integral, state.sign_integral + 0.01 * np.sign(s))
        state = command.state


def test_motion_terms_have_no_internal_part():
    """With one payload pose, F_i = c_i w for all arms: f_i = F_i - c_i sum F = 0."""
    rows = task_rows("full")
    m, r = inputs(rows, 6)
    r = r._replace(internal_wrench=np.zeros(6))
    m = m._replace(internal_wrench=None)
    shares = np.array([0.3, 0.7])
    controllers = [law(rows, share) for share in shares]
    later = m._replace(time=0.5)
    wrenches = [
        -np.linalg.solve(m.payload_jacobian.T, c.step(later, r, c.init(m, r)).torque) for c in controllers
    ]
    assert_close(internal_wrenches(np.array(wrenches), shares), 0.0, atol=1e-12)


def test_integral_stands_still_while_saturated():
    rows = task_rows("planar")
    controller = law(rows)
    m, r = inputs(rows, 3)
    state = controller.init(m, r)
    later = m._replace(time=0.1)
    assert np.any(controller.step(later, r, state).state.sign_integral != 0.0)
    cut = later._replace(saturated=np.array([False, True, False]))
    assert np.array_equal(controller.step(cut, r, state).state.sign_integral, state.sign_integral)


@pytest.mark.parametrize("name", ROWS)
def test_posture_does_no_work_on_the_payload(name):
    rows = task_rows(name)
    joints = rows.size + 2
    m, _ = inputs(rows, joints)
    posture = Posture(np.zeros(joints), np.full(joints, 40.0), np.full(joints, 8.0))
    J_plus = right_inverse(m.payload_jacobian, 0.0)
    tau = posture.torque(m.q, m.v, m.payload_jacobian, J_plus)
    assert np.linalg.norm(tau) > 1.0
    assert_close(J_plus.T @ tau, 0.0, atol=1e-10)


def test_right_inverse():
    J = np.random.default_rng(0).normal(size=(3, 7))
    assert_close(right_inverse(J, 0.0), np.linalg.pinv(J), atol=1e-12)
    assert_close(right_inverse(J, 0.0, 0.1), J.T @ np.linalg.inv(J @ J.T + 0.01 * np.eye(3)), atol=1e-12)
    J[2] = J[1]
    with pytest.raises(SingularJacobianError):
        right_inverse(J, 1.0)
    assert np.isfinite(right_inverse(J, 1.0, 0.1)).all()


@pytest.mark.parametrize(
    ("inverse", "fine", "refused"),
    [(jacobian_inverse, 1.42e-6, 1.41e-6), (right_inverse, 1.20e-6, 1.18e-6)],
)
def test_jacobians_are_refused_beyond_a_condition_number_of_a_million(inverse, fine, refused):
    """Of J = diag(1, 1, s), in the Frobenius norm: |J| |J^-1|, or the root of |J J^T| |(J J^T)^-1|."""
    assert_close(inverse(np.diag((1.0, 1.0, fine)), 0.0) @ np.diag((1.0, 1.0, fine)), np.eye(3), atol=1e-9)
    with pytest.raises(SingularJacobianError) as caught:
        inverse(np.diag((1.0, 1.0, refused)), 1.5)
    power = 2 if inverse is right_inverse else 1
    norms = [np.sqrt(2.0 + value ** (2 * power)) for value in (refused, 1.0 / refused)]
    assert_allclose(caught.value.condition, np.prod(norms) ** (1.0 / power), rtol=1e-9)
    assert (caught.value.time, caught.value.limit) == (1.5, 1e6)
    with pytest.raises(SingularJacobianError) as caught:
        inverse(np.diag((1.0, 1.0, 0.0)), 0.0)
    assert caught.value.condition == np.inf


@pytest.mark.parametrize(("rows", "joints", "error"), [(3, 2, ArgumentError), (3, 3, SingularJacobianError)])
def test_too_few_joints_are_told_from_a_singular_pose(rows, joints, error):
    with pytest.raises(error):
        right_inverse(np.ones((rows, joints)), 0.0)


def test_the_force_gain_bound_of_a_filter():
    assert [force_gain_bound(pole) for pole in (0.0, 0.5, 0.75)] == [1.0, 3.0, 7.0]


@pytest.mark.parametrize("name", ROWS)
def test_redundant_variant_is_the_printed_law_for_square_jacobians(name):
    rows = task_rows(name)
    k = rows.size
    gains = (np.eye(k), 0.2 * np.eye(k), 3.0 * np.eye(k), 0.5, 5.0, Sign())
    printed = SlidingModeController(rows, 0.01, *gains)
    variant = RedundantSlidingModeController(printed, Posture(np.zeros(k), np.zeros(k), np.zeros(k)))
    (m, r), (m1, r1) = inputs(rows, k), inputs(rows, k, seed=3, time=0.2)
    one, other = printed.step(m1, r1, printed.init(m, r)), variant.step(m1, r1, variant.init(m, r))
    assert_close(other.torque, one.torque, atol=1e-9)
    assert_allclose(other.state.sign_integral, one.state.sign_integral)


def test_redundant_variant_moves_the_payload_as_the_printed_law_says():
    """J s_r = xtildedot + gamma xtilde + J (alpha sigma - s_d): what is left of eq. (21) for k > k_0."""
    rows = task_rows("planar")
    m, r = inputs(rows, 5)
    r, m = r._replace(internal_wrench=np.zeros(3)), m._replace(internal_wrench=None)
    no_spring = Posture(np.zeros(5), np.zeros(5), np.zeros(5))
    printed = SlidingModeController(rows, 0.01, np.eye(3), 0.2 * np.eye(5), np.eye(5), 0.0, 5.0, Sign())
    variant = RedundantSlidingModeController(printed, no_spring)
    state = variant.init(m, r)._replace(sign_integral=np.linspace(-1, 1, 5))
    s_r = -variant.step(m, r, state).torque
    J, xtilde = m.payload_jacobian, rows.pose_error(m.payload_pose, r.pose)
    expected = m.payload_twist - r.twist + xtilde + J @ (0.2 * state.sign_integral - state.start_surface)
    assert_close(J @ s_r, expected, atol=1e-10)


GAINS = {"pose_gain": 2, "sliding_gain": [800, 800, 40], "sign_gain": 0.2, "transient_rate": 5}
REPAIR = {"controller": {"kind": "payload-space", "gains": GAINS}}


def test_repair_keeps_the_papers_internal_force_small():
    """At the same alpha: less internal-force error than the printed law, tracking below 0.5 mm, settled."""
    printed = cp.run("adept-paper")
    repaired = cp.run("adept-paper", REPAIR)
    assert repaired.internal_force().force_rms_error < 0.6 * printed.internal_force().force_rms_error
    assert repaired.position_rms() < 0.5e-3
    assert repaired.settling_time() < 2.5
    assert repaired.resettling_time() < 2.5


def test_repair_carries_gravity():
    """Two UR5 and a box, unequal shares: the integral carries the weight; law (23) with alpha = 0 cannot."""
    scenario = SCENARIOS["spatial"]().replace(duration=5.0)
    gains = {
        "pose_gain": 5,
        "sliding_gain": [600, 600, 600, 20, 20, 20],
        "sign_gain": 0.5,
        "transient_rate": 5,
    }
    result = cp.run(scenario, {"controller": {"kind": "payload-space", "gains": gains}})
    assert result.position_rms() < 0.5e-3
    assert max(result.closure_error_max()) < 1e-8
    assert result.energy_balance_max() < 1e-5


def biased_run(name, controller, bias):
    """The left arm's kinematics are off by a constant; the payload goes to rest or stays there."""
    scenario = SCENARIOS[name]().replace(events=(), duration=10.0)
    still = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}}
    return cp.run(scenario, {"controller": controller, "cell.arms.left.calibration_error.xyz": bias, **still})


@pytest.mark.parametrize("name", SCENARIOS)
def test_under_a_boundary_layer_a_kinematic_bias_winds_the_internal_force_up_at_a_constant_rate(name):
    """Two arms at rest: f' = c_1 c_2 K_x alpha gamma b / width.

    The mean of their errors stays zero, and each integral grows with its own error.
    """
    gains = (
        GAINS
        if name == "planar"
        else {"pose_gain": 5, "sliding_gain": [600] * 3 + [20] * 3, "sign_gain": 0.5, "transient_rate": 5}
    )
    bias, width = [1e-4, 0.0 if name == "planar" else 0.5e-4, 0.0], 0.05
    controller = {
        "kind": "payload-space",
        "gains": gains,
        "switching": {"kind": "saturation", "width": width},
    }
    result = biased_run(name, controller, bias)
    late = result.data.sel(time=slice(7.0, None))
    force = late.internal_wrench.sel(arm="left").values[:, :3]
    rate = np.polyfit(late.time.values, np.nan_to_num(force), 1)[0]
    R_WE = (
        Rotation.from_quat(late.payload_quaternion.values[-1]).as_matrix()
        @ result.scenario.cell.grasps["left"].matrix[:3, :3]
    )
    per_metre = gains["sliding_gain"][0] * gains["sign_gain"] * gains["pose_gain"] / width
    expected = np.prod(result.scenario.cell.shares) * per_metre * (R_WE @ bias)
    assert np.linalg.norm(expected) > 0.1
    assert_close(rate, expected, atol=0.01 * np.linalg.norm(expected))
