"""The payload-space law and the redundant variant of law (23): equations by hand, and their properties."""

import numpy as np
import pytest
from cells import CATALOGUE_CELLS, FAR_CELLS, SCENARIOS, arm_of
from close import assert_close
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, SingularJacobianError
from coop_pin.base.spatial import internal_wrenches, make_pose, task_rows
from coop_pin.control import (
    ArmMeasurement,
    ArmReference,
    PayloadSpaceController,
    PayloadSpaceGains,
    Posture,
    RedundantSlidingModeController,
    Saturation,
    Sign,
    SlidingModeController,
    SlidingModeGains,
    ZeroedController,
)
from coop_pin.control.bounds import force_gain_bound
from coop_pin.control.laws.anchored_integral import AnchoredIntegral
from coop_pin.control.terms import GainAxes, jacobian_inverse, right_inverse

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


def law(rows, share=0.4, **fields):
    k = rows.size
    fields = {
        "pose_gain": 2.0 * np.eye(k),
        "sliding_gain": np.diag(np.arange(1.0, k + 1)),
        "sign_gain": 0.3 * np.eye(k),
        "force_gain": 0.5,
        "transient_rate": 5.0,
        "anchor_gain": 0.0,
        "leak": 0.0,
        "switching": Sign(),
    } | fields
    names = PayloadSpaceGains.model_fields.keys() - {"leak"}
    gains = PayloadSpaceGains(**{name: fields.pop(name) for name in names})
    arm, switching = arm_of(rows, 0.01, share), fields.pop("switching")
    integral = AnchoredIntegral(gains.anchor_gain, fields.pop("leak"), fields.pop("stale_after", 3.0))
    return PayloadSpaceController(arm, gains.sized(k, k), switching, integral, GainAxes(rows), **fields)


def with_integral(state, **fields):
    """A state with another memory of the integral."""
    return state._replace(integral=state.integral._replace(**fields))


def wrench_of(measurement, torque):
    """What the law says in its brackets: tau = -J^T w for square and wide J."""
    return -np.linalg.lstsq(measurement.payload_jacobian.T, torque, rcond=None)[0]


@pytest.mark.parametrize("name", ROWS)
def test_torque_is_the_law_by_hand(name):
    """Two laws of one source: with a switching sign, and with a linear layer whose rate is k_I."""
    rows = task_rows(name)
    for switching, phi in (
        (Sign(), np.sign),
        (Saturation(width=3.0), lambda s: np.clip(s / 3.0, -1.0, 1.0)),
    ):
        controller = law(rows, switching=switching, anchor_gain=0.2)
        (m, r), (m1, r1) = inputs(rows, rows.size), inputs(rows, rows.size, seed=1, time=0.01)
        state = controller.init(m, r)
        state = controller.step(m, r, state).state
        assert_allclose(state.integral.value, 0.0)
        s0 = m.payload_twist - r.twist + 2.0 * rows.pose_error(m.payload_pose, r.pose)
        s = m1.payload_twist - r1.twist + 2.0 * rows.pose_error(m1.payload_pose, r1.pose) - s0 * np.exp(-0.05)
        f_r = rows.turn(m1.payload_pose, r1.internal_wrench - r.internal_wrench * np.exp(-0.05))
        K, Z = np.arange(1, rows.size + 1), np.zeros(rows.size)
        for _ in range(2):
            m1 = m1._replace(internal_wrench_age=0.0)
            Z = Z - 0.2 * (m1.internal_wrench - f_r)
            wrench = 0.4 * K * s + Z + f_r - 0.5 * (m1.internal_wrench - f_r)
            command = controller.step(m1, r1, state)
            assert_allclose(command.torque, -m1.payload_jacobian.T @ wrench, atol=1e-12)
            Z = Z + 0.01 * 0.4 * K * 0.3 * phi(s)
            assert_allclose(command.state.integral.value, Z, atol=1e-15)
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


@pytest.mark.parametrize("name", ROWS)
def test_anchors_of_all_arms_move_nothing(name):
    """Measured internal wrenches sum to zero, and so do the desired ones: the sum of all Z stays."""
    rows, rng = task_rows(name), np.random.default_rng(4)
    shares = np.array([0.2, 0.3, 0.5])
    m, r = inputs(rows, rows.size)
    controllers = [law(rows, share, anchor_gain=0.3, force_gain=0.0) for share in shares]
    measured, desired = (internal_wrenches(rng.normal(size=(3, rows.size)), shares) for _ in range(2))
    without, anchored = [], []
    for controller, f_m, f_d in zip(controllers, measured, desired, strict=True):
        reference = r._replace(internal_wrench=f_d)
        state = controller.init(m, reference)
        for age, sums in ((np.inf, without), (0.0, anchored)):
            seen = m._replace(time=0.1, internal_wrench=f_m, internal_wrench_age=age)
            sums.append(controller.step(seen, reference, state).state.integral.value)
    assert np.abs(np.array(anchored) - without).min() > 1e-3
    assert_allclose(np.sum(anchored, axis=0), np.sum(without, axis=0), atol=1e-14)


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("spare", [0, 1, 2])
def test_the_first_torque_is_the_holding_torque(name, spare):
    """Whatever it is: outside the range of J^T, off the posture, off the reference and with a squeeze."""
    rows = task_rows(name)
    joints = rows.size + spare
    posture = Posture(np.zeros(joints), np.full(joints, 40.0), np.full(joints, 8.0)) if spare else None
    controller = law(rows, posture=posture, anchor_gain=0.1, force_gain=0.0)
    m, r = inputs(rows, joints)
    m = m._replace(holding_torque=np.linspace(-20.0, 30.0, joints))
    command = controller.step(m, r, controller.init(m, r))
    assert_allclose(command.torque, m.holding_torque, atol=1e-11)
    # Much later the start is forgotten: at rest on the reference, squeeze and spring act in full.
    still = m._replace(
        time=1e3, internal_wrench=None, holding_torque=None, payload_twist=r.twist, payload_pose=r.pose
    )
    torque = controller.step(still, r, controller.init(m, r)).torque
    f_d = rows.turn(r.pose, r.internal_wrench)
    assert_allclose(wrench_of(m, torque - m.holding_torque), f_d, atol=1e-11)
    if spare:
        N = np.eye(joints) - np.linalg.pinv(m.payload_jacobian) @ m.payload_jacobian
        assert_allclose(N @ (torque - m.holding_torque), N @ posture.pull(m.q, m.v), atol=1e-11)


def anchored_ticks(controller, ages, saturated=False):
    """State after each tick of a still arm whose wrench error is one on every row, measured at these ages."""
    m, r = inputs(controller.arm.rows, controller.arm.rows.size)
    r = r._replace(internal_wrench=np.zeros(controller.arm.rows.size))
    m = m._replace(
        internal_wrench=np.ones(controller.arm.rows.size),
        saturated=np.full(controller.arm.rows.size, saturated),
        payload_twist=r.twist,
        payload_pose=r.pose,
    )
    state, states = controller.init(m, r), []
    for tick, age in enumerate(ages):
        measurement = m._replace(time=0.01 * tick, internal_wrench_age=age)
        state = controller.step(measurement, r, state).state
        states.append(state)
    return states


@pytest.mark.parametrize(
    ("ages", "anchors"),
    [
        ([0, 0, 0, 0], [1, 2, 3, 4]),  # at every tick
        ([2, 2, 2, 2], [1, 2, 3, 4]),  # at every tick, two ticks late
        ([np.inf, np.inf, 1, 1], [0, 0, 1, 2]),  # before the first sample
        ([0, 1, 2, 0, 1, 2, 0], [1, 1, 1, 2, 2, 2, 3]),  # every third tick
        ([0.5, 1.5, 0.0, 1.0, 2.0, 0.5], [1, 1, 2, 2, 2, 3]),  # every two and a half ticks
        ([1, 2, 3, 1, 2 - 1e-9, 3 - 2e-9], [1, 1, 1, 2, 2, 2]),  # ages carry rounding
        ([0.3, 0.1, 0.2, 0.0], [1, 2, 3, 4]),  # faster than the ticks
    ],
)
@pytest.mark.parametrize("saturated", [False, True])
@pytest.mark.parametrize("name", ROWS)
def test_every_new_measurement_anchors_once_even_while_torques_saturate(name, ages, anchors, saturated):
    rows = task_rows(name)
    controller = law(rows, anchor_gain=0.1, stale_after=4.0)
    states = anchored_ticks(controller, ages, saturated)
    expected = -0.1 * np.outer(anchors, np.ones(rows.size))
    assert_allclose([state.integral.value for state in states], expected, atol=1e-14)


def test_a_stale_integral_leaks_to_its_last_anchored_value():
    controller = law(task_rows("planar"), anchor_gain=0.1, leak=2.0, sign_gain=np.zeros((3, 3)))
    states = anchored_ticks(controller, [0, 1, 2, 3, 4, 5])
    pushed = [state.integral.value for state in states]
    assert_allclose(pushed, np.full((6, 3), -0.1))  # at its anchored value there is nothing to forget
    state = with_integral(states[3], value=np.full(3, 0.9))
    m, r = inputs(controller.arm.rows, 3)
    m = m._replace(time=0.05, internal_wrench=np.ones(3))
    recent = with_integral(state, wrench_age=2.0)
    fresh_enough = controller.step(m._replace(internal_wrench_age=3.0), r, recent)
    assert_allclose(fresh_enough.state.integral.value, 0.9)
    stale = controller.step(m._replace(internal_wrench_age=4.0), r, state).state.integral.value
    assert_allclose(stale, -0.1 + (1 - 2.0 * 0.01) * 1.0)


def test_without_a_measurement_the_integral_leaks_to_the_holding_torques():
    controller = law(task_rows("planar"), leak=2.0, sign_gain=np.zeros((3, 3)))
    m, r = inputs(controller.arm.rows, 3)
    m = m._replace(internal_wrench=None, holding_torque=np.array([5.0, -3.0, 1.0]))
    state = controller.init(m, r)
    held = wrench_of(m, m.holding_torque)
    assert_allclose(state.integral.value, held, atol=1e-12)
    pushed = with_integral(state, value=state.integral.value + 1.0)
    assert_allclose(controller.step(m, r, pushed).state.integral.value, held + 0.98, atol=1e-12)


@pytest.mark.parametrize("name", ROWS)
def test_own_wrist_wrench_anchors_to_its_share_of_the_stated_weight(name):
    rows = task_rows(name)
    weight, F = np.arange(1.0, rows.size + 1), np.full(rows.size, 5.0)
    controller = law(rows, anchor_gain=0.1, payload_weight=weight, force_gain=0.0)
    m, r = inputs(rows, rows.size)
    still = {"payload_twist": r.twist, "payload_pose": r.pose, "internal_wrench": None}
    m = m._replace(**still, interaction_wrench=F, interaction_wrench_age=0.0)
    state = controller.step(m, r, controller.init(m, r)).state
    assert_allclose(state.integral.value, -0.1 * (F - 0.4 * weight), atol=1e-14)
    # The internal wrench goes first where both are measured; without a stated mass the wrist is not used.
    both = m._replace(internal_wrench=2.0 * F, internal_wrench_age=0.0)
    assert_allclose(
        controller.step(both, r, controller.init(m, r)).state.integral.value, -0.2 * F, atol=1e-14
    )
    unstated = law(rows, anchor_gain=0.1, force_gain=0.0)
    assert_allclose(unstated.step(m, r, unstated.init(m, r)).state.integral.value, 0.0, atol=1e-14)


@pytest.mark.parametrize("name", ROWS)
def test_integral_stands_still_while_saturated(name):
    rows = task_rows(name)
    controller = law(rows)
    m, r = inputs(rows, rows.size)
    state = controller.init(m, r)
    later = m._replace(time=0.1)
    assert np.any(controller.step(later, r, state).state.integral.value != 0.0)
    cut = later._replace(saturated=np.arange(rows.size) == 1)
    assert np.array_equal(controller.step(cut, r, state).state.integral.value, state.integral.value)


def test_a_stated_weight_without_a_wrist_measurement_anchors_nothing():
    rows = task_rows("planar")
    controller = law(rows, anchor_gain=0.1, payload_weight=np.ones(3), sign_gain=np.zeros((3, 3)))
    m, r = inputs(rows, 3)
    m = m._replace(internal_wrench=None)
    assert_allclose(controller.step(m, r, controller.init(m, r)).state.integral.value, 0.0, atol=1e-15)


def test_neither_anchor_nor_leak_unless_stated():
    controller = law(task_rows("planar"), sign_gain=np.zeros((3, 3)))
    m, r = inputs(controller.arm.rows, 3)
    for age in (0.0, 9.0):  # anchored anew, and stale
        last = np.inf if age == 0.0 else 8.0
        state = with_integral(controller.init(m, r), value=np.ones(3), wrench_age=last)
        after = controller.step(m._replace(internal_wrench_age=age), r, state).state
        assert_allclose(after.integral.value, 1.0, atol=1e-15)
        assert_allclose(after.integral.anchored, float(age == 0.0), atol=0)


def test_only_time_since_the_start_counts():
    controller = law(task_rows("planar"), anchor_gain=0.2)

    def torque(start):
        rows = controller.arm.rows
        (m, r), (m1, r1) = inputs(rows, 3, time=start), inputs(rows, 3, 1, start + 0.1)
        return controller.step(m1, r1, controller.init(m, r)).torque

    assert_allclose(torque(7.0), torque(0.0), atol=1e-12)


@pytest.mark.parametrize("name", ROWS)
def test_zero_at_grasp_undoes_a_bias_that_is_fixed_in_the_tip(name):
    """The arm sees X G with a constant G; twist, Jacobian and wrench are those of the true payload again."""
    rows = task_rows(name)
    turned = name != "positional"  # positional rows see no rotation, and so no twist of another point
    rng = np.random.default_rng(3)
    J, v, F = rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=6)
    if name == "planar":
        J[2:5] = 0.0
        F[2:5] = 0.0
    true = [make_pose((0.4, 0.2, 0.0), (0.0, 0.0, 0.3)), make_pose((0.5, -0.1, 0.0), (0.0, 0.0, 0.9))]
    G = make_pose((1e-2, -2e-2, 0.0), (0.0, 0.0, 0.05) if turned else (0.0, 0.0, 0.0))

    def seen(time, X, offset):
        """Of the payload frame X @ offset: p' - p = R p_offset."""
        there = X @ offset
        A = np.eye(6)
        A[:3, 3:] = -np.cross(there[:3, 3] - X[:3, 3], np.eye(3)).T
        if not turned:
            A = np.eye(6)
        measurement, reference = inputs(rows, 6)
        return measurement._replace(
            time=time,
            payload_pose=there,
            payload_twist=rows.select(A @ J @ v),
            payload_jacobian=rows.select(A @ J),
            internal_wrench=None,
            interaction_wrench=rows.select(np.linalg.inv(A).T @ F),
            interaction_wrench_age=0.0,
        ), reference

    fields = {"payload_weight": np.ones(rows.size), "anchor_gain": 0.1, "force_gain": 0.0}
    plain = law(rows, **fields)
    zeroed = ZeroedController(law(rows, **fields), rows, true[0])
    commands = []
    for controller, offset in ((plain, np.eye(4)), (zeroed, G)):
        state = controller.init(*seen(0.0, true[0], offset))
        for time, X in ((0.0, true[0]), (0.01, true[1])):
            command = controller.step(*seen(time, X, offset), state)
            state = command.state
            commands.append(command.torque)
    assert np.abs(commands[1]).max() > 0.1
    assert_allclose(commands[2:], commands[:2], atol=1e-12)


def test_a_posture_pulls_by_a_spring_and_a_damper():
    posture = Posture(
        angles=np.array([0.1, 0.2]), stiffness=np.array([3.0, 5.0]), damping=np.array([0.5, 2.0])
    )
    pull = posture.pull(np.array([0.4, 0.1]), np.array([1.0, -0.3]))
    assert_close(pull, [-3.0 * 0.3 - 0.5, 5.0 * 0.1 + 2.0 * 0.3], atol=1e-15)


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
    gains = SlidingModeGains(
        pose_gain=1.0, sign_gain=0.2, damping_gain=3.0, force_gain=0.5, transient_rate=5.0
    )
    parts = arm_of(rows, 0.01), gains.sized(k, k), Sign()
    printed = SlidingModeController(*parts)
    variant = RedundantSlidingModeController(*parts, Posture(np.zeros(k), np.zeros(k), np.zeros(k)))
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
    gains = SlidingModeGains(pose_gain=1.0, sign_gain=0.2, damping_gain=1.0, transient_rate=5.0).sized(3, 5)
    variant = RedundantSlidingModeController(arm_of(rows, 0.01), gains, Sign(), no_spring)
    state = variant.init(m, r)._replace(sign_integral=np.linspace(-1, 1, 5))
    s_r = -variant.step(m, r, state).torque
    J, xtilde = m.payload_jacobian, rows.pose_error(m.payload_pose, r.pose)
    expected = m.payload_twist - r.twist + xtilde + J @ (0.2 * state.sign_integral - state.start_surface)
    assert_close(J @ s_r, expected, atol=1e-10)


def test_sgn_is_used_only_when_asked_for():
    """The default is a wide layer; the scenarios with a measured internal wrench use it, without K_f."""
    width = cp.laws.PayloadSpace.model_fields["switching"].default.width
    assert width >= 0.05
    named = {
        name: cp.Scenario.load(name).controller for name in ("adept-anchored", *CATALOGUE_CELLS, *FAR_CELLS)
    }
    for law in named.values():
        assert law.switching == Saturation(width=width)
        assert law.gains.force_gain == 0.0
        assert law.gains.anchor_gain > 0.0
        assert law.force_path.kind == "late"


GAINS = {"pose_gain": 2, "sliding_gain": [800, 800, 40], "sign_gain": 0.2, "transient_rate": 5}
REPAIR = {"controller": {"kind": "payload-space", "gains": GAINS}}


def test_repair_keeps_the_papers_internal_force_small():
    """At the same alpha: less internal-force error than the printed law, tracking below 0.5 mm, settled."""
    printed = cp.run(
        "adept-paper", {"controller.gains.sign_gain": GAINS["sign_gain"]}, warn=False, engine="compiled"
    )
    repaired = cp.run("adept-paper", REPAIR, warn=False, engine="compiled")
    assert repaired.internal_force().force_rms_error < 0.6 * printed.internal_force().force_rms_error
    assert repaired.position_rms() < 0.5e-3
    assert repaired.settling_time() < 2.5
    assert repaired.metrics()["resettling_time_s"] < 2.5


def test_repair_carries_gravity():
    """Two UR5 and a box, unequal shares: the integral carries the weight; law (23) with alpha = 0 cannot."""
    scenario = SCENARIOS["spatial"]().replace(duration=5.0)
    gains = {
        "pose_gain": 5,
        "sliding_gain": [600, 600, 600, 20, 20, 20],
        "sign_gain": 0.5,
        "transient_rate": 5,
    }
    result = cp.run(
        scenario, {"controller": {"kind": "payload-space", "gains": gains}}, warn=False, engine="compiled"
    )
    assert result.position_rms() < 0.5e-3
    assert max(result.closure_error_max()) < 1e-8
    assert result.energy_balance_max() < 1e-5


def biased_run(name, controller, bias):
    """The left arm's kinematics are off by a constant; the payload goes to rest or stays there."""
    scenario = SCENARIOS[name]().replace(events=(), duration=10.0)
    still = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}}
    return cp.run(
        scenario,
        {"controller": controller, "cell.arms.left.calibration_error.tip.xyz": bias, **still},
        warn=False,
        engine="compiled",
    )


@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
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
        "gains": gains | {"leak": 0.0},
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
