"""Lift, rail and turn under two arms: dynamics, floor, what arms are told, and what is refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from lifts import planar_cell, planar_robot, spatial_cell, spatial_robot
from numpy.testing import assert_allclose
from tiers import by_default
from whole_robots import WholeRobot

import coop_pin as cp
from coop_pin.actuators import SharedJoint, Stroke
from coop_pin.base.errors import ArgumentError, FieldError
from coop_pin.control import ArmController, DecentralisedController, SlidingMode, SlidingModeGains
from coop_pin.feasibility import cell_summary
from coop_pin.grasps.cell_chain import CellChain
from coop_pin.running.carrier_findings import carrier_findings
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.shared_drive import SharedDrives
from coop_pin.simulation.simulation import Simulation

CELLS = {
    "planar": (planar_cell, planar_robot, ("rail", "yaw"), "ltip rtip"),
    "spatial": (spatial_cell, spatial_robot, ("lift", "yaw"), "ltip rtip"),
}
GAINS = {"pose_gain": 20.0, "sliding_gain": (2990.0, 3160.0, 4120.0, 58.0, 55.0, 40.0), "sign_gain": 2.5}
GAINS |= {"anchor_gain": 0.1, "transient_rate": 5.0}
RISE = Stroke(distance=0.3, duration=3.0, start_time=0.25)


def cell_of(name, folder, **fields):
    make, _, joints, _ = CELLS[name]
    return make(folder, **{joint: SharedJoint(**fields) for joint in joints})


def moving_state(cell, seed=3):
    """A state on the closures away from the start, in motion, with forces of all drives."""
    chain, rng = CellChain(cell), np.random.default_rng(seed)
    model = chain.model.model
    q = chain.configuration(cell.payload_pose.matrix)
    dq = chain.mechanism.project_velocity(q, 0.2 * rng.normal(size=model.nv))
    q = chain.mechanism.project_configuration(pin.integrate(model, q, dq))
    v = chain.mechanism.project_velocity(q, 0.5 * rng.normal(size=model.nv))
    return chain, q, v, rng.normal(scale=20.0, size=model.nv)


def by_joint(chain, values):
    names = [str(name).split("/")[-1].removeprefix("shared.") for name in list(chain.model.model.names)[1:]]
    return dict(zip(names, values.tolist(), strict=names[-1] != "payload"))  # free of hinges at both arms


def second_formulation(cell, chain, q, v, tau, M, h, frames, names):
    """Accelerations by a KKT of the whole robot and a free payload; the neck is held by a row of its own.

    A hinge along e, which turns with the payload, leaves w = w_E - w_P along e: (1 - e e^T) dw = w_P x w.
    """
    n, X_WP = len(names), chain.payload_pose(q)
    g, V = np.array(cell.gravity), chain.payload_twist(q, v)
    R, m = X_WP[:3, :3], cell.payload.mass
    inertia = R @ cell.payload.inertia_matrix @ R.T
    M_all = np.zeros((n + 6, n + 6))
    M_all[:n, :n], M_all[n : n + 3, n : n + 3], M_all[n + 3 :, n + 3 :] = M, m * np.eye(3), inertia
    h_all = np.r_[h, -m * g, np.cross(V[3:], inertia @ V[3:])]
    rows, bias, rates = [], [], by_joint(chain, v) | {"neck": 0.0}
    for grasp, (X, J, Jv) in zip(cell.grasps.values(), frames, strict=True):
        r, om = X[:3, 3] - X_WP[:3, 3], V[3:]
        S = np.array(((0, r[2], -r[1]), (-r[2], 0, r[0]), (r[1], -r[0], 0)))  # om x r = S om
        rows.append(np.hstack((J, -np.block([[np.eye(3), S], [np.zeros((3, 3)), np.eye(3)]]))))
        bias.append(Jv - np.r_[np.cross(om, np.cross(om, r)), np.zeros(3)])
        if hasattr(grasp, "axis"):
            e = R @ grasp.matrix[:3, :3] @ np.array(grasp.axis) / np.linalg.norm(grasp.axis)
            held, turn = np.eye(6), J[3:] @ [rates[name] for name in names] - om
            held[3:, 3:] -= np.outer(e, e)
            rows[-1], bias[-1] = held @ rows[-1], held @ bias[-1] - np.r_[np.zeros(3), np.cross(om, turn)]
    for name in names:
        if name == "neck":
            rows.append(np.eye(n + 6)[[names.index(name)]])
            bias.append(np.zeros(1))
    J, b = np.vstack(rows), np.concatenate(bias)
    torque = np.array([by_joint(chain, tau).get(name, 0.0) for name in names])
    k = len(J)
    K = np.block([[M_all, J.T], [J, np.zeros((k, k))]])
    x = np.linalg.lstsq(K, np.r_[np.r_[torque, np.zeros(6)] - h_all, -b], rcond=1e-12)[0]
    return dict(zip(names, x[:n], strict=True))


ROTORS = {"planar": (0.3, 0.2, 0.05), "spatial": (2.0, 2.0, 2.0, 0.1, 0.2, 0.3)}
AXES = {"planar": (0.0, 0.0, 1.0), "spatial": (0.3, 0.8, -0.1)}


def on_hinges(cell, *arms):
    """The cell with hinges for the grasps of some arms."""
    axis = AXES["planar" if cell.rows == "planar" else "spatial"]
    hinges = {name: {"kind": "hinge", "axis": axis, **cell.grasps[name].model_dump()} for name in arms}
    return cell.replace(grasps={**cell.grasps, **hinges})


def geared(cell, name):
    """The cell with rotors on the joints of both arms, of one by numbers and of the other behind gears."""
    stated = {"left": ROTORS[name], "right": {"inertia": 1e-4, "gear_ratio": 50.0}}
    return cell.replace(arms={n: arm.replace(armature=stated[n]) for n, arm in cell.arms.items()})


@pytest.mark.parametrize(
    ("hinges", "has_rotors"), [((), False), ((), True), (("left",), True), (("left", "right"), False)]
)
@pytest.mark.parametrize("name", CELLS)
def test_accelerations_are_those_of_the_whole_robot_by_a_second_formulation(
    name, hinges, has_rotors, tmp_path
):
    cell, text = on_hinges(cell_of(name, tmp_path), *hinges), CELLS[name][1]()
    cell = geared(cell, name) if has_rotors else cell
    chain, q, v, tau = moving_state(cell)
    tau[2 * len(ROTORS[name]) + 2 :] = 0.0  # none at a free payload
    robot = WholeRobot(text, cell.arms["left"].base.matrix)
    angles, rates = by_joint(chain, q), by_joint(chain, v)
    angles |= {"neck": 0.4}
    rates |= {"neck": 0.0}
    gravity = np.array(cell.gravity)
    M, *terms = robot.terms(angles, rates, gravity, CELLS[name][3].split())
    arms = {"l": ROTORS[name], "r": (0.25,) * len(ROTORS[name])}  # 1e-4 kg m^2 times 50^2
    if has_rotors:
        M = M + np.diag([arms[j[0]][int(j[-1]) - 1] if j[-1].isdigit() else 0.0 for j in robot.names])
    terms = M, *terms
    a = by_joint(chain, chain.acceleration(q, v, tau)[0])
    expected = second_formulation(cell, chain, q, v, tau, *terms, robot.names)
    scale = max(map(abs, a.values()))
    for joint in {*a} - {"payload"}:
        assert abs(a[joint] - expected[joint]) < 1e-10 * scale, joint


def test_accelerations_are_those_of_mujocos_own_reading_of_the_file(tmp_path):
    """M, bias, Jacobians and their rates are MuJoCo's, which reads the URDF itself; the base is the world."""
    mujoco = pytest.importorskip("mujoco")
    cell = cell_of("spatial", tmp_path)
    poses = {name: arm.replace(base=cp.Pose()) for name, arm in cell.arms.items()}
    middle = sum(arm.tip_poses(np.array(arm.posture))[:3, 3] for arm in poses.values()) / 2
    X_WP = cp.Pose(xyz=tuple(middle), rpy=(0.1, -0.2, 0.4))
    cell = cell.replace(arms=poses, payload_pose=X_WP, grasps="as-posed")
    chain, q, v, tau = moving_state(cell)
    extension = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(spatial_robot().replace("</robot>", extension))
    data = mujoco.MjData(model)
    names = [model.joint(index).name for index in range(model.njnt)]
    for name, value in (by_joint(chain, q) | {"neck": 0.4}).items():
        data.qpos[names.index(name)] = value
    for name, value in by_joint(chain, v).items():
        data.qvel[names.index(name)] = value
    mujoco.mj_forward(model, data)
    M, h = np.zeros((model.nv, model.nv)), data.qfrc_bias.copy()
    mujoco.mj_fullM(model, data, M)
    frames = []
    for tip in ("ltip", "rtip"):
        body = model.body(tip).id
        p, X = data.xpos[body].copy(), np.eye(4)
        X[:3, :3], X[:3, 3] = data.xmat[body].reshape(3, 3), p
        J, dJ = np.zeros((2, 6, model.nv))
        mujoco.mj_jac(model, data, J[:3], J[3:], p, body)
        mujoco.mj_jacDot(model, data, dJ[:3], dJ[3:], p, body)
        frames.append((X, J, dJ @ data.qvel))
    a = by_joint(chain, chain.acceleration(q, v, tau)[0])
    expected = second_formulation(cell, chain, q, v, tau, M, h, frames, names)
    scale = max(map(abs, a.values()))
    for joint, value in a.items():
        assert abs(value - expected[joint]) < 1e-10 * scale, joint


@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize("has_rotors", [False, True])
def test_the_floor_bears_the_whole_robot_and_what_it_holds(name, has_rotors, tmp_path):
    """Against inverse dynamics of the whole robot, and against the rate of momentum of robot and payload.

    Rotors take torque, and load the floor with nothing.
    """
    cell = cell_of(name, tmp_path)
    cell = geared(cell, name) if has_rotors else cell
    chain, q, v, tau = moving_state(cell)
    a, model = chain.acceleration(q, v, tau)[0], chain.model.model
    seen = chain.observe(q[None], v[None], tau[None], np.zeros((1, 6)))
    robot = WholeRobot(CELLS[name][1](), cell.arms["left"].base.matrix)
    states = [by_joint(chain, each) | {"neck": at} for each, at in ((q, 0.4), (v, 0.0), (a, 0.0))]
    P, tips = seen.payload_pose[0, :3, 3], CELLS[name][3].split()
    F = seen.interaction_wrench[0]
    on_tips = {
        tip: np.r_[each[:3], each[3:] + np.cross(P, each[:3])] for tip, each in zip(tips, F, strict=True)
    }
    forces, floor = robot.inverse_dynamics(*states, np.array(cell.gravity), on_tips)
    assert_allclose(seen.floor_wrench[0], floor, rtol=0, atol=1e-10 * np.abs(floor).max())
    for joint, value in by_joint(chain, tau - model.armature * a).items():
        assert abs(forces[joint] - value) < 1e-9
    data = model.createData()
    pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
    mass = sum(inertia.mass for inertia in model.inertias)  # with the fixed foot
    rate = data.dhg.linear - mass * np.array(cell.gravity)
    assert_allclose(seen.floor_wrench[0, :3], rate, rtol=0, atol=1e-9 * max(1.0, np.abs(rate).max()))


@pytest.mark.parametrize("name", CELLS)
def test_an_arm_that_is_told_sees_the_payload_where_it_is(name, tmp_path):
    cell = cell_of(name, tmp_path)
    run = Simulation(carry(cell))
    _, q, v, _ = moving_state(cell)
    run.observe()
    run.plant.restore(run.plant.state()._replace(q=q, v=v))
    inputs = run.observe()
    measured = run.sensing.start(q, v, inputs.references, inputs.signals.sensors)
    rows = cell.task_rows
    X, V = run.chain.payload_pose(q), rows.select(run.chain.payload_twist(q, v))
    for arm, reading in zip(run.slots, measured, strict=True):
        assert_allclose(reading.payload_pose, X, rtol=0, atol=1e-12)
        assert_allclose(reading.payload_twist, V, rtol=0, atol=1e-12)
        assert_allclose(reading.shared_position, q[:2], rtol=0, atol=1e-15)
        assert_allclose(
            reading.payload_jacobian @ v[arm.v_slice] + reading.carried_twist, V, rtol=0, atol=1e-12
        )
        assert np.abs(reading.carried_twist).max() > 1e-2


def carry(cell, rise=0.15, shift=0.1, duration=3.75, **fields):
    """A scenario that carries the payload aside and up, by the quintic of the lift."""
    X = cell.payload_pose
    up = 0.0 if cell.rows == "planar" else rise
    goal = cp.Pose(xyz=(X.xyz[0], X.xyz[1] + shift, X.xyz[2] + up), rpy=X.rpy)
    motion = {"kind": "line", "start": X, "goal": goal, "start_time": 0.25, "duration": 3.0}
    law = {
        "kind": "payload-space",
        "gains": GAINS,
        "force_path": {"kind": "late"},
        "anchor_bias": (2e-3, 1e-2),
    }
    if cell.rows == "planar":
        law["gains"] = GAINS | {"sliding_gain": 300.0}
    common = {"name": "carry", "cell": cell, "controller": law, "motion": motion, "start": X}
    common |= {"duration": duration, "clock": {"rate_hz": 500.0, "steps_per_tick": 2}}
    return cp.Scenario(**common | fields)


def errors_of(result):
    data, moving = result.data, result.data.time.values < 3.3
    f = np.linalg.norm(data.internal_wrench.values[:, 0, :3], axis=1)
    position = np.linalg.norm(data.pose_error.values[:, :3], axis=1)
    return position.max(), np.nan_to_num(f)[moving].max(), f[-1]


def test_a_lift_that_is_told_disturbs_nothing_and_the_books_balance(tmp_path):
    cell = spatial_cell(tmp_path, lift=SharedJoint(follow=RISE), yaw=SharedJoint())
    result = cp.run(carry(cell), warn=False)
    position, moving, rest = errors_of(result)
    assert position < 1e-3
    assert moving < 0.2
    assert rest < 0.05
    assert result.metrics()["energy_balance_max_J"] < 1e-9
    data = result.data
    assert data.shared.values.tolist() == ["lift", "yaw"]
    assert_allclose(data.shared_position.values[-1], (0.4, 0.3), rtol=0, atol=1e-6)
    weight = 9.81 * 125.5  # robot with head and foot, and the box
    assert_allclose(data.floor_wrench.values[-1, :3], (0.0, 0.0, weight), rtol=0, atol=1e-3)
    assert_allclose(data.shared_force.values[-1, 0], weight - 9.81 * 40.0, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("w", "zeta"), [(1500.0, 0.8), (200.0, 8.0), (1500.0, 0.1)])
@pytest.mark.parametrize("name", CELLS)
def test_a_servo_too_fast_for_the_ticks_is_told_and_its_remedy_decays(name, w, zeta, tmp_path):
    """By a joint of unit inertia, tick by tick."""
    scenario = carry(cell_of(name, tmp_path, bandwidth=w, damping_ratio=zeta))
    findings, cured = [*carrier_findings(scenario)], scenario
    assert {finding.severity for finding in findings} == {"error"}
    assert len(findings) == len(scenario.cell.shared_joints)
    for finding in findings:
        cured = cured.override(finding.remedy)
    assert not [*carrier_findings(cured)]
    T = scenario.clock.period
    for joints, decays in ((scenario.cell.shared_joints, False), (cured.cell.shared_joints, True)):
        for joint in joints.values():
            q, v = 1.0, 0.0
            for _ in range(4000):
                a = -(joint.bandwidth**2) * q - 2.0 * joint.damping_ratio * joint.bandwidth * v
                q, v = q + T * v + T * T * a / 2.0, v + T * a
            assert (abs(q) < 0.1) == decays


def test_an_untold_lift_takes_the_payload_with_it_unseen_and_the_finding_names_the_cure(tmp_path):
    slow = Stroke(distance=0.03, duration=1.0, start_time=0.25)
    cell = spatial_cell(tmp_path, lift=SharedJoint(follow=slow), yaw=SharedJoint())
    still = carry(cell, rise=0.0, shift=0.0, duration=1.5, motion={"kind": "hold", "pose": cell.payload_pose})
    untold = still.replace(sensors={"shared_joints": "not told"})
    data = cp.run(untold, warn=False).data
    error = data.pose_error.values[:, 2]
    assert abs(error[-1] - 0.03) < 1e-3
    assert np.abs(data.seen_pose_error.values[-1, :, 2] + 0.03).max() < 1e-4
    assert np.abs(data.internal_wrench.values[:, 0, :3]).max() < 0.5
    (finding,) = carrier_findings(untold)
    assert (finding.kind, finding.severity) == ("shared joint", "error")
    assert not [*carrier_findings(untold.override(dict(finding.remedy)))]
    one = still.replace(arm_sensors={"right": {"shared_joints": {"told": "nothing"}}})
    assert (
        np.abs(cp.run(one.replace(duration=0.8), warn=False).data.internal_wrench.values[:, 0, :3]).max()
        > 50.0
    )


class WithWeight(ArmController):
    """A law on top of the arm's share of the payload's weight, and constant torques."""

    def __init__(self, law, weight, constant):
        self.law, self.weight, self.constant = law, weight, constant

    def init(self, measurement, reference):
        return self.law.init(measurement, reference), measurement.holding_torque

    def step(self, measurement, reference, state):
        command = self.law.step(measurement, reference, state[0])
        known = state[1] if self.constant else -measurement.payload_jacobian.T @ self.weight
        return cp.ArmCommand(command.torque + known, (command.state, state[1]))


@pytest.mark.gate
@pytest.mark.parametrize(
    ("constant", "allowed"),
    by_default([(False, 0.5e-3), (True, 1e-3)], (False, 0.5e-3), others=pytest.mark.slow),
)
def test_law_23_takes_the_motion_of_the_lift_off(constant, allowed, tmp_path):
    """With true gravity torques (the robot's own and J^T of the weight), and with those held at the start."""
    lift = spatial_cell(tmp_path, lift=SharedJoint(follow=RISE), yaw=SharedJoint())
    gains = SlidingModeGains(
        pose_gain=5.0,
        sign_gain=0.0,
        damping_gain=(80.0, 80.0, 80.0, 20.0, 20.0, 20.0),
        force_gain=0.0,
        transient_rate=5.0,
    )
    errors = []
    for cell in (lift, lift.replace(shared_joints={})):
        actuators = {} if constant else {"gravity_compensation": {}}
        fields = {"controller": SlidingMode(gains=gains), "actuators": actuators}
        scenario = carry(cell, rise=0.08, shift=0.05, clock={"rate_hz": 250.0}, **fields)
        laws = build_controller(scenario).controllers
        weights = {name: scenario.cell.share(name) * np.r_[0, 0, -4.0 * 9.81, 0, 0, 0] for name in laws}
        law = DecentralisedController({n: WithWeight(each, weights[n], constant) for n, each in laws.items()})
        errors.append(cp.simulate(scenario, law).data.pose_error.values[:, :3])
    told, held = (float(np.linalg.norm(error, axis=1).max()) for error in errors)
    assert told < held + allowed


def test_following_the_payload_the_lift_keeps_the_arms_where_they_are(tmp_path):
    """Of a rise without a shift the arms stand still on the lift; the turn follows the payload's yaw."""
    cell = spatial_cell(tmp_path, lift=SharedJoint(follow="payload"), yaw=SharedJoint())
    X = cell.payload_pose
    rise = {"kind": "line", "start": X, "start_time": 0.1, "duration": 0.8}
    rise["goal"] = cp.Pose(xyz=(*X.xyz[:2], X.xyz[2] + 0.1), rpy=X.rpy)
    data = cp.run(carry(cell, motion=rise, duration=1.0), warn=False).data
    assert abs(data.shared_position.values[-1, 0] - 0.2) < 2e-4
    moved = data.joint_position.values - data.joint_position.values[0]
    assert np.abs(moved).max() < 5e-3
    drive, screw = SharedJoint(follow="payload"), np.array((0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    turn = cp.motions.TurnMotion(pose=X, axis=(0.0, 0.0, 1.0), angle=0.5, duration=1.0).at(0.6)
    r, rate = drive.reference(0.6, 0.3, screw, turn, X.matrix)
    assert_allclose(rate, turn.V_WP_d[5], rtol=1e-12)
    assert_allclose(r, 0.3 + 0.5 * (10 * 0.6**3 - 15 * 0.6**4 + 6 * 0.6**5), rtol=1e-9)


def test_a_run_on_a_lift_goes_on_with_the_same_bits(tmp_path):
    cell = spatial_cell(tmp_path, lift=SharedJoint(follow=RISE), yaw=SharedJoint())
    late = {"shared_joints": {"delay": 2, "resolution": 1e-5, "offset": 1e-4}}
    scenario = carry(cell, duration=0.4, sensors=late)
    run = Simulation(scenario, build_controller(scenario))
    for _ in range(140):
        run.tick()
    state, ends = run.state(), []
    for _ in range(2):
        run.restore(state)
        for _ in range(40):
            run.tick()
        ends.append(run.plant.q)
    assert ends[0].tobytes() == ends[1].tobytes()
    told = run.observe().measurements[0].shared_position[0]
    assert abs(told - 1e-4 - 1e-5 * round((told - 1e-4) / 1e-5)) < 1e-12


def test_what_shared_joints_cannot_be_is_refused_with_the_reason(tmp_path):
    cell = spatial_cell(tmp_path)
    for drive in ("arms", {"left": 0.5, "right": 0.5}):
        with pytest.raises(FieldError, match="integrals"):
            SharedJoint(drive=drive)
    without = {
        name: arm.replace(locked={joint: angle for joint, angle in arm.locked.items() if joint != "lift"})
        for name, arm in cell.arms.items()
    }
    cases = {
        "shared_joints.neck": {"shared_joints": {"neck": {}}},  # moves no arm
        "shared_joints.lj1": {"shared_joints": {"lj1": {}}},
        "right.locked.lift": {"arms": without},
        "shared_joints.lift": {"shared_joints": {"lift": {}}, "rows": "planar"},
        "shared_joints.yaw": {"shared_joints": {"yaw": {}}, "gravity": (1.0, 0.0, -9.0)},
    }
    for path, fields in cases.items():
        with pytest.raises(FieldError) as error:
            cell.replace(**fields)
        assert path in str(error.value)
    moving = spatial_cell(tmp_path, lift=SharedJoint())
    scenario = carry(moving)
    with pytest.raises(FieldError, match="lift"):
        cp.run(scenario, engine="compiled")
    with pytest.raises(ArgumentError, match="shared joints"):
        cp.export.export_c(scenario, "left", tmp_path)
    with pytest.raises(FieldError, match="payload-space"):
        carry(
            moving,
            controller={"kind": "computed-torque", "gains": {"position_gain": 100.0, "velocity_gain": 20.0}},
        )


@pytest.mark.parametrize(
    ("limit", "effort", "expected"),
    [("none", 100.0, -538.0), ("urdf", 100.0, -100.0), ("urdf", 0.0, -538.0), (40.0, 100.0, -40.0)],
)
def test_the_drive_of_a_shared_joint_is_a_servo_within_its_limit(limit, effort, expected):
    """tau_0 - I (w^2 e + 2 zeta w v) = 10 - 2 (2500 * 0.1 + 80 * 0.3); an effort of 0 in a URDF is none."""
    angles, only = SimpleNamespace(near=lambda q, _near: q), slice(0, 1)
    place = SimpleNamespace(start=0.0, effort=effort, q_slice=only, v_slice=only, angles=angles)
    joint = SharedJoint(follow="hold", bandwidth=50.0, damping_ratio=0.8, limit=limit)
    drives = SharedDrives((joint,), (place,), np.zeros((1, 6)), np.array([10.0]), np.array([2.0]), np.eye(4))
    (force,) = drives.force(0.0, np.array([0.1]), np.array([0.3]), None)
    assert_allclose(force, [expected], rtol=1e-12)


def test_the_summary_has_lift_and_turn_and_blame_refuses_joints_that_move(tmp_path):
    cell = spatial_cell(tmp_path, lift=SharedJoint(follow=RISE, limit=900.0), yaw=SharedJoint())
    summary = cell_summary(cell, cell.payload_pose.matrix)
    lift, yaw = summary.shared
    assert (lift.name, lift.unit, lift.effort, lift.follow, lift.arms) == (
        "lift",
        "m",
        900.0,
        "stroke",
        ("left", "right"),
    )
    assert (yaw.name, yaw.unit, yaw.effort, yaw.follow) == ("yaw", "rad", 4000.0, "hold")
    assert_allclose((lift.start, yaw.start), (0.1, 0.3))
    assert summary.freedom == 12 + 2 + 6 - 12
    assert "lift" in summary.summary()
    with pytest.raises(ArgumentError, match="lift"):
        cp.blame(cp.run(carry(cell, duration=0.05), warn=False))


@pytest.mark.parametrize("name", CELLS)
def test_brakes_hold_the_joints_of_an_arm_on_shared_ones(name, tmp_path):
    braked = cp.events.LoseArm(arm="left", time=0.02, form="braked")
    result = cp.run(carry(cell_of(name, tmp_path), duration=0.1, events=[braked]), warn=False)
    angles = result.data.joint_position.sel(arm="left").values[result.data.time.values >= 0.02]
    assert np.ptp(angles, axis=0).max() < 1e-9
    assert result.simulation_sound


class Pushing(ArmController):
    """Holds the cell, and pushes one joint of the left arm."""

    def __init__(self, scenario, arm, torque, joint):
        self.added = np.zeros(len(scenario.cell.arms[arm].posture))
        self.added[joint] = torque if arm == "left" else 0.0

    def init(self, measurement, reference):
        return measurement.holding_torque

    def step(self, measurement, reference, state):
        return cp.ArmCommand(state + self.added, state)


@pytest.mark.parametrize(
    "hinges",
    [(), *(pytest.param(arms, marks=pytest.mark.slow) for arms in (("left",), ("left", "right")))],
)
@pytest.mark.parametrize("name", by_default(CELLS, "planar"))
def test_a_joint_on_a_shared_one_hits_its_stop_and_the_books_balance(name, hinges, tmp_path):
    """Rotors, a lift or rail that moves, hinges and stops in one cell; the spring is that of its law."""
    make, text, (first, second), _ = CELLS[name]
    cell = geared(make(tmp_path, **{first: SharedJoint(follow=RISE), second: SharedJoint()}), name)
    cell = on_hinges(cell, *hinges)
    number = {"planar": 1, "spatial": 3}[name]  # of angles above zero, where the other arm locks them
    joint, angle = f"lj{number}", cell.arms["left"].posture[number - 1]
    file, upper = tmp_path / f"{name}.urdf", angle + 0.02
    head, tail = text().split(f'<joint name="{joint}"')
    tail = tail.replace('upper="6"', f'upper="{upper}"', 1)
    file.write_text(f'{head}<joint name="{joint}"{tail}')
    stops = {"stiffness": 5000.0, "damping_ratio": 0.1}
    arms = {n: arm.replace(stops=stops if n == "left" else None) for n, arm in cell.arms.items()}
    law = {"kind": "user", "target": Pushing, "options": {"torque": 40.0, "joint": number - 1}}
    scenario = carry(cell.replace(arms=arms), controller=law, duration=0.4)
    scenario = scenario.override({"clock.steps_per_tick": 8})
    result = cp.run(scenario, warn=False)
    data, metrics = result.data, result.metrics()
    depth = data.joint_position.sel(arm="left").values[:, number - 1] - upper
    force = data.stop_force.sel(arm="left").values[:, number - 1]
    assert depth.max() > 1e-4
    assert (force[depth < 0.0] == 0.0).all()
    assert (force[depth > 0.0] <= 0.0).all()
    assert_allclose(data.stop_energy.values, 2500.0 * np.maximum(depth, 0.0) ** 2, rtol=0, atol=1e-9)
    assert result.simulation_sound
    assert metrics["closure_error_max_m"] < 1e-6
    assert metrics["energy_balance_max_J"] < 0.01 * data.stop_energy.values.max() + 1e-6


def test_a_robot_on_a_lift_is_drawn_once_and_moves_with_it(tmp_path):
    from coop_pin.model.visuals import CellVisuals

    box = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
    cell = spatial_cell(tmp_path, lift=SharedJoint(), yaw=SharedJoint())
    file = Path(cell.arms["left"].urdf)
    file.write_text(spatial_robot().replace("</inertial>", f"</inertial>{box}"))
    visuals = CellVisuals(cell, "welded")
    names = [body.name for body in visuals.bodies]
    assert len(names) == len({*names}) == 3 + 12  # foot, slide, torso with the head, links of two arms
    assert sum(len(body.visuals) for body in visuals.bodies) == 4 + 12
    q = CellChain(cell).configuration(cell.payload_pose.matrix)
    up = q.copy()
    up[0] += 0.2
    before, after = visuals.poses(np.stack((q, up)))
    moved = dict(zip(names, after[:, 2] - before[:, 2], strict=True))
    assert moved.pop("left/base") == 0.0
    assert_allclose([*moved.values()], 0.2, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_cell_of_the_catalogue_keeps_its_task_while_the_torso_rises():
    result = cp.run("tiago-pro-tray")
    assert (result.simulation_sound, result.task.state, result.limit_violations()) == (True, "kept", ())
    assert errors_of(result)[0] < 1e-4
    assert_allclose(result.data.shared_position.values[-1], 0.25, rtol=0, atol=1e-5)
    assert np.ptp(result.data.floor_wrench.values[[0, -1], 2]) < 1e-2
