"""Closure errors and their two derivatives, for every kind of rows, on states that are off the closure."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start
from close import assert_close
from numpy.testing import assert_allclose

from coop_pin.base.errors import FieldError, NameNotFoundError
from coop_pin.chain.closed_chain import ClosedChain
from coop_pin.chain.closure_set import ClosureSet
from coop_pin.description.cell.closure import Closure
from coop_pin.description.plant import PlantOptions
from coop_pin.grasps import CellChain

# One and two held turns about every axis, with and without held translations.
MASKS = [
    (True, True, False, False, False, True),
    (True, False, True, True, False, False),
    (False, False, False, False, True, False),
    (True, True, True, False, True, True),
    (False, True, True, True, False, True),
    (False, False, True, True, True, False),
    (False, True, False, False, False, False),
]
ROWS = ["planar", "axis", *MASKS]
PAIRS = {
    "arm": ("left/grasp", "payload/left"),
    "world": ("right/grasp", "universe"),
    "world first": ("universe", "payload"),
}


@pytest.fixture(scope="module", params=SCENARIOS)
def tree(request):
    """A free payload and two arms: nothing is closed by the tree."""
    cell, start = cell_and_start(request.param)
    chain = CellChain(cell, PlantOptions(payload="free"))
    return chain.mechanism.model, chain.configuration(start)


def random_states(tree, count=4, spread=0.4):
    """States far off every closure."""
    model, q_0 = tree
    rng = np.random.default_rng(5)
    for _ in range(count):
        yield (
            pin.integrate(model, q_0, rng.uniform(-spread, spread, model.nv)),
            rng.normal(size=model.nv),
            rng.normal(size=model.nv),
        )


def along(model, closures, q, v, a, t):
    """The closure state at time t of the motion q(t) = q + v t + a t^2 / 2, exact to second order in t."""
    return closures.state(pin.integrate(model, q, v * t + a * t * t / 2.0), v + a * t)


def rates(model, closures, q, v, a, h=1e-5):
    """Central differences of position and velocity error, and the closure state in the middle."""
    after, before = along(model, closures, q, v, a, h), along(model, closures, q, v, a, -h)
    middle = closures.state(q, v)
    return (after.position - before.position) / (2 * h), (after.velocity - before.velocity) / (2 * h), middle


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("rows", ROWS, ids=str)
def test_jacobian_and_drift_are_the_derivatives_of_the_error(tree, pair, rows):
    model, _ = tree
    closures = ClosureSet(model, [Closure(*PAIRS[pair], rows)])
    for q, v, a in random_states(tree):
        e_rate, e_rate_rate, now = rates(model, closures, q, v, a)
        assert (
            pair == "world" or np.abs(now.position).max() > 1e-3
        )  # a planar arm has no error across the plane of the world
        assert_allclose(now.velocity, e_rate, rtol=1e-7, atol=1e-7)
        assert_allclose(now.jacobian @ v, now.velocity, rtol=1e-13, atol=1e-13)
        assert_allclose(now.jacobian @ a + now.drift, e_rate_rate, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("pair", PAIRS)
def test_point_rows_are_differentiated_in_the_world(tree, pair):
    """e = R_WA^T (p_a - p_b); e', e'' are derivatives of p_a - p_b in the world, in axes a."""
    model, _ = tree
    closure, data, h = Closure(*PAIRS[pair], "point"), model.createData(), 1e-4
    closures = ClosureSet(model, [closure])

    def frames(q):
        pin.framesForwardKinematics(model, data, q)
        return data.oMf[model.getFrameId(closure.frame_a)].copy(), data.oMf[
            model.getFrameId(closure.frame_b)
        ].copy()

    def gap(q, v, a, t):
        X_Wa, X_Wb = frames(pin.integrate(model, q, v * t + a * t * t / 2.0))
        return X_Wa.translation - X_Wb.translation

    for q, v, a in random_states(tree):
        now = closures.state(q, v)
        R_aW = frames(q)[0].rotation.T
        after, middle, before = (gap(q, v, a, t) for t in (h, 0.0, -h))
        assert_close(now.position, R_aW @ middle, atol=1e-13)
        assert_close(now.velocity, R_aW @ (after - before) / (2 * h), atol=1e-6)
        assert_close(now.jacobian @ a + now.drift, R_aW @ (after - 2 * middle + before) / h**2, atol=1e-5)


@pytest.mark.parametrize("pair", PAIRS)
def test_the_velocity_error_of_a_weld_is_its_relative_twist_and_drift_is_its_derivative(tree, pair):
    """e' = V_a - Ad(X_ab) V_b; exactly, d/dt(-log6(X_ab)) = Jlog6 Ad(X_ab)^-1 e'."""
    model, _ = tree
    closure, data = Closure(*PAIRS[pair], "full"), model.createData()
    closures = ClosureSet(model, [closure])
    for q, v, a in random_states(tree):
        e_rate, e_rate_rate, now = rates(model, closures, q, v, a)
        pin.framesForwardKinematics(model, data, q)
        X_ab = data.oMf[model.getFrameId(closure.frame_a)].actInv(data.oMf[model.getFrameId(closure.frame_b)])
        assert_close(now.position, -pin.log6(X_ab).vector, atol=1e-14)
        exact = pin.Jlog6(X_ab) @ np.linalg.solve(X_ab.toActionMatrix(), now.velocity)
        assert_allclose(e_rate, exact, rtol=1e-6, atol=1e-6)
        assert_allclose(now.jacobian @ a + now.drift, e_rate_rate, rtol=1e-7, atol=1e-6)


def test_the_velocity_error_of_a_weld_is_the_derivative_of_its_error_when_that_is_small(tree):
    """The difference shrinks with the error itself: first order in the gap."""
    model, q_0 = tree
    closures = ClosureSet(model, [Closure("left/grasp", "payload/left", "full")])
    rng = np.random.default_rng(11)
    direction, v = rng.normal(size=model.nv), rng.normal(size=model.nv)
    closure_errors = []
    for size in (1e-2, 1e-3):
        e_rate, _, now = rates(
            model, closures, pin.integrate(model, q_0, size * direction), v, np.zeros(model.nv)
        )
        closure_errors.append(np.abs(now.velocity - e_rate).max())
    assert_allclose(closure_errors[0] / closure_errors[1], 10.0, rtol=0.2)


@pytest.mark.parametrize("turns", list(itertools.product((True, False), repeat=3)), ids=str)
def test_three_held_turns_follow_the_weld_and_fewer_are_exact(tree, turns):
    """All turns held, a translation free: rotation rows as of a weld, omega_a - R omega_b against -log3."""
    model, _ = tree
    closure = Closure("left/grasp", "payload/left", (True, True, False, *turns))
    closures, data = ClosureSet(model, [closure]), model.createData()
    for q, v, a in random_states(tree, 2):
        e_rate, _, now = rates(model, closures, q, v, a)
        if all(turns):
            pin.framesForwardKinematics(model, data, q)
            R_ab = (
                data.oMf[model.getFrameId("left/grasp")].actInv(data.oMf[model.getFrameId("payload/left")])
            ).rotation
            e_rate[2:] = R_ab @ np.linalg.solve(pin.Jlog3(R_ab), e_rate[2:])
        assert_allclose(now.velocity, e_rate, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("rows", ["full", *ROWS], ids=str)
def test_the_two_bodies_feel_opposite_wrenches_that_do_the_power_of_the_multipliers(tree, rows):
    """J^T lambda = J_a^T F - J_b^T F, F on body a and reversed on body b: also off the closure."""
    model, _ = tree
    data = model.createData()
    a, b = model.getFrameId("left/grasp"), model.getFrameId("payload/left")
    closures = ClosureSet(model, [Closure("left/grasp", "payload/left", rows)])
    for q, v, _ in random_states(tree):
        now = closures.state(q, v)
        multipliers = np.arange(1.0, closures.rows + 1.0)
        F_a = now.wrench_map[0] @ multipliers
        J_a = pin.computeFrameJacobian(model, data, q, a, pin.LOCAL)
        J_b = pin.computeFrameJacobian(model, data, q, b, pin.LOCAL)
        pin.framesForwardKinematics(model, data, q)
        F_b = -data.oMf[a].actInv(data.oMf[b]).actInv(pin.Force(F_a)).vector
        assert_allclose(now.jacobian.T @ multipliers, J_a.T @ F_a + J_b.T @ F_b, rtol=1e-10, atol=1e-10)


def test_several_closures_stack_in_their_order(tree):
    model, _ = tree
    single = [
        Closure("left/grasp", "payload/left", "full"),
        Closure("right/grasp", "universe", MASKS[1]),
        Closure("payload", "universe", "point"),
    ]
    stacked = ClosureSet(model, single)
    q, v, _ = next(random_states(tree))
    states = [ClosureSet(model, [closure]).state(q, v) for closure in single]
    assert stacked.rows == 6 + 3 + 3
    assert_allclose(
        stacked.state(q, v).position, np.concatenate([s.position for s in states]), rtol=0, atol=0
    )
    assert_allclose(
        stacked.state(q, v).jacobian, np.concatenate([s.jacobian for s in states]), rtol=0, atol=0
    )
    assert_allclose(stacked.state(q, v).drift, np.concatenate([s.drift for s in states]), rtol=0, atol=0)
    assert_allclose(stacked.state(q, v).wrench_map[1][:, 6:9], states[1].wrench_map[0], rtol=0, atol=0)
    assert not stacked.state(q, v).wrench_map[1][:, :6].any()


def test_gaps_are_the_distance_and_angle_that_the_rows_hold(tree):
    model, q_0 = tree
    lift = np.zeros(model.nv)
    lift[model.idx_vs[model.getJointId("payload")] :][:6] = (0.03, 0.04, 0.0, 0.0, 0.0, 0.0)
    q = pin.integrate(model, q_0, lift)
    full, ball, free = ClosureSet(
        model,
        [
            Closure("left/grasp", "payload/left"),
            Closure("left/grasp", "payload/left", "point"),
            Closure("left/grasp", "payload/left", (False, False, False, True, True, True)),
        ],
    ).closure_errors(q)
    assert_close([full, ball, free], [(0.05, 0.0), (0.05, 0.0), (0.0, 0.0)], atol=1e-9)
    turn = np.zeros(model.nv)
    turn[model.idx_vs[model.getJointId("payload")] :][:6] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.02)
    weld = ClosureSet(
        model, [Closure("payload/left", "universe"), Closure("left/grasp", "payload/left")]
    ).closure_errors(pin.integrate(model, q_0, turn))[1]
    assert_close(weld.angle, 0.02, atol=1e-9)


def test_a_state_does_not_change_when_the_closures_are_asked_again(tree):
    model, _ = tree
    closures = ClosureSet(
        model, [Closure("left/grasp", "payload/left"), Closure("right/grasp", "universe", "axis")]
    )
    (q, v, _), (q_2, v_2, _) = itertools.islice(random_states(tree), 2)
    first = closures.state(q, v)
    kept = [field.copy() for field in first]
    closures.state(q_2, v_2)
    for field, copy, again in zip(first, kept, closures.state(q, v), strict=True):
        assert_allclose(field, copy, rtol=0, atol=0)
        assert_allclose(again, copy, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("rows", "held"),
    [
        ("full", (1, 1, 1, 1, 1, 1)),
        ("point", (1, 1, 1, 0, 0, 0)),
        ("planar", (1, 1, 0, 0, 0, 1)),
        ("axis", (1, 1, 1, 1, 1, 0)),
        ([0, 1, 0, 0, 1, 0], (0, 1, 0, 0, 1, 0)),
    ],
)
def test_the_rows_that_each_name_holds(rows, held):
    assert Closure("a", "b", rows).mask == held


def test_a_closure_is_named_after_its_frames_unless_it_has_a_name():
    assert Closure("a", "b").name == "a - b"
    assert Closure("a", "b", name="loop").name == "loop"


def test_the_pose_of_a_closure_is_that_in_its_frame(tree):
    """Also where the frame itself is placed on its link."""
    model, q = tree
    data, X = model.createData(), pin.SE3(pin.exp3(np.array((0.3, -0.2, 0.5))), np.array((0.1, 0.2, 0.3)))
    pin.framesForwardKinematics(model, data, q)
    a, b = (data.oMf[model.getFrameId(name)] for name in PAIRS["arm"])
    closures = ClosureSet(model, [Closure(*PAIRS["arm"], X_AC=X.homogeneous)])
    error = pin.log6((a * X).actInv(b)).vector
    ((distance, angle),) = closures.closure_errors(q)
    assert_close((distance, angle), (np.linalg.norm(error[:3]), np.linalg.norm(error[3:])), atol=1e-12)


@pytest.mark.parametrize(
    "rows", ["welded", (True, False), (False,) * 6, (True,) * 7, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)], ids=str
)
def test_rows_that_mean_nothing_are_refused(tree, rows):
    with pytest.raises(FieldError, match="rows"):
        ClosedChain(tree[0], [Closure("left/grasp", "payload/left", rows)])


@pytest.mark.parametrize(
    "rows", [[True] * 6, [True] * 3 + [False] * 3, list(MASKS[0]), np.array(MASKS[1])], ids=str
)
def test_rows_may_be_any_sequence_of_six_booleans(tree, rows):
    chain, named = (
        ClosedChain(tree[0], [Closure("left/grasp", "payload/left", mask)], open_allowed=1.0)
        for mask in (rows, tuple(map(bool, rows)))
    )
    q, v, a = next(random_states(tree, spread=0.05))
    assert_allclose(
        chain.forward_dynamics(q, v, a).acceleration,
        named.forward_dynamics(q, v, a).acceleration,
        rtol=0,
        atol=0,
    )


def test_a_wrong_frame_is_named_with_a_suggestion(tree):
    with pytest.raises(NameNotFoundError, match=r"left/grsp.*'left/grasp'"):
        ClosedChain(tree[0], [Closure("left/grsp", "payload/left")])


def test_the_world_is_the_universe_also_where_the_first_frame_moves():
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array((0.3, 0.0, 0.0))), "hinge")
    model.addJointFrame(hinge)
    model.appendBodyToJoint(hinge, pin.Inertia.Random(), pin.SE3.Identity())
    model.addFrame(
        pin.Frame("tip", hinge, pin.SE3(np.eye(3), np.array((0.1, 0.0, 0.0))), pin.FrameType.OP_FRAME)
    )
    ((distance, angle),) = ClosureSet(model, [Closure("world", "tip")]).closure_errors(np.array([0.0]))
    assert_close((distance, angle), (0.4, 0.0), atol=1e-15)
