"""Static torques: against virtual work, RNEA with the payload attached, and the closed chain at rest."""

import re

import numpy as np
import pinocchio as pin
import pytest
from cells import planar_scenario, spatial_scenario
from close import unwrapped
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, FieldError, InfeasibleMotionError, ScenarioWarning
from coop_pin.base.spatial import pose_error, rotate_vector6
from coop_pin.cli import main
from coop_pin.control.terms import right_inverse
from coop_pin.feasibility import (
    ArmStatics,
    StaticTorques,
    loads_without_an_arm,
    reachability,
    start_torques,
    static_torques,
    statics_along,
)
from coop_pin.feasibility.motion_feasibility import require_feasible
from coop_pin.model import ArmModel, CellArm
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.simulation import Simulation

STEP = 1e-6


def planar():
    """The paper's cell stood upright, so that gravity acts on its drives, which a matrix couples."""
    limits = {f"cell.arms.{arm}.torque_limits": [400.0, 400.0, 40.0] for arm in ("left", "right")}
    return planar_scenario().override({"cell.gravity": (0.8, -9.7, 0.0), "events": [], **limits})


BOTH = pytest.mark.parametrize("build", [planar, spatial_scenario])


def pandas(mass):
    return cp.Scenario.load("two-pandas-box", {"cell.payload.mass": mass})


def xarms(mass):
    """Two xArm7 that hold a box between them as they stand."""
    posture, turned = (0.0, -0.3, 0.0, 1.2, 0.0, 1.5, 0.0), (0.0, 0.0, np.pi)
    arms = {
        name: cp.Arm(urdf="xarm7", tip="link_eef", posture=posture, base=base)
        for name, base in {
            "left": cp.Pose(xyz=(-0.6, 0.0, 0.0)),
            "right": cp.Pose(xyz=(0.6, 0.0, 0.0), rpy=turned),
        }.items()
    }
    middle = np.mean([ArmModel(arm).tip_pose(posture)[:3, 3] for arm in arms.values()], axis=0)
    start = cp.Pose(xyz=tuple(middle))
    payload = cp.Payload.box(mass, (0.3, 0.2, 0.1))
    return cp.Scenario(
        name="two-xarms",
        cell=cp.Cell(arms=arms, payload=payload, payload_pose=start, grasps="as-posed"),
        start=start,
        motion=cp.motions.HoldMotion(pose=start),
        controller=cp.Scenario.load("two-pandas-box").controller,
        clock={"rate_hz": 500.0},
        duration=1.0,
    )


# ---------------------------------------------------------------- against other computations


@BOTH
def test_each_part_is_the_virtual_work_of_its_cause(build):
    """Central differences of potential energies, and of the payload pose for the squeeze, drive by drive."""
    scenario = build()
    found = reachability(scenario, poses=4)
    torques = statics_along(scenario, found)
    for index, (reach, statics) in enumerate(zip(found.arms, torques.arms, strict=True)):
        model = CellArm(scenario.cell, reach.arm)
        data, to_joints = model.model.createData(), np.linalg.inv(model.drive)
        pull = scenario.cell.shares[index] * scenario.cell.payload.mass * np.array(scenario.cell.gravity)
        for at in (0, 12, -1):
            q = reach.q[at]
            f_P = scenario.squeeze.at(float(reach.times[at]), scenario.cell.grasps)[index]
            X = model.payload_pose(q)
            f_d = rotate_vector6(X[:3, :3], np.array(f_P))
            for k, joint_step in enumerate(STEP * to_joints.T):
                ahead, behind = (pin.integrate(model.model, q, sign * joint_step) for sign in (1.0, -1.0))
                U = [pin.computePotentialEnergy(model.model, data, each) for each in (ahead, behind)]
                X_ahead, X_behind = model.payload_pose(ahead), model.payload_pose(behind)
                moved = pose_error(X_ahead, X_behind) / (2 * STEP)
                assert_allclose(statics.weight[at, k], (U[0] - U[1]) / (2 * STEP), atol=1e-6)
                assert_allclose(statics.load[at, k], -pull @ moved[:3], atol=1e-6)
                assert_allclose(statics.squeeze[at, k], -f_d @ moved, atol=1e-6)
    assert max(np.abs(arm.weight).max() for arm in torques.arms) > 5.0


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_one_arm_with_the_whole_load_is_rnea_with_the_payload_attached(name):
    scenario = {"planar": planar, "spatial": spatial_scenario}[name]()
    cell = scenario.cell
    alone = cell.replace(
        arms={"left": cell.arms["left"]}, grasps={"left": cell.grasps["left"]}, load_shares=None
    )
    scenario = scenario.replace(cell=alone, squeeze={})
    found = reachability(scenario, poses=3)
    model = CellArm(alone, "left")
    frame = model.model.frames[model.model.getFrameId("payload")]
    loaded = model.model.copy()
    body = pin.Inertia(alone.payload.mass, np.zeros(3), alone.payload.inertia_matrix)
    loaded.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    rest = np.zeros(model.nv)
    expected = [
        np.linalg.solve(model.drive.T, pin.rnea(loaded, loaded.createData(), q, rest, rest))
        for q in found.arms[0].q
    ]
    assert_allclose(statics_along(scenario, found).arms[0].torque, expected, atol=1e-9)


@BOTH
def test_without_one_of_two_arms_the_other_has_the_whole_load_and_the_weight_of_a_limp_arm(build):
    """With one arm left nothing is to be chosen: tau = g - J^T (W - F_dead)."""
    scenario = build()
    cell, found = scenario.cell, reachability(scenario, poses=9)
    loads = loads_without_an_arm(scenario, found)
    models = [CellArm(cell, arm.arm) for arm in found.arms]
    for dead, alive in ((0, 1), (1, 0)):
        model, expected = models[alive], []
        for at in np.linspace(0, len(found.arms[0].times) - 1, 9).astype(int):
            q, q_dead = found.arms[alive].q[at], found.arms[dead].q[at]
            g, g_dead = (
                m.nonlinear_effects(x, np.zeros(m.nv)) for m, x in ((model, q), (models[dead], q_dead))
            )
            J, J_dead = model.payload_jacobian(q), models[dead].payload_jacobian(q_dead)
            W = np.append(cell.payload.mass * np.array(cell.gravity), np.zeros(3))
            F_dead = np.linalg.lstsq(J_dead.T, g_dead, rcond=None)[0]
            torques = [np.linalg.solve(model.drive.T, g - J.T @ F) for F in (W - F_dead, W)]
            expected.append((np.abs(torques) / model.limits.torque).max(axis=1))
        assert_allclose(loads[found.arms[dead].arm], np.max(expected, axis=0), rtol=1e-6)


def test_which_cells_no_law_can_hold_with_a_dead_arm():
    """The parts of the limits that the others need; three arms choose their internal wrench."""
    found = {}
    for name in ("two-pandas-box", "panda-ur5-bar", "three-ur5-plate", "kinova-pair", "five-joint-pair"):
        scenario = cp.Scenario.load(name)
        loads = loads_without_an_arm(scenario, reachability(scenario, poses=9))
        found[name] = np.max([*loads.values()], axis=0)
    assert_allclose([limp for limp, _ in found.values()], [3.302, 3.95, 0.393, 0.574, 0.282], rtol=2e-3)
    assert max(carried for _, carried in found.values()) == pytest.approx(0.889, rel=2e-3)


@pytest.mark.parametrize("build", [planar, spatial_scenario, lambda: pandas(3.0)])
def test_the_closed_chain_stays_at_rest_under_them_with_load_and_squeeze_as_desired(build):
    scenario = build()
    simulation = Simulation(scenario, build_controller(scenario))
    torques, plant = start_torques(simulation), simulation.plant
    force = plant.transmission.torque([arm.torque[0] for arm in torques.arms])
    rest = np.zeros(len(plant.v))
    assert_allclose(plant.chain.mechanism.forward_dynamics(plant.q, rest, force).acceleration, 0.0, atol=1e-7)
    weight = np.array((*scenario.cell.gravity, 0.0, 0.0, 0.0)) * scenario.cell.payload.mass
    R = scenario.start.matrix[:3, :3]
    squeeze = [rotate_vector6(R, np.array(f_d)) for f_d in scenario.squeeze_wrenches]
    expected = np.outer(scenario.cell.shares, weight) + squeeze
    wrenches = plant.chain.interaction_wrenches(plant.q, rest, force, np.zeros(6))
    rows = scenario.cell.task_rows.select
    assert_allclose([rows(F) for F in wrenches], [rows(F) for F in expected], atol=1e-6)


# ---------------------------------------------------------------- findings


@pytest.mark.parametrize(
    ("build", "mass", "joint", "torque", "limit"),
    [(pandas, 9.27, "panda_joint6", 17.3, 12.0), (xarms, 6.76, "joint4", 33.4, 30.0)],
)
def test_an_arm_that_reaches_every_pose_but_cannot_hold_is_found(build, mass, joint, torque, limit):
    scenario = build(mass)
    found = reachability(scenario, poses=3)
    torques = statics_along(scenario, found)
    worst = torques.worst
    assert (found.ok, torques.ok, worst.ok) == (True, False, False)
    assert (worst.joint, worst.limit, worst.unit) == (joint, limit, "N m")
    assert worst.torque == pytest.approx(torque, abs=0.05)
    assert worst.torque == worst.weight + worst.load + worst.squeeze
    assert worst.load > worst.weight > 0.0
    assert torques.overloaded[0] == worst
    assert f"{joint} needs {torque} of {limit:g} N m" in torques.summary()


def test_a_payload_that_gets_heavier_overloads_from_then_on():
    heavier = {"events": [{"kind": "payload-change", "time": 5.0, "mass": 9.27}]}
    torques = static_torques(pandas(3.0).override(heavier), poses=5)
    assert torques.worst.time >= 5.0
    assert torques.worst.torque > 17.0
    late = torques.arms[0].times >= 5.0
    assert np.abs(torques.arms[0].load[late]).max() > 3.0 * np.abs(torques.arms[0].load[~late]).max()


def test_arms_without_limits_hold_anything_and_one_out_of_reach_has_no_torques():
    assert static_torques(planar_scenario(), poses=2).worst is None
    away = planar().override({"start.xyz": (3.0, 0.0, 0.0)})
    torques = static_torques(away, poses=2)
    assert (torques.drives, torques.ok) == ((), True)


def test_a_drive_at_a_limit_of_exactly_its_torque_holds():
    worst = static_torques(planar(), poses=3).worst
    assert worst.limit in (400.0, 40.0)
    assert worst.ok
    assert not worst._replace(limit=np.nextafter(worst.torque, 0.0)).ok
    assert worst._replace(limit=worst.torque).ok


# ---------------------------------------------------------------- joint counts


def five_joints():
    """A UR5 with its last joint locked, alone, with the box at its tip: five joints for six task rows."""
    locked, posture = {"wrist_3_joint": 0.2}, (0.1, -1.2, 1.6, -1.0, -1.4)
    arm = cp.Arm(urdf="ur5", tip="tool0", locked=locked, posture=posture)
    start = cp.Pose.from_matrix(ArmModel(arm).tip_pose(posture))
    cell = cp.Cell(
        arms={"only": arm}, payload=cp.Payload.box(1.0, (0.1, 0.1, 0.1)), grasps={"only": cp.Pose()}
    )
    controller = cp.Scenario.load("two-pandas-box").controller
    return cp.Scenario(
        name="five", cell=cell, start=start, motion=cp.motions.HoldMotion(pose=start), controller=controller
    )


def test_too_few_joints_are_counted_and_not_called_a_singular_pose():
    arm = reachability(five_joints(), poses=2).arms[0]
    assert not arm.ok
    assert (arm.unreachable, arm.nearest_singularity) == (None, None)
    problems = " ".join(arm.problems())
    assert "5 joints, 6 task rows" in problems
    assert "'positional'" in problems
    assert "singular" not in problems


def test_controllers_refuse_too_few_joints_by_their_counts():
    with pytest.raises(FieldError, match=r"5 joints, 6 task rows.*'positional'") as caught:
        build_controller(five_joints())
    assert caught.value.path == "controller.kind"
    with pytest.raises(ArgumentError, match="5 joints, 6 task rows"):
        right_inverse(np.eye(6)[:, :5], 0.0)


def test_an_arm_with_as_many_joints_as_rows_is_not_refused():
    assert reachability(five_joints().override({"cell.rows": "positional"}), poses=2).ok


# ---------------------------------------------------------------- command line


def test_an_arm_that_cannot_hold_the_start_is_not_said_to_have_no_limits():
    def statics(name, poses):
        torque = np.full((poses, 1), 3.0)
        return ArmStatics(name, ("a",), ("N m",), np.arange(poses), torque, torque, torque, np.array([10.0]))

    left, right = statics("left", 0), statics("right", 2)
    assert StaticTorques((left, right)).worst.arm == "right"
    assert "without left" in StaticTorques((left, right)).summary()
    assert "without" not in StaticTorques((right,)).summary()
    assert StaticTorques((left,)).summary().endswith("not computed")


@pytest.mark.gate
def test_check_fails_where_a_drive_cannot_hold(capsys):
    words = ["check", "two-pandas-box", "--poses", "3"]
    assert main(words) == 0
    assert "panda_joint6 needs 8.54 of 12 N m" in unwrapped(capsys.readouterr().out)
    assert main([*words, "--cell.payload.mass", "9.27"]) == 1
    assert "panda_joint6 needs 17.3 of 12 N m" in unwrapped(capsys.readouterr().out)


def test_run_warns_of_weak_drives_and_of_unstable_gains_before_it_starts(tmp_path):
    common = ["--out", str(tmp_path), "--quiet", "--no-replay", "--no-figures", "--duration", "0.01"]
    with pytest.warns(ScenarioWarning) as caught:
        assert main(["run", "two-pandas-box", *common, "--cell.payload.mass", "9.27"]) == 4
    said = [text for warning in caught if "the motion" not in (text := str(warning.message))]
    assert len(said) == 2
    assert all("17.3 of 12 N m" in text for text in said)
    posture = ["--controller.posture.damping", "800"]
    with pytest.warns(ScenarioWarning, match="exceeds the stability limit"):
        main(["run", "two-pandas-box", *common, *posture])


def test_a_motion_that_raises_is_left_to_the_run(tmp_path, capsys):
    words = ["--motion.kind", "function", "--motion.target", "math:sqrt"]
    out = ["--out", str(tmp_path), "--quiet"]
    assert main(["run", "adept-paper", *out, *words, "--motion.options", "{x = 1}"]) in (1, 2)
    assert "warning" not in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "show", "view", "tune"])
def test_commands_take_the_fields_of_run_and_refuse_unknown_ones(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = ["--minimize", "moving_position_rms_m", "--vary", "controller.gains.sign-gain", "0", "1"]
    words = [command, "adept-paper", *(own if command == "tune" else [])]
    assert main([*words, "--controller.gains.sing-gain", "1"]) == 2
    assert "'sign_gain'" in capsys.readouterr().err


def test_show_takes_fields(capsys):
    assert main(["show", "adept-paper", "--cell.payload.mass=3.5", "--cell.gravity", "0", "0", "-5"]) == 0
    printed = capsys.readouterr().out
    assert "3.5 kg" in printed
    assert "gravity (0, 0, -5)" in printed


def test_tune_refuses_a_field_with_a_range_and_a_value(capsys):
    gain = "controller.gains.sign-gain"
    words = [
        "tune",
        "adept-paper",
        "--minimize",
        "moving_position_rms_m",
        "--vary",
        gain,
        "0",
        "1",
        f"--{gain}",
        "2",
    ]
    assert main(words) == 2
    assert "a range and a value" in capsys.readouterr().err


def test_fields_of_a_scenario_are_refused_for_runs_and_robots(tmp_path, capsys):
    assert main(["view", str(tmp_path), "--duration", "3"]) == 2
    assert main(["show", "panda", "--duration", "3"]) == 2
    assert capsys.readouterr().err.count("--duration: ") == 2


@pytest.mark.parametrize("by_file", [False, True])
def test_show_of_a_robot_lists_links_joints_limits_and_tips(by_file, capsys):
    path = cp.urdf.robot_files()["panda"]
    assert main(["show", str(path) if by_file else "panda"]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0] == str(path.resolve())
    assert re.search(r"panda_joint6: revolute[^:]*up to 12 N m", unwrapped(out))
    assert re.search(r"panda_finger_joint1: prismatic[^:]*0 \.\. 0\.04 m", unwrapped(out))
    tips = lines[lines.index("candidate tips:") + 1 :]
    assert "  panda_hand_tcp: 7 joints from the root" in tips
    assert "  panda_leftfinger: 8 joints from the root" in tips


def test_show_and_check_urdf_take_packages_and_arguments_of_a_xacro(tmp_path, capsys):
    pytest.importorskip("xacrodoc")
    head = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "parts" / "mass").mkdir(parents=True)
    (tmp_path / "parts" / "mass" / "package.xml").write_text("<package><name>mass</name></package>")
    (tmp_path / "parts" / "mass" / "tip.xacro").write_text(f'{head}<link name="$(arg tip)"/></robot>')
    (tmp_path / "arms").mkdir()
    file = tmp_path / "arms" / "arm.xacro"
    include = '<xacro:include filename="$(find mass)/tip.xacro"/>'
    file.write_text(f'{head}<xacro:arg name="tip" default="tool"/>{include}</robot>')
    options = ["--package-dirs", str(tmp_path / "parts"), "--xacro-args", "tip:=gripper"]
    assert main(["show", str(file), *options]) == 0
    assert "1 links, 0 kg: gripper" in capsys.readouterr().out
    assert main(["check-urdf", str(file), *options]) == 0
    assert main(["show", str(file)]) == 2
    assert "package_dirs" in capsys.readouterr().err
    assert main(["check-urdf", str(file), "--xacro-args", "tip"]) == 2
    assert main(["show", "adept-paper", "--xacro-args", "tip=a"]) == 2
    assert capsys.readouterr().err.count("--xacro-args: ") == 2


def test_show_suggests_scenarios_and_robots(capsys):
    assert main(["show", "pand"]) == 2
    assert "'panda'" in capsys.readouterr().err


@pytest.mark.slow
def test_robots_can_be_listed_and_each_name_is_an_arms(capsys):
    assert main(["list", "--robots"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line.split()[0] for line in lines if not line.startswith((" ", "without an arm"))]
    assert {"adept_3dof", "panda", "ur5", "kinova", "xarm7"} <= set(names)
    assert names == sorted(set(names))


@BOTH
def test_effort_below_an_arms_own_weight_is_told_and_the_limit_is_the_remedy(build):
    """As of a file whose effort is a placeholder; the weight alone is beyond it, whatever the payload."""
    scenario = build().override({"squeeze": {}})
    reach = reachability(scenario, poses=5)
    arms = statics_along(scenario, reach).arms
    limits = [0.5 * max(float(np.abs(arm.weight).max()) for arm in arms)] * arms[0].weight.shape[1]
    weak = scenario.override({f"cell.arms.{name}.torque_limits": limits for name in scenario.cell.arms})
    with pytest.raises(InfeasibleMotionError, match=r"<limit effort>.*torque_limits") as error:
        require_feasible(weak, reach, statics_along(weak, reach))
    assert error.value.cause == "torque"
    strong = {f"cell.arms.{name}.torque_limits": [4.0 * x for x in limits] for name in weak.cell.arms}
    remedied = weak.override(strong)
    require_feasible(remedied, reach, statics_along(remedied, reach))
