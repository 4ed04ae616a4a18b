"""Interaction wrenches: welded against free payload, Newton and Euler, d'Alembert by arm, statics."""

import functools

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS, cell_and_start, kkt_of, random_velocity
from close import assert_close
from lifts import planar_cell, spatial_cell
from linkages import bar, joint, robot
from numpy.testing import assert_allclose
from rollers import rolling_cell

from coop_pin.actuators import SharedJoint
from coop_pin.base.errors import NameNotFoundError, OpenClosureError, UnreachablePoseError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import internal_wrenches, inverse_pose, load_wrenches, make_pose, rotate_vector6
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.plant import PlantOptions, Stabilisation
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel

PUSH = np.array([12.0, -7.0, 5.0, 0.4, -0.3, 0.8])
GRAVITY = (1.0, -2.0, -9.0)  # with a part in the plane of the planar cell
SHARES = {"left": 0.3, "right": 0.7}


@pytest.fixture(params=SCENARIOS)
def name(request):
    return request.param


def built(name, payload="welded", formulation="proximal", body=None):
    cell, _ = cell_and_start(name)
    cell = cell.replace(load_shares=SHARES, gravity=GRAVITY, payload=cell.payload if body is None else body)
    plant = CellChain(cell, PlantOptions(payload=payload, formulation=formulation))
    plant.mechanism.open_allowed = 1.0  # many tests look at the stabilisation, off the closures
    return plant, closed(name, payload)


@functools.cache
def closed(name, payload):
    cell, start = cell_and_start(name)
    q = CellChain(cell, PlantOptions(payload=payload)).configuration(start)
    q.flags.writeable = False
    return q


def arms_of(plant):
    return [
        ArmModel(arm, plant.cell.grasps[key].matrix, plant.cell.gravity)
        for key, arm in plant.cell.arms.items()
    ]


def push_of(plant):
    rows = plant.cell.task_rows
    return rows.expand(rows.select(PUSH))


def gathered(plant, arm_torques):
    tau = np.zeros(plant.mechanism.model.nv)
    for place, torque in zip(plant.model.arms, arm_torques, strict=True):
        tau[place.v_slice] = torque
    return tau


def free_state(welded, free, q, v):
    """The state of the free tree that is exactly the welded one: the payload where the first arm holds it."""
    angles = [q[place.q_slice] for place in welded.model.arms]
    q_free, v_free = (
        free.model.configuration(angles, welded.payload_pose(q)),
        np.zeros(free.mechanism.model.nv),
    )
    for here, there in zip(welded.model.arms, free.model.arms, strict=True):
        v_free[there.v_slice] = v[here.v_slice]
    at = free.mechanism.model.idx_vs[free.model.payload_joint]
    v_free[at : at + 6] = rotate_vector6(welded.payload_pose(q)[:3, :3].T, welded.payload_twist(q, v))
    return q_free, v_free


def off_states(plant, q_closed, gap):
    """States off every closure, within the rows of the cell: across a planar cell no arm could follow."""
    model, rows = plant.mechanism.model, plant.cell.task_rows
    for q, v, torques in states(plant, q_closed, 0.0):
        off = np.random.default_rng(1).uniform(-gap, gap, model.nv)
        if not plant.model.closed_by_tree:
            at = slice(model.idx_vs[plant.model.payload_joint], None)
            off[at] = rows.expand(rows.select(off[at]))
        yield pin.integrate(model, q, off), v + off, torques


def states(plant, q_closed, gap, count=4, seed=8):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = pin.integrate(
            plant.mechanism.model, q_closed, gap * rng.uniform(-1.0, 1.0, plant.mechanism.model.nv)
        )
        v = rng.normal(size=plant.mechanism.model.nv)
        yield (
            q,
            v if gap else plant.mechanism.project_velocity(q, v),
            [10.0 * rng.normal(size=len(place.drive)) for place in plant.model.arms],
        )


@pytest.mark.parametrize("gap", [0.0, 0.04])
@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
def test_welded_and_free_payload_are_the_same_mechanism_on_and_off_the_closures(name, formulation, gap):
    """Off the closures: the free payload in the first arm's grasp, the second grasp open and opening."""
    welded, q_closed = built(name, "welded", formulation)
    free, _ = built(name, "free", formulation)
    rows, push = welded.cell.task_rows, push_of(welded)
    for q, v, torques in states(welded, q_closed, gap):
        q_free, v_free = free_state(welded, free, q, v)
        assert (max(welded.closure_errors(q)[1]) > 1e-3) == (gap > 0.0)
        assert_allclose(free.closure_errors(q_free), welded.closure_errors(q), rtol=1e-9, atol=1e-12)
        answers = []
        for plant, at, moving in ((welded, q, v), (free, q_free, v_free)):
            tau = gathered(plant, torques) + plant.payload_jacobian(at).T @ push
            a = plant.mechanism.forward_dynamics(at, moving, tau).acceleration
            arms = np.concatenate([a[place.v_slice] for place in plant.model.arms])
            answers.append(
                (arms, np.array([rows.select(F) for F in plant.interaction_wrenches(at, moving, tau, push)]))
            )
        scale = 1.0 + np.abs(answers[0][0]).max()
        assert_allclose(answers[1][0], answers[0][0], rtol=0, atol=1e-9 * scale)
        force = 1.0 + np.abs(answers[0][1]).max()
        assert_allclose(answers[1][1], answers[0][1], rtol=0, atol=1e-9 * force)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_configurations_of_both_trees_hold_the_payload_at_the_pose_asked_for(name, payload):
    plant, q = built(name, payload)
    _, start = cell_and_start(name)
    assert_allclose(plant.payload_pose(q), start, rtol=0, atol=1e-10)
    assert_close(plant.closure_errors(q), np.zeros((2, 2)), atol=1e-11)
    for arm, place, position in zip(arms_of(plant), plant.model.arms, plant.tip_positions(q), strict=True):
        assert_allclose(arm.payload_pose(q[place.q_slice]), start, rtol=0, atol=1e-10)
        assert_allclose(arm.tip_pose(q[place.q_slice])[:3, 3], position, rtol=0, atol=1e-12)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_the_trees_payload_twist_is_what_every_arm_sees(name, payload):
    plant, q = built(name, payload)
    v = random_velocity(plant.mechanism, q, 3)
    for arm, place in zip(arms_of(plant), plant.model.arms, strict=True):
        assert_allclose(
            arm.payload_jacobian(q[place.q_slice]) @ v[place.v_slice],
            plant.payload_twist(q, v),
            rtol=0,
            atol=1e-10,
        )


@pytest.mark.parametrize("gap", [0.0, 0.04])
@pytest.mark.parametrize("payload", ["welded", "free"])
def test_the_payload_obeys_newton_and_euler(name, payload, gap):
    """m a_c = m g - sum F + push, d/dt (R I R^T omega) = -sum n + moment; rates by finite differences.

    Off the closures too: an open weld's wrench is still one wrench, on the arm and reversed on the payload.
    """
    plant, q_closed = built(name, payload)
    body, model, push, h = plant.cell.payload, plant.mechanism.model, push_of(plant), 1e-6

    def momentum(q, v):
        R, V = plant.payload_pose(q)[:3, :3], plant.payload_twist(q, v)
        return np.concatenate((body.mass * V[:3], R @ body.inertia_matrix @ R.T @ V[3:]))

    for q, v, torques in off_states(plant, q_closed, gap):
        tau = gathered(plant, torques) + plant.payload_jacobian(q).T @ push
        a = plant.mechanism.forward_dynamics(q, v, tau).acceleration
        after, before = (momentum(pin.integrate(model, q, s * v + s * s / 2 * a), v + s * a) for s in (h, -h))
        weight = np.concatenate((body.mass * np.array(plant.cell.gravity), np.zeros(3)))
        total = push + weight - plant.interaction_wrenches(q, v, tau, push).sum(axis=0)
        assert_allclose(total, (after - before) / (2 * h), rtol=0, atol=1e-7 * (1.0 + np.abs(total).max()))


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
@pytest.mark.parametrize("payload", ["welded", "free"])
def test_every_arm_obeys_dalembert_with_its_own_model(name, payload, formulation):
    """M_i a_i + h_i - J_i^T F_i = tau_i by ArmModel, which knows nothing of the tree: eq. (4)."""
    plant, q_closed = built(name, payload, formulation)
    push, arms = push_of(plant), arms_of(plant)
    for q, v, torques in states(plant, q_closed, 0.0):
        tau = gathered(plant, torques) + plant.payload_jacobian(q).T @ push
        a = plant.mechanism.forward_dynamics(q, v, tau).acceleration
        wrenches = plant.interaction_wrenches(q, v, tau, push)
        for arm, place, F, torque in zip(arms, plant.model.arms, wrenches, torques, strict=True):
            needed = arm.inverse_dynamics(q[place.q_slice], v[place.v_slice], a[place.v_slice], F)
            assert_allclose(needed, torque, rtol=0, atol=1e-9 * (1.0 + np.abs(F).max()))


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_power_of_the_wrenches_is_zero_in_all(name, payload):
    """Grasps are passive: what the arms give, the payload takes (the wrenches share one twist V_WP)."""
    plant, q = built(name, payload)
    v = random_velocity(plant.mechanism, q, 5)
    tau = gathered(plant, [np.ones(len(place.drive)) for place in plant.model.arms])
    wrenches, V = plant.interaction_wrenches(q, v, tau), plant.payload_twist(q, v)
    a = plant.mechanism.forward_dynamics(q, v, tau).acceleration
    arm_power = 0.0
    for arm, place in zip(arms_of(plant), plant.model.arms, strict=True):
        q_i, v_i, a_i = q[place.q_slice], v[place.v_slice], a[place.v_slice]
        arm_power += v_i @ (arm.inverse_dynamics(q_i, v_i, a_i) - tau[place.v_slice])
    assert_allclose(arm_power, wrenches.sum(axis=0) @ V, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_the_wrenches_split_as_equations_7_to_12_say(name, payload):
    plant, q = built(name, payload)
    v = random_velocity(plant.mechanism, q, 7)
    tau = gathered(plant, [np.linspace(-3.0, 5.0, len(place.drive)) for place in plant.model.arms])
    F = plant.interaction_wrenches(q, v, tau)
    shares = plant.cell.shares
    f, delta = internal_wrenches(F, shares), load_wrenches(F, shares)
    assert_allclose(shares, [0.3, 0.7])
    assert_allclose(f[0] + delta[0], F[0], rtol=1e-12, atol=1e-12)
    assert_close(f.sum(axis=0), np.zeros(6), atol=1e-11)
    assert_allclose(f[0], 0.7 * F[0] - 0.3 * F[1], rtol=1e-12, atol=1e-11)
    assert_allclose(delta[1] / 0.7, delta[0] / 0.3, rtol=1e-12)


def squeeze_of(plant, X_WP):
    """A desired internal wrench, in world axes."""
    f_P = np.array([-10.0, 2.0, 3.0, 0.3, -0.2, 0.5])
    f = plant.cell.task_rows.expand(plant.cell.task_rows.select(rotate_vector6(X_WP[:3, :3], f_P)))
    return np.array([f, -f])


@pytest.mark.parametrize("formulation", ["proximal", "kkt"])
@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_static_squeeze_is_felt_as_commanded(name, payload, formulation):
    """tau_i = h_i - J_i^T (f_d_i + c_i m g): nothing moves and the internal wrench is f_d."""
    plant, q = built(name, payload, formulation)
    rows, v = plant.cell.task_rows, np.zeros(plant.mechanism.model.nv)
    weight = np.concatenate((plant.cell.payload.mass * np.array(plant.cell.gravity), np.zeros(3)))
    desired = squeeze_of(plant, plant.payload_pose(q))
    torques = []
    for arm, place, f_d, share in zip(
        arms_of(plant), plant.model.arms, desired, plant.cell.shares, strict=True
    ):
        q_i = q[place.q_slice]
        torques.append(
            arm.nonlinear_effects(q_i, np.zeros(arm.nv))
            - arm.payload_jacobian(q_i).T @ (f_d + share * weight)
        )
    tau = gathered(plant, torques)
    assert_allclose(
        plant.mechanism.forward_dynamics(q, v, tau).acceleration, np.zeros(len(v)), rtol=0, atol=1e-9
    )
    F = plant.interaction_wrenches(q, v, tau)
    measured = internal_wrenches(F, plant.cell.shares)
    assert_allclose([rows.select(f) for f in measured], [rows.select(f) for f in desired], rtol=0, atol=1e-8)
    assert_allclose(F.sum(axis=0), weight, rtol=0, atol=1e-8)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_squeeze_while_accelerating_and_pushed_is_felt_as_commanded(name, payload):
    """Each arm gets the torque of its own motion and of F_i = f_d_i + c_i sum F: eq. (13) read forwards."""
    plant, q = built(name, payload)
    rows, push = plant.cell.task_rows, push_of(plant)
    v, body, X = random_velocity(plant.mechanism, q, 9), plant.cell.payload, plant.payload_pose(q)
    V, A = plant.payload_twist(q, v), rows.expand(rows.select(np.array([0.7, -0.4, 0.5, 1.0, -0.8, 0.6])))
    inertia = X[:3, :3] @ body.inertia_matrix @ X[:3, :3].T
    gyroscopic = np.concatenate((body.mass * A[:3], inertia @ A[3:] + np.cross(V[3:], inertia @ V[3:])))
    total = push + np.concatenate((body.mass * np.array(plant.cell.gravity), np.zeros(3))) - gyroscopic
    desired, expected, torques = squeeze_of(plant, X), [], []
    for arm, place, f_d, share in zip(
        arms_of(plant), plant.model.arms, desired, plant.cell.shares, strict=True
    ):
        q_i, v_i = q[place.q_slice], v[place.v_slice]
        a_i = np.linalg.lstsq(
            arm.payload_jacobian(q_i), A - arm.payload_acceleration_bias(q_i, v_i), rcond=None
        )[0]
        torques.append(arm.inverse_dynamics(q_i, v_i, a_i, f_d + share * total))
        expected.append(a_i)
    tau = gathered(plant, torques) + plant.payload_jacobian(q).T @ push
    a = plant.mechanism.forward_dynamics(q, v, tau).acceleration
    for place, a_i in zip(plant.model.arms, expected, strict=True):
        assert_allclose(a[place.v_slice], a_i, rtol=1e-9, atol=1e-8)
    F = plant.interaction_wrenches(q, v, tau, push)
    assert_allclose(F.sum(axis=0), total, rtol=1e-9, atol=1e-8)
    measured = internal_wrenches(F, plant.cell.shares)
    assert_allclose([rows.select(f) for f in measured], [rows.select(f) for f in desired], rtol=0, atol=1e-7)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_payload_set_later_is_the_payload_built_in(name, payload):
    """Mass, inertia and wrenches change at once, and setting it twice does not add up."""
    lighter = cell_and_start(name)[0].payload.with_mass(1.5)
    changed, q = built(name, payload)
    for body in (lighter.with_mass(40.0), lighter):
        changed.surround(changed.cell.replace(payload=body).surroundings)
    fresh, _ = built(name, payload, body=lighter)
    v = random_velocity(changed.mechanism, q, 1)
    tau = gathered(changed, [np.ones(len(place.drive)) for place in changed.model.arms])
    for ask in (
        lambda plant: plant.mechanism.forward_dynamics(q, v, tau).acceleration,
        lambda plant: kkt_of(plant.mechanism).forward_dynamics(q, v, tau).acceleration,
        lambda plant: plant.interaction_wrenches(q, v, tau),
        lambda plant: plant.mechanism.energy(q, v),
    ):
        assert_allclose(ask(changed), ask(fresh), rtol=1e-9, atol=1e-9)


def test_answers_do_not_change_when_the_plant_is_asked_again(name):
    plant, q = built(name)
    v, tau = random_velocity(plant.mechanism, q, 1), np.ones(plant.mechanism.model.nv)
    questions = [
        lambda q, _v: plant.payload_pose(q),
        lambda q, _v: plant.payload_jacobian(q),
        lambda q, v: plant.payload_twist(q, v),
        lambda q, _v: plant.tip_positions(q),
        lambda q, v: plant.interaction_wrenches(q, v, tau),
    ]
    first = [ask(q, v) for ask in questions]
    kept = [answer.copy() for answer in first]
    for ask in questions:
        ask(q + 0.01, 2.0 * v)
    for answer, copy, ask in zip(first, kept, questions, strict=True):
        assert_allclose(answer, copy, rtol=0, atol=0)
        assert_allclose(ask(q, v), copy, rtol=0, atol=0)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_an_observation_is_what_each_question_answers(name, payload):
    plant, q_closed = built(name, payload)
    push = push_of(plant)
    states = [
        (q, v, gathered(plant, torques) + plant.payload_jacobian(q).T @ push, push)
        for q, v, torques in off_states(plant, q_closed, 0.02)
    ]
    seen = plant.observe(*map(np.array, zip(*states, strict=True)))
    for index, (q, v, tau, _) in enumerate(states):
        assert_allclose(seen.payload_pose[index], plant.payload_pose(q), rtol=0, atol=1e-14)
        assert_allclose(seen.payload_twist[index], plant.payload_twist(q, v), rtol=0, atol=1e-13)
        assert_allclose(seen.tip_position[index], plant.tip_positions(q), rtol=0, atol=1e-14)
        wrenches, energy = plant.interaction_wrenches(q, v, tau, push), plant.mechanism.energy(q, v)
        assert_allclose(seen.interaction_wrench[index], wrenches, rtol=1e-12, atol=1e-10)
        assert_allclose(seen.kinetic_energy[index], energy.kinetic, rtol=1e-12)
        assert_allclose(seen.potential_energy[index], energy.potential, rtol=1e-12, atol=1e-12)
        held = [
            gap
            for key, gap in zip(plant.cell.arms, plant.closure_errors(q), strict=True)
            if key not in plant.model.closed_by_tree
        ]
        assert_allclose(held, plant.mechanism.closure_errors(q), rtol=0, atol=1e-14)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_three_arms_share_a_payload(payload):
    """m - 1 or m closures; the wrenches still balance and every arm still obeys d'Alembert."""
    cell, start = cell_and_start("planar")
    third = cell.arms["left"].replace(base={"xyz": (0.5, 0.9, 0.0)}, posture=(-1.5, 1.0, 0.0))
    grasps = dict(cell.grasps) | {"third": {"xyz": (0.0, 0.02, 0.0)}}
    cell = cell.replace(arms=dict(cell.arms) | {"third": third}, grasps=grasps, load_shares=None)
    plant = CellChain(cell, PlantOptions(payload=payload))
    q = plant.configuration(start)
    v = random_velocity(plant.mechanism, q, 2)
    torques = [np.array([3.0, -2.0, 1.0])] * 3
    tau = gathered(plant, torques)
    answer = plant.mechanism.forward_dynamics(q, v, tau)
    assert answer.rank == (6 if payload == "welded" else 12)
    for arm, place, F in zip(
        arms_of(plant), plant.model.arms, plant.interaction_wrenches(q, v, tau), strict=True
    ):
        needed = arm.inverse_dynamics(
            q[place.q_slice], v[place.v_slice], answer.acceleration[place.v_slice], F
        )
        assert_allclose(needed, torques[0], rtol=0, atol=1e-8)


def test_a_single_arm_carries_its_payload_alone(name):
    """Welded, no closure is left; free, one: the arm moves alike and feels the same."""
    cell, start = cell_and_start(name)
    cell = cell.replace(
        arms={"left": cell.arms["left"]}, grasps={"left": cell.grasps["left"]}, load_shares=None
    )
    welded, free = (CellChain(cell, PlantOptions(payload=payload)) for payload in ("welded", "free"))
    q = welded.configuration(start)
    v = np.random.default_rng(0).normal(size=welded.mechanism.model.nv)
    answers = []
    for plant, (at, moving) in ((welded, (q, v)), (free, free_state(welded, free, q, v))):
        tau = gathered(plant, [np.linspace(-3.0, 5.0, len(v))])
        a = plant.mechanism.forward_dynamics(at, moving, tau).acceleration[plant.model.arms[0].v_slice]
        answers.append((a, cell.task_rows.select(plant.interaction_wrenches(at, moving, tau)[0])))
    assert_allclose(answers[0][0], answers[1][0], rtol=1e-9, atol=1e-9)
    assert_allclose(answers[0][1], answers[1][1], rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_what_rigid_bodies_determine_is_what_both_formulations_agree_on(name, payload):
    """Two planar arms share a weight as their structures like; in space everything is determined."""
    plant, q = built(name, payload)
    determined = plant.rigid.determinate_rows(q)
    expected = [True, True, False, False, False, True] if name == "planar" else [True] * 6
    assert determined.tolist() == expected
    v, tau = random_velocity(plant.mechanism, q, 4), np.ones(plant.mechanism.model.nv)
    F, F_cut = (
        plant.interaction_wrenches(q, v, tau),
        built(name, payload, "kkt")[0].interaction_wrenches(q, v, tau),
    )
    assert_allclose(F[:, determined], F_cut[:, determined], rtol=1e-9, atol=1e-8)


def test_grasps_sit_where_the_description_says(name):
    plant, q = built(name)
    model, data = plant.mechanism.model, plant.mechanism.model.createData()
    pin.framesForwardKinematics(model, data, q)
    X_WP = data.oMf[model.getFrameId("payload")].homogeneous
    for key, grasp in plant.cell.grasps.items():
        X_WE = data.oMf[model.getFrameId(f"payload/{key}")].homogeneous
        assert_close(inverse_pose(X_WP) @ X_WE, grasp.matrix, atol=1e-13)
        assert_close(data.oMf[model.getFrameId(f"{key}/grasp")].homogeneous, X_WE, atol=1e-10)


def test_a_pose_out_of_reach_and_a_wrong_tip_have_their_own_errors(name):
    plant, _ = built(name)
    far = np.eye(4)
    far[:3, 3] = (5.0, 0.0, 0.0)
    with pytest.raises(UnreachablePoseError) as error:
        plant.configuration(far)
    assert error.value.arm == "left"
    arms = dict(plant.cell.arms)
    arms["right"] = arms["right"].replace(tip="tipp")
    with pytest.raises(NameNotFoundError):
        CellChain(plant.cell.replace(arms=arms), PlantOptions(stabilisation=Stabilisation(frequency=1.0)))


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_stated_angles_are_taken_whether_or_not_they_hold_the_payload(name, payload):
    plant, q = built(name, payload)
    angles = {arm.name: arm.angles.of(q[arm.q_slice]) + 0.1 for arm in plant.model.arms}
    X = make_pose((0.3, 0.4, 0.0), (0.0, 0.0, 0.5))
    posed = plant.posed_configuration(angles, X)
    for arm in plant.model.arms:
        assert_close(arm.angles.of(posed[arm.q_slice]), angles[arm.name], atol=1e-14)
    if payload == "free":
        assert_close(plant.payload_pose(posed), X, atol=1e-14)
    last = angles.popitem()[0]
    with pytest.raises(NameNotFoundError) as caught:
        plant.posed_configuration(angles, X)
    assert caught.value.name == last


@pytest.mark.parametrize(
    ("moved", "turned"), [((3e-4, 4e-4, 0.0), 0.0), ((0.0, 0.0, 0.0), 2e-3)], ids=["moved", "turned"]
)
def test_a_tip_off_its_grasp_is_refused_with_distance_and_angle(name, moved, turned):
    """A turn of the payload about its z axis moves a grasp along a chord, by its distance from the axis."""
    plant, q = built(name)
    X = plant.payload_pose(q)
    plant.require_held(q, X, 1e-9)
    off = X.copy()
    off[:3, 3] += moved
    off[:3, :3] = X[:3, :3] @ make_pose((0, 0, 0), (0, 0, turned))[:3, :3]
    lever = np.linalg.norm(plant.cell.grasps["left"].matrix[:2, 3])
    expected = 2.0 * np.sin(turned / 2.0) * lever if turned else 5e-4, turned
    plant.require_held(q, off, 2.0 * max(expected))
    with pytest.raises(OpenClosureError) as caught:
        plant.require_held(q, off, 0.999 * max(expected))
    assert caught.value.closure == "grasp of arm left"
    assert_close((caught.value.distance, caught.value.angle), expected, atol=1e-8)


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_of_two_doors_on_one_hinge_only_the_moment_about_it_is_determined(payload, tmp_path):
    """Arms with fewer joints than rows, in space; the axis goes through P, far from the world's origin."""
    tip = joint("tip", "door", (0.5, 0, 0.1), kind="fixed") + '<link name="tip"/>'
    path = tmp_path / "door.urdf"
    path.write_text(robot(bar("door", "ground", (0, 0, 0)), tip))
    arms, grasps = {}, {}
    for name, height, angle in (("upper", 0.4, 0.0), ("lower", -0.3, 2.0)):
        arms[name] = Arm(
            urdf=str(path),
            tip="tip",
            base=Pose(xyz=(0.5, -0.3, 0.8 + height)),
            posture=(angle,),
            friction="none",
        )
        grasps[name] = Pose(
            xyz=(0.5 * np.cos(angle), 0.5 * np.sin(angle), height + 0.1), rpy=(0.0, 0.0, angle)
        )
    cell = Cell(arms=arms, payload=Payload.box(2.0, (0.1, 0.2, 0.3)), grasps=grasps)
    plant = CellChain(cell, PlantOptions(payload=payload))
    X_WP = np.eye(4)
    X_WP[:3, 3] = (0.5, -0.3, 0.8)
    q = plant.model.configuration([np.array([0.0]), np.array([2.0])], X_WP)
    assert_close(plant.closure_errors(q), np.zeros((2, 2)), atol=1e-12)
    assert plant.rigid.determinate_rows(q).tolist() == [False, False, False, False, False, True]
    tau = gathered(plant, [np.array([3.0]), np.array([-1.0])])
    moments = plant.interaction_wrenches(q, np.zeros(plant.mechanism.model.nv), tau)[:, 5]
    own = 1.0 / 3.0  # of each door about the hinge
    turn = 2.0 / (2.0 * own + cell.payload.inertia[2])
    assert_close(moments, [own * turn - 3.0, own * turn + 1.0], atol=1e-9)


@pytest.mark.parametrize("payload", ["welded", "free"])
@pytest.mark.parametrize("kind", ["planar lift", "spatial lift", "planar wheels", "spatial wheels"])
def test_what_joints_under_arms_hold_and_move_is_that_of_a_payload_in_parts(kind, payload, tmp_path):
    """Each arm with its share of the payload fixed to its hand: gravity, and the diagonal of M."""
    make, joints = {"planar": (planar_cell, ("rail", "yaw")), "spatial": (spatial_cell, ("lift", "yaw"))}[
        kind.split()[0]
    ]
    if kind.endswith("wheels"):
        cell = rolling_cell(kind.split()[0]).replace(load_shares=SHARES)
        X_WP = cell_and_start(kind.split()[0])[1]
    else:
        cell = make(tmp_path, **{joint: SharedJoint() for joint in joints})
        X_WP = cell.payload_pose.matrix
    chain, P = CellChain(cell, PlantOptions(payload=payload)), pin.SE3(X_WP)
    q, model = chain.configuration(X_WP), chain.model.model.copy()
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    model.inertias[chain.model.payload_joint] = chain.model.carrier_inertia
    for slot, c in zip(chain.model.arms, cell.shares, strict=True):
        part = pin.Inertia(c * cell.payload.mass, np.zeros(3), c * cell.payload.inertia_matrix)
        model.appendBodyToJoint(slot.joints[-1], part, data.oMi[slot.joints[-1]].actInv(P))
    rows, data = [slot.v_slice.start for slot in chain.model.shared], model.createData()
    holding, inertia = chain.shared_statics(q, chain.loads(q))
    assert_allclose(holding, pin.computeGeneralizedGravity(model, data, q)[rows], atol=1e-8)
    assert_allclose(inertia, np.diag(pin.crba(model, data, q))[rows], rtol=1e-8)
