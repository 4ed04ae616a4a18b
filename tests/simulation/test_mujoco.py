"""Engine "mujoco": beside Pinocchio's numbers, a regularised KKT, and the model that is written."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from cells import planar_scenario, spatial_scenario
from joint_cells import jointed
from lifts import planar_cell
from linked_cells import linked
from numpy.testing import assert_allclose
from tool_cells import two_things, with_gains

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, MissingExtraError
from coop_pin.cli import main
from coop_pin.compiled.engine_choice import choose_engine, choose_engines
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.description.cell.shared_joint import SharedJoint
from coop_pin.description.plant import MujocoOptions, PlantOptions
from coop_pin.grasps import CellChain
from coop_pin.model.mujoco_model import MujocoModel
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.mujoco_plant import MujocoPlant, unlike_plant
from coop_pin.simulation.simulation import Simulation
from coop_pin.viz.report import scenario_facts

CASES = {
    "planar": (planar_scenario, 0.5),
    "spatial": (spatial_scenario, 0.1),
    "continuous": (lambda: cp.Scenario.load("kinova-pair"), 0.06),
    "three": (lambda: cp.Scenario.load("three-driven-ur5"), 0.06),
    "planar hinges": (lambda: cp.Scenario.load("adept-hinges"), 0.5),
    "spatial hinges": (lambda: cp.Scenario.load("two-pandas-hinges"), 0.1),
}
STATES = 100
AT_THE_GATE = [pytest.param(name, marks=pytest.mark.gate) for name in ("planar hinges", "spatial hinges")]


def eventful(name: str) -> cp.Scenario:
    """A short run whose payload's mass halves between two ticks and that is pushed within one."""
    scenario, duration = CASES[name][0](), CASES[name][1]
    push = (3.0, -2.0, 0.0, 0.0, 0.0, 0.2)
    pulse = {"kind": "wrench-pulse", "time": 0.4711 * duration, "duration": 0.2 * duration, "wrench": push}
    drop = {"kind": "payload-change", "time": 0.31 * duration, "mass": 0.5 * scenario.cell.payload.mass}
    return scenario.override({"duration": duration, "events": [drop, pulse]})


def without_friction(scenario: cp.Scenario) -> cp.Scenario:
    """The scenario with arms that turn freely."""
    arms = {name: arm.replace(friction=JointFriction()) for name, arm in scenario.cell.arms.items()}
    return scenario.replace(cell=scenario.cell.replace(arms=arms))


def differences(ours: cp.RunResult, others: cp.RunResult) -> dict[str, float]:
    """Largest differences of payload and internal wrench; of forces as parts of the largest one."""
    a, b = ours.data, others.data
    wrenches = a["internal_wrench"].values, b["internal_wrench"].values
    assert (np.isnan(wrenches[0]) == np.isnan(wrenches[1])).all()
    apart = np.abs(wrenches[0] - wrenches[1])
    turns = a["payload_quaternion"].values, b["payload_quaternion"].values
    turn = np.minimum(*(np.linalg.norm(turns[0] - sign * turns[1], axis=1) for sign in (1.0, -1.0)))
    gap = np.linalg.norm(a["payload_position"].values - b["payload_position"].values, axis=1)
    return {
        "position": gap.max(),
        "orientation": 2.0 * turn.max(),
        "force": np.nanmax(apart[..., :3]) / np.nanmax(np.abs(wrenches[0][..., :3])),
        "moment": np.nanmax(apart[..., 3:]),
        "end": np.nanmax(apart[-1, :, :3]) / np.nanmax(np.abs(wrenches[0][..., :3])),
    }


@pytest.mark.parametrize("name", CASES)
def test_a_run_with_events_has_the_samples_of_pinocchio(name):
    scenario = eventful(name)
    ours, theirs = (cp.run(scenario, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    apart = differences(ours, theirs)
    assert apart["position"] < 1e-7
    assert apart["orientation"] < 5e-7
    assert apart["force"] < 1e-3
    assert apart["moment"] < 5e-3
    assert theirs.engine == "mujoco"
    assert theirs.simulation_sound
    taken = np.abs(theirs.data["work_grasps"].values).max()  # what the welds store and lose
    assert theirs.energy_balance_max() < max(1e-9, 0.1 * taken)
    assert 0.0 < taken < 2e-6
    works = ("work_friction", "work_external", "work_payload_change")
    for work in works if name in ("planar", "spatial") else works[1:]:
        assert_allclose(theirs.data[work][-1], ours.data[work][-1], rtol=5e-5, atol=1e-7)
        assert ours.data[work][-1] != 0.0
    assert "soft welds of MuJoCo: wrenches within" in theirs.summary()
    assert "MuJoCo" not in ours.summary()
    assert dict(scenario_facts(theirs))["engine"].startswith("mujoco; grasps were soft welds")
    assert "engine" not in dict(scenario_facts(ours))


BESIDES = {
    "a planar tool": lambda _: with_gains(two_things("planar"), leak=0.0),
    "a spatial tool": lambda _: with_gains(two_things("spatial"), leak=0.0),
    "a planar lid": lambda _: linked("adept-anchored", "lid"),
    "a spatial beam": lambda _: linked("two-pandas-box", "beam"),
    "a free planar payload": lambda _: planar_scenario().override({"plant.payload": "free"}),
    "a free spatial payload": lambda _: spatial_scenario().override({"plant.payload": "free"}),
    "a ball": lambda _: jointed("two-pandas-box", {"right": "ball"}),
    "a rail": lambda folder: on_rail(folder),
    "a lift": lambda _: cp.Scenario.load("tiago-pro-tray"),
    "a door": lambda _: cp.Scenario.load("two-pandas-door"),
}


def on_rail(folder: Path) -> cp.Scenario:
    """The planar robot of tests on its rail, moved aside."""
    cell = planar_cell(folder, rail=SharedJoint(), yaw=SharedJoint())
    goal = cell.payload_pose.model_copy(update={"xyz": tuple(np.add(cell.payload_pose.xyz, (0.0, 0.1, 0.0)))})
    gains = {"pose_gain": 20.0, "sliding_gain": 300.0, "sign_gain": 2.5, "anchor_gain": 0.1}
    law = {"kind": "payload-space", "gains": gains | {"transient_rate": 5.0}, "force_path": {"kind": "late"}}
    line = {"kind": "line", "start": cell.payload_pose, "goal": goal, "duration": 1.0}
    law |= {"anchor_bias": (2e-3, 1e-2)}
    fields = {"name": "rail", "cell": cell, "controller": law, "motion": line, "start": cell.payload_pose}
    return cp.Scenario(**fields, duration=1.0, clock={"rate_hz": 500.0, "steps_per_tick": 2})


@pytest.mark.gate
@pytest.mark.parametrize("case", BESIDES)
def test_tools_links_free_payloads_balls_and_shared_joints_move_as_on_pinocchio(case, tmp_path):
    scenario = BESIDES[case](tmp_path).replace(events=())
    scenario = scenario.override({"duration": 8.0 / scenario.clock.rate_hz})
    ours, theirs = (cp.run(scenario, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    for name, unit in {
        "payload_position": 1e-7,
        "payload_quaternion": 1e-7,
        "configuration": 5e-7,
        "work_actuation": 5e-6,
        "interaction_wrench": 2e-2,
    }.items():
        assert_allclose(theirs.data[name].values, ours.data[name].values, rtol=0.0, atol=unit)
    assert theirs.energy_balance_max() < ours.energy_balance_max() + 1e-8


@pytest.mark.gate
def test_joints_drift_apart_only_where_the_check_says_that_the_law_is_unstable():
    """A wrist that a ball leaves spare, with T D / I above 2, makes 1e-8 rad 4e-3 in 0.4 s; below, 5e-9."""
    kinds, apart = {"left": "hinge", "right": "ball"}, []
    scenario = jointed("two-pandas-box", kinds).override({"events": (), "duration": 0.4})
    for damping in (8.0, 0.5):
        changed = scenario.override({"controller.posture.damping": damping})
        ours, theirs = (cp.run(changed, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
        gap = np.abs(theirs.data.configuration.values - ours.data.configuration.values).max()
        apart.append((gap, cp.stability.sampled_stability(changed).ok))
    assert [ok for _, ok in apart] == [False, True]
    assert apart[0][0] > 1e-3
    assert apart[1][0] < 2e-8


@pytest.mark.parametrize("name", ["planar", "spatial", "continuous", "planar hinges", "spatial hinges"])
def test_without_closures_accelerations_are_those_of_the_articulated_body_algorithm(name):
    scenario, rng = CASES[name][0](), np.random.default_rng(0)
    chain, options = CellChain(scenario.cell), MujocoOptions()
    tree = chain.model.model
    model, data = MujocoModel(tree, [], options, step=1e-3), tree.createData()
    q_start = chain.configuration(scenario.start.matrix)
    for _ in range(STATES):
        q = pin.integrate(tree, q_start, rng.normal(size=tree.nv))
        v, tau = rng.normal(size=tree.nv), 20.0 * rng.normal(size=tree.nv)
        expected = pin.aba(tree, data, q, v, tau)
        assert_allclose(model.acceleration(q, v, tau), expected, rtol=0.0, atol=1e-9 * abs(expected).max())


class WeldRows(NamedTuple):
    """Rows of a weld of MuJoCo at a state, by Pinocchio's frames: J, e with e' = J v, and Jdot v.

    The error is [p_E - p_G, s log(R_E^T R_G) / 2] with the scale s of rotations, for small angles.
    """

    J: Array
    e: Array
    drift: Array

    @classmethod
    def at(cls, tree, data, frames, scale, q, v) -> WeldRows:
        """The rows between a tip E and a grasp G."""
        E, G = (tree.getFrameId(frame) for frame in frames)
        pin.computeJointJacobians(tree, data, q)
        pin.forwardKinematics(tree, data, q, v, np.zeros(tree.nv))
        pin.updateFramePlacements(tree, data)
        world = pin.LOCAL_WORLD_ALIGNED
        J_E, J_G = (pin.getFrameJacobian(tree, data, frame, world) for frame in (E, G))
        w_E, w_G = ((J @ v)[3:] for J in (J_E, J_G))
        a_E, a_G = (pin.getFrameClassicalAcceleration(tree, data, f, world).vector for f in (E, G))
        X_WE, X_WG, J, drift = data.oMf[E], data.oMf[G], J_E - J_G, a_E - a_G
        turned = -0.5 * scale * X_WE.rotation.T
        J[3:] = turned @ J[3:]
        drift[3:] = turned @ (drift[3:] - np.cross(0.5 * (w_E + w_G), w_E - w_G))
        angle = pin.log3(X_WE.rotation.T @ X_WG.rotation)
        return cls(J, np.concatenate((X_WE.translation - X_WG.translation, 0.5 * scale * angle)), drift)


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_with_welds_accelerations_and_wrenches_are_those_of_a_regularised_kkt(name):
    """M a - J^T f = tau - h and J a + R f = -Jdot v - b J v - k e, with MuJoCo's R, all else of Pinocchio.

    A weld of time constant T and impedance d has b = 2 / (d T) and k = 1 / (d T^2). With R = 0 the forces are
    those of rigid grasps that are stabilised alike: the difference is what "soft" means.
    """
    scenario, rng, step = CASES[name][0](), np.random.default_rng(1), 1e-3
    chain, options = CellChain(scenario.cell), MujocoOptions()
    tree, frames = chain.model.model, ("right/grasp", "payload/right")
    closures = chain.mechanism.closures.closures
    model, data = MujocoModel(tree, closures, options, step=step), tree.createData()
    T, d, scale = options.time_constant * step, options.impedance, options.torque_scale
    q_start, nv, softness = chain.configuration(scenario.start.matrix), tree.nv, 0.0
    for _ in range(STATES):
        q = chain.mechanism.project_configuration(q_start + 0.03 * rng.normal(size=nv))
        v = chain.mechanism.project_velocity(q, rng.normal(size=nv)) + 1e-3 * rng.normal(size=nv)
        tau = 20.0 * rng.normal(size=nv)
        a, (on_tip,) = model.forces(q, v, tau)
        M, h = np.triu(pin.crba(tree, data, q)), pin.nonLinearEffects(tree, data, q, v)
        M += np.triu(M, 1).T
        J, e, drift = WeldRows.at(tree, data, frames, scale, q, v)
        pull = -drift - 2.0 / (d * T) * (J @ v) - e / (d * T**2)
        blocks = np.block([[M, -J.T], [J, np.diag(model.data.efc_R)]])
        parts = np.split(np.linalg.solve(blocks, np.concatenate((tau - h, pull))), [nv])
        assert_allclose(a, parts[0], rtol=0.0, atol=1e-9 * abs(parts[0]).max())
        torques, local = J.T @ parts[1], WeldRows.at(tree, data, frames, -2.0, q, v).J
        local[:3] = data.oMf[tree.getFrameId(frames[0])].rotation.T @ local[:3]  # all rows in axes of the tip
        assert_allclose(local.T @ on_tip.vector, torques, rtol=0.0, atol=1e-7 * abs(torques).max())
        mobility = J @ np.linalg.solve(M, J.T)
        rigid = np.linalg.lstsq(mobility, pull - J @ np.linalg.solve(M, tau - h), rcond=1e-10)[0]
        softness = max(softness, abs(J.T @ rigid - torques).max() / abs(torques).max())
    assert 1e-6 < softness < 4e-3


JOINTS = {
    "planar, a hinge": ("adept-anchored", {"right": "hinge"}),
    "planar, two hinges": ("adept-anchored", {"left": "hinge", "right": "hinge"}),
    "spatial, a hinge": ("two-pandas-box", {"right": "hinge"}),
    "spatial, a ball": ("two-pandas-box", {"right": "ball"}),
    "spatial, a hinge and a ball": ("two-pandas-box", {"left": "hinge", "right": "ball"}),
}
POINTS = {"axis": (-0.2, 0.2), "point": (0.0,), "full": ()}
"""Points of the connects of a joint on z of C, m."""


@pytest.mark.parametrize("case", JOINTS)
def test_with_hinges_and_balls_accelerations_and_wrenches_are_those_of_a_regularised_kkt(case):
    """As of welds; the rows are the differences of points on the axis, with classical accelerations."""
    scenario, rng, step = jointed(*JOINTS[case]), np.random.default_rng(2), 1e-3
    chain, options = CellChain(scenario.cell), MujocoOptions()
    tree, closures, world = chain.model.model, chain.mechanism.closures.closures, pin.LOCAL_WORLD_ALIGNED
    model, marked = MujocoModel(tree, closures, options, step=step), tree.copy()
    frames, of_rows = [], []
    for number, closure in enumerate(closures):
        for z in (0.0, *POINTS[closure.rows]):
            for on, X in ((closure.frame_a, closure.X_AC), (closure.frame_b, closure.X_BC)):
                frame = tree.frames[tree.getFrameId(on)]
                pose = frame.placement * pin.SE3(X) * pin.SE3(np.eye(3), np.array((0.0, 0.0, z)))
                name, kind = f"{len(frames)}", pin.FrameType.OP_FRAME
                frames.append(marked.addFrame(pin.Frame(name, frame.parentJoint, 0, pose, kind)))
        of_rows += [number] * 3 * len(POINTS[closure.rows])
    data, softness = marked.createData(), 0.0
    T, d, nv = options.time_constant * step, options.impedance, tree.nv
    q_start = chain.configuration(scenario.start.matrix)
    for _ in range(STATES):
        q = chain.mechanism.project_configuration(pin.integrate(tree, q_start, 0.03 * rng.normal(size=nv)))
        v = chain.mechanism.project_velocity(q, rng.normal(size=nv)) + 1e-3 * rng.normal(size=nv)
        tau = 20.0 * rng.normal(size=nv)
        a, on_tips = model.forces(q, v, tau)
        M, h = np.triu(pin.crba(marked, data, q)), pin.nonLinearEffects(marked, data, q, v)
        M += np.triu(M, 1).T
        pin.computeJointJacobians(marked, data, q)
        pin.forwardKinematics(marked, data, q, v, np.zeros(nv))
        pin.updateFramePlacements(marked, data)
        J_of = [pin.getFrameJacobian(marked, data, frame, world) for frame in frames]
        a_of = [pin.getFrameClassicalAcceleration(marked, data, frame, world).linear for frame in frames]
        p_of = [data.oMf[frame].translation for frame in frames]
        J, drift, e, of_C, at = [], [], [], [], 0
        for closure in closures:
            of_C.append((J_of[at] - J_of[at + 1], data.oMf[frames[at]].rotation))
            for point in range(at + 2, at + 2 + 2 * len(POINTS[closure.rows]), 2):
                J.append(J_of[point][:3] - J_of[point + 1][:3])
                drift.append(a_of[point] - a_of[point + 1])
                e.append(p_of[point] - p_of[point + 1])
            at += 2 + 2 * len(POINTS[closure.rows])
        J, pull = np.concatenate(J), -np.concatenate(drift)
        pull -= 2.0 / (d * T) * (J @ v) + np.concatenate(e) / (d * T**2)
        blocks = np.block([[M, -J.T], [J, np.diag(model.data.efc_R)]])
        parts = np.split(np.linalg.solve(blocks, np.concatenate((tau - h, pull))), [nv])
        assert_allclose(a, parts[0], rtol=0.0, atol=1e-9 * abs(parts[0]).max())
        for number, (F, (J_C, R)) in enumerate(zip(on_tips, of_C, strict=True)):
            at_C = np.concatenate((R @ F.linear, R @ F.angular))
            torques = J[np.equal(of_rows, number)].T @ parts[1][np.equal(of_rows, number)]
            # in a plane rows of points repeat each other: R alone divides the force among them
            assert_allclose(J_C.T @ at_C, torques, rtol=0.0, atol=1e-6 * abs(torques).max())
        mobility = J @ np.linalg.solve(M, J.T)
        rigid = np.linalg.lstsq(mobility, pull - J @ np.linalg.solve(M, tau - h), rcond=1e-10)[0]
        softness = max(softness, abs(J.T @ (rigid - parts[1])).max() / abs(J.T @ parts[1]).max())
    assert 1e-6 < softness < 4e-3


@pytest.mark.parametrize("name", ["planar", "spatial", *AT_THE_GATE])
def test_the_difference_to_rigid_grasps_falls_with_the_step(name):
    scenario = CASES[name][0]().replace(events=(), duration=CASES[name][1])
    apart, gaps = [], []
    for steps in (2, 4, 8):
        changed = scenario.override({"clock.steps_per_tick": steps})
        runs = [cp.run(changed, engine=engine, warn=False) for engine in ("pinocchio", "mujoco")]
        apart.append(differences(*runs)["position"])
        gaps.append(runs[1].closure_error_max()[0])
    orders = [np.log2(np.divide(each[:-1], each[1:])) for each in (apart, gaps)]
    assert orders[0].mean() > 0.75
    assert orders[1].min() > 1.9  # what a weld bears at rest opens it by T^2


@pytest.mark.parametrize("name", ["planar", "spatial", "three", "planar hinges", "spatial hinges"])
def test_the_model_that_is_written_reads_back_to_the_same_numbers_and_moves_alike(name, tmp_path):
    scenario = without_friction(CASES[name][0]().replace(events=(), duration=1.0))
    scenario.save(tmp_path / "cell.toml")
    assert (
        main(["export", str(tmp_path / "cell.toml"), "--to", "mjcf", "--out", str(tmp_path / "cell.xml")])
        == 0
    )
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data, M = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    chain = CellChain(scenario.cell)
    tree, q = chain.model.model, chain.configuration(scenario.start.matrix)
    expected = pin.crba(tree, tree.createData(), q)
    assert_allclose(np.triu(M), np.triu(expected), rtol=0.0, atol=1e-12 * abs(expected).max())
    X_WP = scenario.start.matrix
    assert_allclose(data.site("payload").xpos, X_WP[:3, 3], rtol=0.0, atol=1e-9)
    assert_allclose(data.site("payload").xmat.reshape(3, 3), X_WP[:3, :3], rtol=0.0, atol=1e-9)
    plant = MujocoPlant(chain, PlantOptions(), q)
    free = [joint for joint in tree.joints if joint.nv == 6]
    torques, step = 0.1 * np.arange(model.nv), model.opt.timestep
    torques[model.nv - 6 * len(free) :] = 0.0  # their axes differ
    plant.restore(plant.state()._replace(force=torques))
    for number in range(5):
        data.qfrc_applied[:] = torques
        mujoco.mj_step(model, data)
        plant.advance(step * number, step)
    for joint in free:  # MuJoCo's steps of a free joint are others, too
        R = pin.XYZQUATToSE3(plant.q[joint.idx_q :][:7]).rotation
        data.qvel[joint.idx_v :][:3] = R.T @ data.qvel[joint.idx_v :][:3]
    assert_allclose(data.qvel, plant.v, rtol=0.0, atol=(1e-7 if free else 1e-11) * abs(plant.v).max())


def rows_of_the_page() -> list[list[str]]:
    """Rows of the table of settings."""
    lines = (
        (Path(__file__).parents[2] / "docs" / "howto" / "engines.md").read_text(encoding="utf-8").splitlines()
    )
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines if line[:1] == "|"]
    return rows[2:]


@pytest.mark.slow
@pytest.mark.parametrize("row", rows_of_the_page(), ids=lambda row: row[0])
def test_the_table_of_the_page_is_what_its_settings_give(row):
    setting, *numbers = row
    field, _, value = setting.partition(" = ")
    scenario = cp.Scenario.load("two-pandas-box", {"duration": 0.2})
    changed = scenario if field == "none" else scenario.override({field: float(value)})
    runs = [cp.run(changed, engine=engine, warn=False) for engine in ("pinocchio", "mujoco")]
    apart = differences(*runs)
    found = apart["force"], apart["moment"], runs[1].closure_error_max()[0]
    assert_allclose(found, list(map(float, numbers)), rtol=0.1)


REFUSED = {
    "adept-compliant": {},
    "two-pandas-palms": {},
    "three-ur5-handover": {},
    "pick-carry-place": {},
    "three-rolling-ur5": {},
    "two-pandas-box": {"events": [{"kind": "lose-arm", "time": 1.0, "arm": "left"}]},
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_mujoco_lacks_is_refused_before_the_run(name, tmp_path, monkeypatch, capsys):
    scenario = cp.Scenario.load(name, REFUSED[name])
    assert unlike_plant(scenario.cell, scenario.plant, scenario.events)
    with pytest.raises(FieldError, match="does not have"):
        cp.run(scenario, engine="mujoco", warn=False)
    with pytest.raises(FieldError, match="does not have"):
        choose_engines([scenario], "mujoco", [1])
    monkeypatch.chdir(tmp_path)
    scenario.save("cell.toml")
    assert main(["run", "cell.toml", "--engine", "mujoco"]) == 2
    assert "does not have" in capsys.readouterr().err


def test_without_mujoco_the_engine_names_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match="mujoco"):
        cp.run("adept-paper", engine="mujoco", warn=False)


def test_sweeps_and_comparisons_take_it_and_refuse_what_it_lacks(tmp_path):
    execution = cp.Execution(workers=0, engine="mujoco", quiet=True)
    short = {"duration": 0.05, "events": ()}
    swept = cp.sweep(
        "adept-anchored", {"seed": [1, 2]}, out=tmp_path / "s", changes=short, execution=execution
    )
    assert [record.engine for record in swept.store.records()] == ["mujoco", "mujoco"]
    table = cp.compare(
        "adept-anchored", ["anchored"], ["nominal"], out=tmp_path / "c", duration=0.05, execution=execution
    )
    assert len(table.table) == 1
    release = {"kind": "lose-arm", "time": 0.02, "arm": "left"}
    cases = {"all": {"events": []}, "lost": {"events": [release]}}
    mixed = cp.sweep(
        "adept-anchored", out=tmp_path / "m", changes={"duration": 0.05}, cases=cases, execution=execution
    )
    assert sorted(record.failure for record in mixed.store.records()) == ["", "FieldError"]
    with pytest.raises(FieldError, match="does not have"):
        cp.sweep("adept-compliant", {"seed": [1, 2]}, out=tmp_path / "r", changes=short, execution=execution)
    with pytest.raises(FieldError, match="does not have"):
        cp.compare(
            "adept-compliant",
            ["anchored"],
            ["nominal"],
            out=tmp_path / "d",
            duration=0.05,
            execution=execution,
        )


def test_auto_does_not_choose_it():
    for name in cp.scenario_names():
        assert choose_engine(cp.Scenario.load(name), "auto").engine != "mujoco"


def test_a_grasp_neither_opens_nor_closes():
    scenario = planar_scenario()
    chain = CellChain(scenario.cell)
    plant = MujocoPlant(chain, PlantOptions(), chain.configuration(scenario.start.matrix))
    for change in (plant.release, plant.grasp, plant.brake):
        with pytest.raises(FieldError, match="neither open nor close"):
            change(1)


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_a_run_that_is_resumed_goes_on_bit_for_bit(name):
    scenario = eventful(name)
    whole, begun, resumed = (
        Simulation(scenario, build_controller(scenario), plant=MujocoPlant) for _ in range(3)
    )
    half = scenario.clock.ticks(scenario.duration) // 2
    for simulation in (whole, begun):
        for _ in range(half):
            simulation.tick()
    resumed.restore(begun.state())
    for simulation in (whole, resumed):
        for _ in range(5):
            simulation.tick()
    assert (whole.plant.q == resumed.plant.q).all()
    assert (whole.plant.v == resumed.plant.v).all()


COVERED = (
    *("adept-hinges", "two-pandas-hinges", "tiago-pro-tray", "two-pandas-door"),
    *("adept-anchored", "adept-paper", "adept-paper-fit", "baxter-box", "five-joint-pair", "four-ur5-plate"),
    *("human-partner", "kinova-pair", "panda-ur5-bar", "three-driven-ur5", "three-ur5-far"),
    *("three-ur5-plate", "two-pandas-box", "two-ur5-admittance"),
)


@pytest.mark.gate
def test_a_scenario_of_the_catalogue_is_compared_or_refused_by_name():
    for name in cp.scenario_names():
        scenario = cp.Scenario.load(name)
        if name in COVERED:
            assert choose_engine(scenario, "mujoco").engine == "mujoco"
        else:
            with pytest.raises(FieldError, match=r"does not have this: .+; choose 'pinocchio'"):
                choose_engine(scenario, "mujoco")


def test_noise_delay_and_servo_have_the_same_draws():
    """Another seed is another run; another engine is not."""
    late = {"sensors.wrist.delay": 2, "sensors.encoder.noise": 1e-5, "duration": 0.2, "seed": 3}
    scenario = cp.Scenario.load("two-ur5-admittance", late)
    ours, theirs = (cp.run(scenario, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    other = cp.run(scenario.replace(seed=4), warn=False)
    apart, seeds = differences(ours, theirs), differences(ours, other)
    assert apart["position"] < 2e-6
    assert apart["force"] < 1e-2
    for name in ("position", "force"):
        assert apart[name] < 0.02 * seeds[name]


FINER = {"adept-paper": {"clock.steps_per_tick": 10}}
"""Steps where a sign in the law turns 1e-8 m into another instant of switching."""


@pytest.mark.slow
@pytest.mark.parametrize("name", COVERED)
def test_every_scenario_of_the_catalogue_that_does_not_give_moves_as_on_pinocchio(name):
    scenario = cp.Scenario.load(name, FINER.get(name, {}))
    ours, theirs = (cp.run(scenario, engine=engine, warn=False) for engine in ("pinocchio", "mujoco"))
    apart = differences(ours, theirs)
    assert apart["position"] < 1e-6
    assert apart["orientation"] < 2e-6
    assert apart["force"] < 1e-3
    assert apart["end"] < 2e-4
    assert theirs.simulation_sound
    assert theirs.task.state == ours.task.state
