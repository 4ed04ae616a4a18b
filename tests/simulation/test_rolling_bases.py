"""Differential bases: rolling, dynamics, forces on the wheels, what arms are told, findings and refusals."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from cells import random_velocity
from numpy.testing import assert_allclose
from rollers import PLATFORM, STARTS, PlanarRobot, on_wheels, rolling_cell

import coop_pin as cp
from coop_pin.actuators import DifferentialBase, Steering
from coop_pin.base.errors import ArgumentError, FieldError, ScenarioError
from coop_pin.chain import Rolling
from coop_pin.control import ArmController
from coop_pin.feasibility.carried_motion import rolling_course, seen_by_arms
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
    """Free of forces: v / omega = 0.5 m, for one turn; it neither slides nor loses energy."""
    chain, (v, w) = platform(0.0), (1.0, 2.0)
    motion = chain.integrate([0.0] * 3, [v, 0.0, w], duration=np.pi, step=1e-3)
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


def rolling_state(name, seed=4):
    """A cell away from its start, in motion, with forces of all drives."""
    cell, rng = rolling_cell(name), np.random.default_rng(seed)
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


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_and_side_forces_are_those_of_a_second_formulation(name):
    cell, chain, q, v, tau = rolling_state(name)
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
    """Carry the payload 0.5 m along and 0.3 m across the first heading, and turn it by 0.4 rad, in 3 s."""
    X, turned = cp.Pose.from_matrix(STARTS[name]), STARTS[name].copy()
    turned[:3] = np.column_stack((pin.utils.rotate("z", 0.4) @ turned[:3, :3], turned[:3, 3] + (0.5, 0.3, 0.0)))
    goal = cp.Pose.from_matrix(turned)
    motion = {"kind": "line", "start": X, "goal": goal, "start_time": 0.2, "duration": 3.0}
    gains = {"planar": (800.0, 800.0, 40.0), "spatial": (3000.0, 3000.0, 3000.0, 60.0, 60.0, 60.0)}[name]
    law = {"kind": "payload-space", "force_path": {"kind": "late"}}
    law["gains"] = {
        "pose_gain": 10.0,
        "sliding_gain": gains,
        "sign_gain": 0.5,
        "anchor_gain": 0.1,
        "transient_rate": 5.0,
    }
    common = {"name": "carry", "cell": cell, "controller": law, "motion": motion, "start": X}
    common |= {"duration": 3.4, "clock": {"rate_hz": 500.0, "steps_per_tick": 2}}
    return cp.Scenario(**common | fields)
