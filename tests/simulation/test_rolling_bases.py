"""Differential bases: rolling, dynamics, forces on the wheels, what arms are told, findings and refusals."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cells import random_velocity
from numpy.testing import assert_allclose
from rollers import STARTS, PlanarRobot, rolling_cell
from tiers import by_default

import coop_pin as cp
from coop_pin.actuators import DifferentialBase, Steering
from coop_pin.base.errors import ArgumentError, FieldError, ScenarioError
from coop_pin.chain import Rolling
from coop_pin.control import ArmController
from coop_pin.feasibility.carried_motion import displacement, seen_by_arms
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.running.carrier_findings import carrier_findings

NAMES = ["planar", "spatial"]
WHEELS = Rolling("x", "y", "yaw")


def platform(centre):
    """A platform of 100 kg and 8 kg m^2 alone, on joints along x, along y and about z."""
    model, joint = pin.Model(), 0
    kinds = {"x": pin.JointModelPX(), "y": pin.JointModelPY(), "yaw": pin.JointModelRZ()}
    for name, kind in kinds.items():
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
    body = pin.Inertia(100.0, np.array((centre, 0.0, 0.2)), np.diag((5.0, 6.0, 8.0)))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return cp.ClosedChain(model, [], rolling=[WHEELS])


def slip(theta, v):
    """Speed across the heading, from x, y and yaw."""
    return np.cos(theta) * v[..., 1] - np.sin(theta) * v[..., 0]


# ---------------------------------------------------------------- a platform alone


def test_a_platform_rolls_on_the_circle_of_its_speed_and_turn_rate():
    """Free of forces: v / omega = 0.5 m, for half a turn; it neither slides nor loses energy."""
    chain, (v, w) = platform(0.0), (1.0, 2.0)
    motion = chain.integrate([0.0] * 3, [v, 0.0, w], duration=np.pi / 2.0, step=1e-3)
    theta = w * motion.time
    circle = v / w * np.column_stack((np.sin(theta), 1.0 - np.cos(theta)))
    assert_allclose(motion.q[:, 2], theta, rtol=0, atol=1e-11)
    assert_allclose(motion.q[:, :2], circle, rtol=0, atol=1e-11)
    assert np.abs(slip(motion.q[:, 2], motion.v)).max() < 1e-12
    assert np.ptp([chain.energy(q, u).total for q, u in zip(motion.q, motion.v, strict=True)]) < 1e-9


def test_a_platform_whose_mass_is_ahead_of_its_axle_obeys_the_closed_form():
    """v' = c w^2 and w' = -m c v w / (I + m c^2), and the ground's side force m (v w + c w')."""
    c, v, w, theta = 0.15, 1.0, 2.0, 0.7
    chain, e = platform(c), np.array((np.cos(theta), np.sin(theta)))
    q, rates = np.array((0.3, -0.2, theta)), np.array((*(v * e), w))
    a = chain.forward_dynamics(q, rates, np.zeros(3)).acceleration
    w_rate = -100.0 * c * v * w / (8.0 + 100.0 * c * c)
    assert_allclose(e @ a[:2], c * w * w, rtol=1e-12)
    assert_allclose(a[2], w_rate, rtol=1e-12)
    n = np.array((-e[1], e[0]))
    force = pin.rnea(chain.model, chain.model.createData(), q, rates, a)
    assert_allclose(force[:2] @ n, 100.0 * (v * w + c * w_rate), rtol=1e-12)
    assert_allclose([force[:2] @ e, force[2]], 0.0, rtol=0, atol=1e-11)


def test_rows_of_rolling_bind_velocities_and_no_pose():
    chain = platform(0.1)
    q = chain.project_configuration([3.0, -2.0, 1.0])
    assert_allclose(q, (3.0, -2.0, 1.0), rtol=0, atol=0)
    rates = chain.project_velocity(q, [0.3, 0.8, 0.2])
    assert abs(slip(1.0, rates)) < 1e-15
    state, h = chain.closures.state(q, rates), 1e-6
    assert_allclose(state.position, 0.0, rtol=0, atol=0)
    ends = [chain.closures.state(q + s * h * rates, rates).velocity for s in (1, -1)]
    assert_allclose(state.drift, (ends[0] - ends[1]) / (2.0 * h), rtol=0, atol=1e-8)
    with pytest.raises(ArgumentError, match="kkt"):
        cp.ClosedChain(chain.model, [], rolling=[WHEELS], formulation="proximal")
    with pytest.raises(ArgumentError, match="parked"):
        chain.linearise(q, np.zeros(3), np.zeros(3))
    with pytest.raises(ArgumentError, match="forward_dynamics"):
        chain.derivatives(q, np.zeros(3), np.zeros(3))


# ---------------------------------------------------------------- arms on bases that hold one payload


def rolling_state(name, seed=4, **fields):
    """A cell away from its start, in motion, with forces of all drives."""
    cell, rng = rolling_cell(name, **fields), np.random.default_rng(seed)
    chain = CellChain(cell)
    model = chain.model.model
    q = chain.configuration(STARTS[name])
    dq = 0.4 * random_velocity(chain.mechanism, q, seed)
    q = chain.mechanism.project_configuration(pin.integrate(model, q, dq))
    v = random_velocity(chain.mechanism, q, seed + 1)
    return cell, chain, q, v, rng.normal(scale=20.0, size=model.nv)


def second_formulation(cell, chain, q, v, tau):
    """Accelerations of x, y, yaw and joints of each robot, and wrenches on tips, by planar joints and a KKT.

    Velocities of the platforms are in their own axes, where rolling is v_y = 0; the payload is free.
    """
    tree, X_WP, V = chain.model, chain.payload_pose(q), chain.payload_twist(q, v)
    R, om, m = X_WP[:3, :3], V[3:], cell.payload.mass
    inertia = R @ cell.payload.inertia_matrix @ R.T
    blocks, forces, turns, tips = [], [], [], []
    for slot in tree.arms:
        x, _, yaw = tree.wheels[slot.name]
        base = slice(x.v_slice.start, yaw.v_slice.stop)
        robot = PlanarRobot(cell, slot.name)
        M, h, X, J, drift, body, turn = robot.terms(q[base], v[base], q[slot.q_slice], v[slot.v_slice])
        assert abs(body[1]) < 1e-12
        wheel = cell.wheels[slot.name]  # each turns at (v -+ omega track / 2) / r
        M[0, 0] += 2.0 * wheel.wheel_inertia / wheel.wheel_radius**2
        M[2, 2] += 0.5 * wheel.wheel_inertia * (wheel.track / wheel.wheel_radius) ** 2
        blocks.append(M)
        forces.append(np.r_[turn @ tau[base][:2], tau[base][2], tau[slot.v_slice]] - h)
        turns.append((base, slot.v_slice, turn, body))
        tips.append((X, J, drift))
    sizes = [len(M) for M in blocks]
    n = sum(sizes) + 6
    M, rows, bias, first = np.zeros((n, n)), [], [], 0
    M[-6:-3, -6:-3], M[-3:, -3:] = m * np.eye(3), inertia
    gyration = np.r_[m * np.array(cell.gravity), -np.cross(om, inertia @ om)]
    for block, (X, J, drift) in zip(blocks, tips, strict=True):
        k = len(block)
        M[first : first + k, first : first + k] = block
        r = X[:3, 3] - X_WP[:3, 3]
        row, no_slip = np.zeros((6, n)), np.zeros((1, n))
        row[:, first : first + k], row[:, -6:] = J, -np.eye(6)
        row[:3, -3:] = np.array(((0, -r[2], r[1]), (r[2], 0, -r[0]), (-r[1], r[0], 0)))
        no_slip[0, first + 1] = 1.0
        rows += [row, no_slip]
        bias += [drift - np.r_[np.cross(om, np.cross(om, r)), 0.0, 0.0, 0.0], np.zeros(1)]
        first += k
    A, b = np.vstack(rows), np.concatenate(bias)
    K = np.block([[M, A.T], [A, np.zeros((len(A), len(A)))]])
    solution = np.linalg.lstsq(K, np.r_[np.concatenate(forces), gyration, -b], rcond=1e-13)[0]
    a, side, first = np.zeros(tree.model.nv), [], 0
    for number, (base, joints, turn, body) in enumerate(turns):
        mine = solution[first : first + sizes[number]]
        # of a velocity in turning axes: x'' = R (v' + w x v)
        a[base][:2] = turn.T @ (mine[:2] + body[2] * np.array((-body[1], body[0])))
        a[base][2], a[joints] = mine[2], mine[3:]
        side.append(-solution[n + 7 * number + 6] + (turn @ tau[base][:2])[1])  # the drives' part, too
        first += sizes[number]
    return a, side


@pytest.mark.parametrize("wheel_inertia", [0.0, 0.4])
@pytest.mark.parametrize("name", NAMES)
def test_accelerations_and_side_forces_are_those_of_a_second_formulation(name, wheel_inertia):
    cell, chain, q, v, tau = rolling_state(name, wheel_inertia=wheel_inertia, track=0.44)
    a = chain.acceleration(q, v, tau)[0]
    expected, side = second_formulation(cell, chain, q, v, tau)
    assert_allclose(a, expected, rtol=0, atol=1e-10 * np.abs(a).max())
    seen = chain.observe(q[None], v[None], tau[None], np.zeros((1, 6)))
    assert_allclose(seen.wheel_force[0, :, 1], side, rtol=0, atol=1e-8 * (1.0 + np.abs(side).max()))


@pytest.mark.parametrize("name", NAMES)
def test_the_ground_bears_momentum_and_weight_of_the_whole_cell(name):
    cell, chain, q, v, tau = rolling_state(name)
    model, data = chain.model.model, chain.model.model.createData()
    a = chain.acceleration(q, v, tau)[0]
    seen = chain.observe(q[None], v[None], tau[None], np.zeros((1, 6)))
    total = np.zeros(3)
    for arm, force in zip(cell.wheels, seen.wheel_force[0], strict=True):
        theta = q[chain.model.wheels[arm][-1].q_slice.start]
        total += cell.arms[arm].base.matrix[:3, :3] @ pin.utils.rotate("z", theta) @ force
    pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
    mass = sum(inertia.mass for inertia in model.inertias)
    assert_allclose(total, data.dhg.linear - mass * np.array(cell.gravity), rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_is_told_where_its_base_is_and_sees_the_payload_there(name):
    cell, _, q, v, _ = rolling_state(name)
    run = cp.Simulation(carry(cell, name))
    run.observe()
    run.plant.restore(run.plant.state()._replace(q=q, v=v))
    inputs = run.observe()
    measured = run.sensing.start(q, v, inputs.references, inputs.signals.sensors)
    rows = cell.task_rows
    X, V = run.chain.payload_pose(q), rows.select(run.chain.payload_twist(q, v))
    for slot, reading in zip(run.slots, measured, strict=True):
        x, _, yaw = run.chain.model.wheels[slot.name]
        assert_allclose(reading.shared_position, q[x.q_slice.start : yaw.q_slice.stop], rtol=0, atol=1e-15)
        assert_allclose(reading.payload_pose, X, rtol=0, atol=1e-12)
        assert_allclose(reading.payload_twist, V, rtol=0, atol=1e-12)
        own = reading.payload_jacobian @ slot.drive @ v[slot.v_slice]
        assert_allclose(own + reading.carried_twist, V, rtol=0, atol=1e-12)


# ---------------------------------------------------------------- runs


def carry(cell, name, **fields):
    """Carry the payload 0.04 m along and 0.02 m across the first heading, turned by 0.03 rad, in 0.8 s."""
    X, turned = cp.Pose.from_matrix(STARTS[name]), STARTS[name].copy()
    turned[:3] = np.column_stack(
        (pin.utils.rotate("z", 0.03) @ turned[:3, :3], turned[:3, 3] + (0.04, 0.02, 0.0))
    )
    goal = cp.Pose.from_matrix(turned)
    motion = {"kind": "line", "start": X, "goal": goal, "start_time": 0.2, "duration": 0.8}
    gains = {"planar": (3000.0, 3000.0, 150.0), "spatial": (3000.0, 3000.0, 3000.0, 60.0, 60.0, 60.0)}[name]
    law = {"kind": "payload-space", "force_path": {"kind": "late"}}
    law["gains"] = {
        "pose_gain": 10.0,
        "sliding_gain": gains,
        "sign_gain": 0.5,
        "anchor_gain": 0.1,
        "transient_rate": 5.0,
    }
    common = {"name": "carry", "cell": cell, "controller": law, "motion": motion, "start": X}
    common |= {"task": {"moment": 0.5}, "duration": 1.0, "clock": {"rate_hz": 500.0, "steps_per_tick": 2}}
    return cp.Scenario(**common | fields)


def slips(result):
    """Speed across the heading of each base at each sample, m/s."""
    position, rates = (
        result.data[f"shared_{name}"].values.reshape(-1, 3) for name in ("position", "velocity")
    )
    return slip(position[:, 2], rates)


def moving_errors(result):
    """Largest position error, m, and internal force, N, from 0.2 s on, when the motion begins."""
    data, rows = result.data, result.data.time.values > 0.2
    force = np.linalg.norm(np.nan_to_num(data.internal_wrench.values[rows][..., :3]), axis=-1)
    return np.linalg.norm(data.pose_error.values[rows, :3], axis=-1).max(), force.max()


@pytest.mark.parametrize("name", by_default(NAMES, "planar"))
def test_bases_that_follow_the_payload_roll_disturb_nothing_and_the_books_balance(name):
    result = cp.run(carry(rolling_cell(name), name), warn=False)
    position, force = moving_errors(result)
    assert np.abs(slips(result)).max() < 1e-12
    assert result.metrics()["energy_balance_max_J"] < 1e-5
    assert result.metrics()["closure_error_max_m"] < 1e-9
    assert position < 2e-3
    assert force < 1.0
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


class Holding(ArmController):
    """Holds its arm at rest by constant torques, until the brakes do."""

    def __init__(self, scenario, arm):
        pass

    def init(self, measurement, reference):
        return measurement.holding_torque

    def step(self, measurement, reference, state):
        return cp.ArmCommand(state, state)


def one_arm(name, **fields):
    """The left arm with the payload on a rolling base, its joints braked; the law of the base drives it."""
    cell = rolling_cell(name, **fields)
    parts = {part: {"left": getattr(cell, part)["left"]} for part in ("arms", "grasps")}
    X = cp.Pose.from_matrix(STARTS[name])
    common = {"name": "alone", "cell": cell.replace(**parts, load_shares=None), "start": X, "squeeze": {}}
    common |= {"motion": {"kind": "hold", "pose": X}, "clock": {"rate_hz": 100.0, "steps_per_tick": 3}}
    common["duration"] = 1.3
    braked = [cp.events.LoseArm(arm="left", time=0.0, form="braked")]
    return cp.Scenario(**common, controller=cp.UserController(target=Holding), events=braked)


@pytest.mark.parametrize("name", by_default(NAMES, "planar"))
def test_on_a_circle_the_ground_holds_the_wheels_with_m_v_omega(name):
    """m (v w - w^2 c_y + w' c_x) with the centre of mass c of platform, arm and payload; an arc of v / w."""
    v, w = 0.6, -0.5
    scenario = one_arm(name, follow=Steering(speed=v, turn_rate=w, duration=4.0, ramp=0.5))
    result = cp.run(scenario, warn=False)
    data, robot = result.data, PlanarRobot(scenario.cell, "left")
    q = np.r_[0.0, 0.0, 1.0, 0.0, data.joint_position.values[-1, 0]]
    body, load = pin.centerOfMass(robot.model, robot.data, q).copy(), scenario.cell.payload.mass
    own = sum(inertia.mass for inertia in robot.model.inertias)
    mass = own + load
    centre = np.append((own * body + load * STARTS[name][:3, 3]) / mass, 1.0)
    c_x, c_y, *_ = np.linalg.solve(scenario.cell.arms["left"].base.matrix, centre)
    x, y, theta = data.shared_position.values.T
    x_rate, y_rate, w_is = data.shared_velocity.values.T
    v_is = np.cos(theta) * x_rate + np.sin(theta) * y_rate
    v_rate, w_rate = (np.gradient(rate, data.time.values) for rate in (v_is, w_is))
    steady = data.time.values > 1.0
    ahead, side, up = data.wheel_force.values[steady, 0].T
    expected = mass * (v_is * w_is - w_is**2 * c_y + w_rate * c_x)
    assert_allclose(side, expected[steady], rtol=0, atol=5e-2)
    assert_allclose(side, mass * (v * w - w * w * c_y), rtol=2e-2)
    assert_allclose(ahead, mass * (v_rate - w_is**2 * c_x - w_rate * c_y)[steady], rtol=0, atol=0.2)
    assert_allclose(up, 9.81 * mass, rtol=1e-6)
    assert_allclose(np.hypot(x, y - v / w), abs(v / w), rtol=0, atol=5e-3)
    assert np.abs(slips(result)).max() < 1e-12
    assert result.metrics()["energy_balance_max_J"] < 1e-5
    assert result.simulation_sound


@pytest.mark.parametrize(
    "fields", [{"speed": 0.7, "turn_rate": 0.5}, {"wheels": (3.0, 5.0)}, {"speed": -0.4}]
)
def test_a_steering_is_the_way_of_a_unicycle(fields):
    """Against the unicycle's equations by scipy; r' and r'' against differences."""
    from scipy.integrate import solve_ivp

    base = DifferentialBase(follow=Steering(duration=4.0, ramp=1.5, start_time=0.2, **fields), track=0.4)
    v, w = base.steered(base.follow)
    if "wheels" in fields:
        left, right = fields["wheels"]
        assert_allclose((v, w), (0.1 * (left + right) / 2.0, 0.1 * (right - left) / 0.4), rtol=1e-12)

    def unicycle(t, state):
        s = base.follow.profile(t)[0]
        return s * v * np.cos(state[2]), s * v * np.sin(state[2]), s * w

    still = cp.motions.HoldMotion(pose=cp.Pose()).at(0.0)
    way = solve_ivp(
        unicycle, (0.0, 4.5), np.zeros(3), rtol=1e-11, atol=1e-12, dense_output=True, max_step=0.1
    )
    for time in (0.1, 0.9, 2.3, 3.6, 4.5):
        at, h = base.reference(time, np.eye(4), still, np.eye(4)), 1e-5
        x, y, theta = way.sol(time)
        ahead = base.ahead * np.array((np.cos(theta), np.sin(theta)))
        assert_allclose(at[0], np.array((x, y)) + ahead, rtol=0, atol=1e-8)
        ends = [base.reference(time + s * h, np.eye(4), still, np.eye(4)) for s in (1, -1)]
        assert_allclose(at[1:], (ends[0][:2] - ends[1][:2]) / (2.0 * h), rtol=0, atol=1e-8)


def test_a_base_that_follows_the_payload_stays_with_its_place_on_it():
    """r is the place on the payload, r' and r'' its velocity and acceleration, in turned axes of B."""
    base, h = DifferentialBase(), 1e-5
    X_WB = cp.Pose(xyz=(0.3, -0.2, 0.0), rpy=(0.0, 0.0, 0.8)).matrix
    pose = cp.Pose(xyz=(1.0, 0.5, 0.7), rpy=(0.1, 0.2, 0.3))
    motion = cp.motions.TurnMotion(pose=pose, axis=(0.1, 0.2, 1.0), angle=1.2, duration=3.0, centre=(0, 2, 0))
    begin = motion.at(0.0).X_WP_d
    b = X_WB[:3, 3] + base.ahead * X_WB[:3, 0]
    on_payload = np.linalg.solve(begin, np.append(b, 1.0))
    for time in (0.3, 1.1, 2.0):
        at = base.reference(time, X_WB, motion.at(time), begin)
        in_base = np.linalg.solve(X_WB, motion.at(time).X_WP_d @ on_payload)
        assert_allclose(at[0], in_base[:2], rtol=0, atol=1e-12)
        ends = [base.reference(t, X_WB, motion.at(t), begin) for t in (time + h, time - h)]
        assert_allclose(at[1:], (ends[0][:2] - ends[1][:2]) / (2.0 * h), rtol=0, atol=1e-7)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.3), (0.1, -0.2, 0.3)], ids=["planar", "spatial"])
def test_a_base_goes_to_a_stated_place_on_the_payload(turn):
    """r begins where b starts and ends at the place; r' and r'' against differences, on a turning payload."""
    place = cp.actuators.PlaceOnPayload(place=(-0.5, 0.4, -0.2), start_time=0.4, duration=1.5)
    base, h = DifferentialBase(follow=place), 1e-5
    X_WB = cp.Pose(xyz=(0.3, -0.2, 0.0), rpy=(0.0, 0.0, 0.8)).matrix
    axis = (0.0, 0.0, 1.0) if turn[0] == 0.0 else (0.1, 0.2, 1.0)
    pose = cp.Pose(xyz=(1.0, 0.5, 0.7), rpy=turn)
    motion = cp.motions.TurnMotion(pose=pose, axis=axis, angle=1.2, duration=3.0, centre=(0, 2, 0))
    begin = motion.at(0.0).X_WP_d
    assert_allclose(base.reference(0.0, X_WB, motion.at(0.0), begin)[0], (base.ahead, 0.0), atol=1e-15)
    for time in (0.2, 0.7, 1.3, 2.5):
        at = base.reference(time, X_WB, motion.at(time), begin)
        ends = [base.reference(t, X_WB, motion.at(t), begin) for t in (time + h, time - h)]
        assert_allclose(at[1:], (ends[0][:2] - ends[1][:2]) / (2.0 * h), rtol=0, atol=1e-7)
    in_base = np.linalg.solve(X_WB, motion.at(2.5).X_WP_d @ (*place.place, 1.0))
    assert_allclose(at[0], in_base[:2], rtol=0, atol=1e-12)


def rounding(name):
    """A carry along an arc by 0.3 rad about a point aside; the left base goes 4 cm along and 3 across."""
    cell = rolling_cell(name)
    X = cp.Pose.from_matrix(STARTS[name])
    start, base = cell.arms["left"].base.matrix, cell.arms["left"].mobile_base
    b = np.linalg.solve(X.matrix, start @ (base.ahead, 0.0, 0.0, 1.0))[:3]
    up = X.matrix[:3, :3].T @ start[:3, :3]
    place = b + up @ (0.04, 0.03, 0.0)
    way = cp.actuators.PlaceOnPayload(place=tuple(place), start_time=0.2, duration=1.2)
    left = cell.arms["left"].replace(mobile_base=base.replace(follow=way))
    axis, centre = tuple(start[:3, 2]), tuple(X.matrix[:3, 3] + start[:3, :3] @ (0.0, 0.6, 0.0))
    turn = {"kind": "turn", "pose": X, "axis": axis, "angle": 0.3, "centre": centre}
    motion = turn | {"start_time": 0.2, "duration": 1.4}
    return carry(cell.replace(arms=cell.arms | {"left": left}), name, motion=motion, duration=2.0), place


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.gate) for name in NAMES])
def test_a_base_rounds_a_corner_to_its_stated_place(name):
    """Its point is there in the end; the payload keeps to its path; rolling to rounding, books balance."""
    scenario, place = rounding(name)
    result = cp.run(scenario, warn=False)
    position, force = moving_errors(result)
    assert np.abs(slips(result)).max() < 1e-12
    assert result.metrics()["energy_balance_max_J"] < 1e-5
    assert position < 2e-3
    assert force < 1.0
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    base, X_WB = scenario.cell.wheels["left"], scenario.cell.arms["left"].base.matrix
    x, y, theta = result.data.shared_position.values[-1, :3]
    b = X_WB @ (x + base.ahead * np.cos(theta), y + base.ahead * np.sin(theta), 0.0, 1.0)
    over = scenario.payload_motion.at(2.0).X_WP_d @ (*place, 1.0)
    away = np.linalg.solve(X_WB, b - over)[:2]
    assert np.linalg.norm(away) < 2e-3
    (finding,) = [each for each in carrier_findings(scenario) if "another base" in each.sentence]
    assert finding.place == "cell.arms.right.mobile_base"


def test_displacement_is_the_way_of_a_base_to_its_stated_place():
    """D takes b over the place; that of the other base, which stays where it is on the payload, differs."""
    for name in NAMES:
        scenario, place = rounding(name)
        arms, wheels = scenario.cell.arms, scenario.cell.wheels
        b = arms["left"].base.matrix @ (wheels["left"].ahead, 0.0, 0.0, 1.0)
        X_WB = arms["left"].base.matrix
        for time in (1.7, 2.0):
            moved = np.linalg.solve(X_WB, displacement(scenario, time) @ b)
            over = np.linalg.solve(X_WB, scenario.payload_motion.at(time).X_WP_d @ (*place, 1.0))
            assert_allclose(moved[:2], over[:2], rtol=0, atol=1e-9)
        apart = displacement(scenario, 2.0) @ b - displacement(scenario, 2.0, "right") @ b
        assert np.linalg.norm(apart) == pytest.approx(0.05, abs=1e-3)


def test_the_law_of_a_base_linearises_the_motion_of_its_point():
    """b' = u and u' is that of the command; the torques of the wheels make the force, within their limits."""
    base, rng = DifferentialBase(wheel_torque="none"), np.random.default_rng(1)
    pose, reference = rng.normal(size=3), rng.normal(size=(3, 2))
    h, d, k = 1e-6, base.ahead, base.position_gain

    def point(at):
        return at[:2] + d * np.array((np.cos(at[2]), np.sin(at[2])))

    def rates(at, command):
        return np.array((command[0] * np.cos(at[2]), command[0] * np.sin(at[2]), command[1]))

    command = base.command(pose, np.zeros(3), reference)
    moving = rates(pose, command.rates)
    ends = [point(pose + s * h * moving) for s in (1, -1)]
    expected = reference[1] + k * (reference[0] - point(pose))
    assert_allclose((ends[0] - ends[1]) / (2.0 * h), expected, rtol=0, atol=1e-8)
    command = base.command(pose, moving, reference)  # as it moves as commanded, its derivative is told
    later = [
        base.command(pose + s * h * moving, moving, np.array((r, *reference[1:]))).rates
        for s in (1, -1)
        for r in [reference[0] + s * h * reference[1]]
    ]
    drift = (later[0] - later[1]) / (2.0 * h)
    e = np.array(((np.cos(pose[2]), np.sin(pose[2])), (-np.sin(pose[2]), np.cos(pose[2]))))
    assert_allclose(command.accelerations - drift, e @ reference[2] / (1.0, d), rtol=0, atol=1e-7)
    inertia = np.array((150.0, 9.0))
    force = base.force(pose, moving, command, inertia)
    assert_allclose(force, inertia * command.accelerations, rtol=0, atol=1e-9)
    left, right = np.linalg.solve(base.to_wheels.T, force)
    assert_allclose(force, ((left + right) / 0.1, (right - left) * 0.5 / 0.2), rtol=1e-12)
    weak = base.replace(wheel_torque=0.5 * max(abs(left), abs(right)))
    F, M = weak.force(pose, moving, command, inertia)
    assert max(abs(F * 0.1 / 2 - M * 0.2), abs(F * 0.1 / 2 + M * 0.2)) <= weak.wheel_torque * (1.0 + 1e-12)


# ---------------------------------------------------------------- findings, verdict, refusals


def findings_of(scenario):
    return [finding for finding in carrier_findings(scenario) if finding.severity != "note"]


def led(scenario, x, y, duration=3.0):
    """The payload is led by (x, y) in the axes of the world."""
    X = scenario.start
    goal = X.replace(xyz=(X.xyz[0] + x, X.xyz[1] + y, X.xyz[2]))
    return scenario.replace(
        motion={"kind": "line", "start": X, "goal": goal, "start_time": 0.2, "duration": duration}
    )


def alone_on_wheels(name, **fields):
    """One arm on a base that follows its payload, with a law."""
    cell = rolling_cell(name, **fields)
    parts = {part: {"left": getattr(cell, part)["left"]} for part in ("arms", "grasps")}
    return carry(cell.replace(**parts, load_shares=None), name)


@pytest.mark.parametrize("name", NAMES)
def test_a_way_that_wheels_do_not_roll_is_told_and_its_remedy_works(name):
    ahead = led(alone_on_wheels(name), 0.5, 0.0)
    assert findings_of(ahead) == []
    for x, y in ((0.0, 0.5), (-0.5, 0.01)):
        scenario = led(ahead, x, y)
        (finding,) = findings_of(scenario)
        assert (finding.kind, finding.severity) == ("rolling base", "warning")
        assert_allclose(finding.value, np.arctan2(y, x), rtol=0, atol=0.02)
        cured = scenario.override(finding.remedy)
        assert findings_of(cured) == []
        root, before = (each.cell.arms["left"] for each in (cured, scenario))
        mounts = [arm.base.matrix @ (arm.mobile_base.ahead, 0.0, 0.0, 1.0) for arm in (root, before)]
        assert_allclose(*mounts, rtol=0, atol=1e-12)  # the arm stays where it is


def test_wheels_that_turn_too_fast_or_would_slide_are_told():
    scenario = led(alone_on_wheels("spatial", wheel_speed=2.0), 0.2, 0.0, 0.6)
    (finding,) = findings_of(scenario)
    assert_allclose(finding.value, 0.2 * 1.875 / 0.6 / 0.1, rtol=0.02)  # of the quintic, over the radius
    turn = Steering(speed=2.0, turn_rate=4.0, duration=3.0)
    steered = one_arm("planar", follow=turn, wheel_speed=100.0).override({"duration": 3.0})
    (finding,) = findings_of(steered)
    assert_allclose(finding.value, 8.0 / 9.81, rtol=1e-3)
    assert finding.limit == 0.6


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("fast", [{"bandwidth": 1200.0}, {"position_gain": 3000.0}])
def test_a_servo_that_is_too_fast_is_told_and_its_remedy_works(name, fast):
    scenario = led(alone_on_wheels(name, **fast), 0.3, 0.0)
    (finding,) = findings_of(scenario)
    assert finding.severity == "error"
    assert findings_of(scenario.override(finding.remedy)) == []


@pytest.mark.parametrize("name", NAMES)
def test_a_base_that_its_arm_is_not_told_of_is_an_error_with_a_cure(name):
    scenario = carry(rolling_cell(name), name)
    silent = scenario.replace(sensors={"shared_joints": "not told"})
    usual = len(findings_of(scenario))  # of the right base, which the payload leads backwards
    finding = findings_of(silent)[0]
    assert (finding.severity, finding.place) == ("error", "sensors.shared_joints")
    assert len(findings_of(silent)) == usual + 1
    assert len(findings_of(silent.override(finding.remedy))) == usual
    one = scenario.replace(arm_sensors={"left": {"shared_joints": {"told": "position"}}})
    finding = findings_of(one)[0]
    assert finding.place == "sensors.shared_joints"
    assert finding.severity == "warning"


@pytest.mark.parametrize("name", by_default(NAMES, "planar"))
def test_the_verdict_names_wheels_that_would_slide(name):
    turn = Steering(speed=0.6, turn_rate=-0.5, duration=4.0, ramp=0.5)
    scenario = one_arm(name, follow=turn, friction=0.02).override({"duration": 0.6})
    result = cp.run(scenario, warn=False)
    (slip_found,) = (breach for breach in result.task.deviations if breach.cause == "wheel slip")
    assert (slip_found.arm, slip_found.joint) == ("left", "")
    force = np.linalg.norm(result.data.wheel_force.values[:, 0, :2], axis=-1)
    borne = 0.02 * result.data.wheel_force.values[:, 0, 2]
    assert_allclose(slip_found.time, result.data.time.values[np.argmax(force > borne)], rtol=0, atol=1e-9)
    assert_allclose(slip_found.value, force[np.argmax(force - borne)], rtol=1e-12)


@pytest.mark.parametrize("name", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
def test_law_23_takes_off_what_its_base_does(name):
    """Told of the bases, it keeps the path; without the twist of its base it is off by more."""
    scenario = carry(rolling_cell(name), name, duration=0.6)
    gains = {"pose_gain": 8.0, "damping_gain": 60.0 if name == "planar" else (200.0,) * 3 + (20.0,) * 3}
    gains |= {"sign_gain": 0.05, "force_gain": 0.0, "transient_rate": 5.0}
    law = {"kind": "sliding-mode", "gains": gains}
    errors = []
    for told in ("all", "position"):
        sensors = {"shared_joints": {"told": told}}
        result = cp.run(scenario.replace(controller=law, sensors=sensors), warn=False)
        errors.append(moving_errors(result)[0])
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.parametrize("name", NAMES)
def test_a_parked_base_is_an_arm_on_a_fixed_one(name):
    cell = rolling_cell(name, follow="parked")
    lifted = {
        each: arm.replace(
            mobile_base=None, base=cp.Pose.from_matrix(arm.tip_poses(rest) @ np.linalg.inv(tip))
        )
        for each, arm in cell.arms.items()
        for rest in [np.zeros(len(arm.moving_joints()))]
        for tip in [arm.replace(mobile_base=None, base=cp.Pose()).tip_poses(rest)]
    }
    chains = [CellChain(each) for each in (cell, cell.replace(arms=lifted))]
    states = [chain.configuration(STARTS[name]) for chain in chains]
    assert_allclose(*states, rtol=0, atol=1e-9)
    tau = np.linspace(-5.0, 5.0, len(states[0]))
    a = [chain.acceleration(q, 0.0 * tau, tau)[0] for chain, q in zip(chains, states, strict=True)]
    assert_allclose(*a, rtol=0, atol=1e-6 * np.abs(a[0]).max())
    assert cell.driven == ()
    assert seen_by_arms(carry(rolling_cell(name), name)).cell == cell


def test_what_arms_see_is_a_payload_that_their_bases_carry():
    """Its heights and tilts stay, its way along the ground goes; distances are those of the moved cell."""
    scenario = carry(rolling_cell("spatial"), "spatial")
    X = scenario.start
    goal = X.replace(xyz=(X.xyz[0] + 0.5, X.xyz[1], X.xyz[2] + 0.1))
    seen = seen_by_arms(scenario.override({"motion.goal": goal}))
    end = seen.payload_motion.at(1.0).X_WP_d
    assert_allclose(end[:3, 3], (*X.xyz[:2], X.xyz[2] + 0.1), rtol=0, atol=1e-9)
    assert_allclose(end[:3, :3], X.matrix[:3, :3], rtol=0, atol=1e-9)


def test_a_stated_way_that_cannot_be_is_refused():
    for fields in ({"duration": 1.0}, {"duration": 3.0, "speed": 1.0, "wheels": (1.0, 1.0)}):
        with pytest.raises(ScenarioError):
            Steering(**fields)
    for fields in ({"ahead": 0.0}, {"friction": -1.0}, {"follow": "me"}, {"follow": {"speed": 1.0}}):
        with pytest.raises(ScenarioError):
            DifferentialBase(**fields)


def test_what_rolling_bases_do_not_have_is_refused_with_the_reason(tmp_path):
    cell = rolling_cell("spatial")
    left = cell.arms["left"]
    tilted = left.replace(base=left.base.replace(rpy=(0.1, 0.0, 0.0)))
    with pytest.raises(FieldError, match="upright") as error:
        cell.replace(arms=cell.arms | {"left": tilted})
    assert "arms.left.base" in str(error.value)
    scenario = carry(cell, "spatial")
    for engine in ("compiled", "mujoco"):
        with pytest.raises(FieldError, match="left"):
            cp.run(scenario, engine=engine)
    with pytest.raises(ArgumentError):
        cp.export.export_c(scenario, "left", tmp_path)
    torques = {"kind": "computed-torque", "gains": {"position_gain": 100.0, "velocity_gain": 20.0}}
    with pytest.raises(FieldError, match="payload-space"):
        scenario.replace(controller=torques)
    with pytest.raises(ArgumentError, match="mobile_base"):
        cp.blame(cp.run(scenario.override({"duration": 0.02}), warn=False))
    for commented in (False, True):
        assert cp.Scenario.from_toml(scenario.to_toml(commented=commented)) == scenario


def test_two_arms_of_one_robot_and_lifts_are_refused_on_wheels(tmp_path):
    from lifts import spatial_cell

    cell = spatial_cell(tmp_path)
    arms = {name: arm.replace(mobile_base=DifferentialBase()) for name, arm in cell.arms.items()}
    with pytest.raises(ScenarioError, match="parked"):
        cell.replace(arms=arms)
    parked = {n: arm.replace(mobile_base=DifferentialBase(follow="parked")) for n, arm in cell.arms.items()}
    X = cp.Pose(xyz=(*cell.payload_pose.xyz[:2], cell.payload_pose.xyz[2] + 0.5), rpy=cell.payload_pose.rpy)
    assert cell.replace(arms=parked, payload_pose=X).wheels == {}


def test_a_base_is_drawn_with_its_wheels_and_moves_with_its_arm():
    from coop_pin.model.visuals import CellVisuals

    cell = rolling_cell("spatial")
    chain, visuals = CellChain(cell), CellVisuals(cell, "welded")
    body = next(each for each in visuals.bodies if each.name == "left/base")
    kinds = [type(each.shape).__name__ for each in body.visuals]
    assert kinds.count("Cylinder") == 2
    q = chain.configuration(STARTS["spatial"])
    moved = q.copy()
    moved[:3] += 0.3, 0.2, 0.5
    before, after = visuals.poses(np.stack((q, moved)))
    index = [each.name for each in visuals.bodies].index("left/base")
    X_WB = cell.arms["left"].base.matrix
    assert_allclose(before[index, :3], X_WB[:3, 3], rtol=0, atol=1e-12)
    assert_allclose(after[index, :3], (X_WB @ (0.3, 0.2, 0.0, 1.0))[:3], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_three_bases_carry_a_plate_round_the_corner():
    result = cp.run("three-rolling-ur5", warn=False)
    position, _ = moving_errors(result)
    data = result.data
    moving = data.time.values > 0.5
    force = data.internal_wrench.values - data.desired_internal_wrench.values
    assert position < 2e-3
    assert np.linalg.norm(force[moving][..., :3], axis=-1).max() < 1.0
    assert np.abs(slips(result)).max() < 1e-12
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    turned = data.payload_quaternion.values[-1]
    assert_allclose(2.0 * np.arctan2(turned[2], turned[3]), np.pi / 2.0, rtol=0, atol=1e-4)
