"""Arms of one robot, arms on mobile bases, four arms: kinematics, dynamics, refusals and what is drawn."""

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError, UrdfError
from coop_pin.base.spatial import make_pose
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.design.named_arms import RobotFiles, arms_of_robot
from coop_pin.design.placing.contacts import Shoulders, contacts
from coop_pin.model.visuals import CellVisuals

ANGLES = np.array((0.3, -1.2, 1.6, -1.0, -1.4, 0.2))
BASE = cp.Pose(xyz=(0.4, -0.2, 0.1), rpy=(0.0, 0.0, 0.7))


def ur5(**fields):
    return cp.model.ArmModel(cp.Arm(urdf="ur5", tip="tool0", base=BASE, **fields))


# ---------------------------------------------------------------- mobile bases


@pytest.mark.parametrize("name", ["ur5", "adept_3dof"])
def test_an_arm_on_a_mobile_base_is_the_arm_on_a_platform_that_has_moved(name):
    """Against the arm alone with its base at the platform's top; a spatial arm and a planar one."""
    size, moved = (0.8, 0.6, 0.35), (1.2, -0.7, 0.5)
    tip = "tool0" if name == "ur5" else "tip"
    platform = cp.MobileBase(size=size, mass=90.0)
    mobile = cp.model.ArmModel(cp.Arm(urdf=name, tip=tip, base=BASE, mobile_base=platform))
    X_WB = BASE.matrix @ make_pose((*moved[:2], size[2]), (0.0, 0.0, moved[2]))
    alone = cp.model.ArmModel(cp.Arm(urdf=name, tip=tip, base=X_WB))
    angles = ANGLES[: alone.nv]
    q, q_alone = mobile.configuration((*moved, *angles)), alone.configuration(angles)
    assert mobile.nv == alone.nv + 3
    assert_allclose(mobile.tip_pose(q), alone.tip_pose(q_alone), atol=1e-12)
    assert_allclose(mobile.payload_jacobian(q)[:, 3:], alone.payload_jacobian(q_alone), atol=1e-12)
    M = mobile.mass_matrix(q)
    assert_allclose(M[3:, 3:], alone.mass_matrix(q_alone), atol=1e-12)
    total = 90.0 + sum(inertia.mass for inertia in alone.model.inertias)
    assert_allclose(M[:2, :2], total * np.eye(2), atol=1e-9)
    v = np.linspace(-0.4, 0.5, mobile.nv)
    h = 1e-6
    forward, backward = (mobile.tip_pose(pin.integrate(mobile.model, q, sign * h * v)) for sign in (1, -1))
    speed = (forward[:3, 3] - backward[:3, 3]) / (2.0 * h)
    assert_allclose((mobile.payload_jacobian(q) @ v)[:3], speed, atol=1e-8)


def test_springs_of_postures_act_on_the_arms_own_joints():
    gains = cp.laws.PostureGains(stiffness=40.0, damping=np.arange(9.0))
    stiffness, damping = gains.of_drives(9, 3)
    assert_allclose(stiffness, [0.0] * 3 + [40.0] * 6)
    assert_allclose(damping, np.arange(9.0))


def test_the_platform_follows_its_arm():
    """A short run at twice the pace; the tip moves 0.1 m, and the platforms come along."""
    result = cp.run(
        "three-driven-ur5",
        {
            "motion.duration": 1.0,
            "motion.start_time": 0.1,
            "duration": 1.5,
            "motion.goal": {"xyz": [0.1, 0.0, 0.78]},
        },
        warn=False,
    )
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    q = result.data.configuration.values
    assert np.abs(q[-1, 9:11] - q[0, 9:11]).max() > 0.03
    assert np.abs(result.data.pose_error.values[:, :3]).max() < 1e-3


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"drive": "differential"}, "DifferentialBase"),
        ({"size": (0.8, 0.0, 0.3)}, "positive"),
        ({"mass": -1.0}, "mass"),
    ],
)
def test_bases_that_cannot_be_are_refused(fields, said):
    with pytest.raises((FieldError, ScenarioError), match=said):
        cp.MobileBase(**fields)


def test_names_of_a_platform_are_taken_and_floating_joints_refused(tmp_path):
    text = load_checked(find_urdf("adept_3dof"))
    (tmp_path / "named.urdf").write_text(text.replace('"joint_1"', '"base_x"'))
    with pytest.raises(UrdfError, match="base_x"):
        cp.model.ArmModel(cp.Arm(urdf=str(tmp_path / "named.urdf"), tip="tip", mobile_base={}))
    assert ur5().nv == 6
    for kind in ("floating", "planar"):
        free = text.replace('name="joint_1" type="revolute"', f'name="joint_1" type="{kind}"')
        (tmp_path / "free.urdf").write_text(free)
        with pytest.raises(UrdfError, match=f"type {kind}"):
            cp.model.ArmModel(cp.Arm(urdf=str(tmp_path / "free.urdf"), tip="tip"))


def test_a_mobile_base_is_written_and_read():
    mobile = cp.Scenario.load("three-driven-ur5")
    assert cp.Scenario.from_toml(mobile.to_toml()) == mobile


# ---------------------------------------------------------------- arms of one robot


def talos(side, **locked):
    tip, robot = f"wrist_{side}_ft_tool_link", Robot(load_checked(find_urdf("talos")))
    return cp.Arm(urdf="talos", tip=tip, locked=robot.idle(tip) | locked)


def cell(**arms):
    return cp.Cell(
        arms=arms, payload=cp.Payload.box(1.0, (0.3, 0.2, 0.2)), grasps=dict.fromkeys(arms, cp.Pose())
    )


def test_a_joint_that_moves_two_arms_is_refused_until_it_is_locked():
    torso = {"torso_1_joint": 0.0, "torso_2_joint": 0.1}
    with pytest.raises(FieldError, match=r"torso_1_joint.*lock it in both"):
        cell(left=talos("left"), right=talos("right"))
    with pytest.raises(FieldError, match=r"torso_2_joint.*lock it in both"):
        cell(left=talos("left", **torso), right=talos("right", torso_1_joint=0.0))
    with pytest.raises(FieldError, match=r"has 0\.1; it is one joint"):
        cell(left=talos("left", **torso), right=talos("right", **torso | {"torso_2_joint": 0.0}))
    assert cell(left=talos("left", **torso), right=talos("right", **torso)).siblings("left") == ("right",)


def test_others_locks_what_does_not_move_the_tip():
    arm = cp.Arm(urdf="baxter", tip="left_gripper", locked="others")
    names = cp.model.ArmModel(arm).limits.joints.names
    assert list(names) == [f"left_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")]
    assert arm == cp.Arm(urdf="baxter", tip="left_gripper", locked=arm.locked)
    with pytest.raises(FieldError, match="others"):
        cp.Arm(urdf="baxter", tip="left_gripper", locked="rest")


def test_each_link_of_a_robot_is_drawn_once():
    """Every visual of the URDF on one body; each arm draws the links that it moves."""
    scenario = cp.Scenario.load("baxter-box")
    bodies = CellVisuals(scenario.cell, scenario.plant.payload).bodies
    drawn = [(visual, body.name) for body in bodies for visual in {shape.name for shape in body.visuals}]
    assert len(dict(drawn)) == len(drawn)
    text = load_checked(find_urdf("baxter"))
    assert len(drawn) == text.count("<visual")
    assert {name for _, name in drawn if name.endswith("/base")} == {"left/base"}
    sides = {visual.split("_")[0]: name.split("/")[0] for visual, name in drawn if "upper" in visual}
    assert sides == {"left": "left", "right": "right"}


@pytest.mark.slow
def test_a_new_cell_of_a_two_armed_robot_has_one_base_and_runs():
    new = cp.new_cell(["baxter"], "box", size=(0.4, 0.2, 0.2))
    left, right = new.scenario.cell.arms.values()
    assert (left.tip, right.tip) == ("left_gripper", "right_gripper")
    assert left.base == right.base
    result = cp.run(new.scenario, {"duration": 1.0}, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()


@pytest.mark.parametrize(("robot", "tips"), [("ur5", ()), ("solo12", ()), ("baxter", ("left_gripper",))])
def test_a_robot_with_one_arm_or_unclear_ones_is_refused(robot, tips):
    with pytest.raises((UrdfError, FieldError)) as caught:
        cp.new_cell([robot], tips=tips)
    assert caught.value.path in ("arms.0", "tips")


# ---------------------------------------------------------------- arms in the files of robots

HANDS = {
    "tiago_dual": ("hand_left_tool_link", "hand_right_tool_link"),  # beyond them are fingers
    "romeo": ("l_gripper", "r_gripper"),
    "talos_full_v2": ("wrist_left_ft_tool_link", "wrist_right_ft_tool_link"),  # as many joints in its legs
    "centauro": ("ball1_tip", "ball2_tip"),  # four legs, and two links on each last body
    "simple_humanoid": ("l_wrist", "r_wrist"),
}


@pytest.mark.parametrize(
    "name",
    [name if name == "simple_humanoid" else pytest.param(name, marks=pytest.mark.gate) for name in HANDS],
)
def test_arms_end_before_fingers_and_are_no_legs_and_the_floor_is_under_the_feet(name):
    arms, _ = arms_of_robot(name, (), RobotFiles((), {}))
    assert tuple(arm.tip for arm in arms.values()) == HANDS[name]
    shoulders, robot = Shoulders.of(arms.values()), arms["left"].robot
    lowest = min(robot.pose(link, arms["left"].locked)[2, 3] for link in robot.links)
    assert_allclose(shoulders.floor, lowest, atol=1e-3)
    assert shoulders.middle[2] > 0.15


def test_tools_ahead_point_from_the_robot_beside_the_payload():
    """Arms side by side hold the same points as from the sides; around the payload nothing changes."""
    box = cp.Payload.box(1.0, (0.4, 0.3, 0.2))
    sides, ahead = ([*contacts(box, 2, side, "one-base")] for side in ("sides", "ahead"))
    assert_allclose([each.point for each in ahead], [each.point for each in sides])
    assert_allclose([each.approach for each in ahead], [(0.0, 1.0, 0.0)] * 2, atol=1e-12)
    sides, ahead = ([*contacts(box, 3, side, "facing")] for side in ("sides", "ahead"))
    assert_allclose([each.approach for each in ahead], [each.approach for each in sides], atol=1e-12)


# ---------------------------------------------------------------- whole runs

LIMITS = {"baxter-box": (0.1e-3, 0.1), "four-ur5-plate": (0.1e-3, 0.1), "three-driven-ur5": (2e-3, 1.0)}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMITS)
def test_the_cells_keep_payload_and_internal_force(name):
    """The largest errors, not rms, from 1 s on; three bases carry the plate 3 m."""
    result = cp.run(name, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), result.verdict()
    late = result.data.time.values >= 1.0
    position = np.linalg.norm(result.data.pose_error.values[late, :3], axis=1).max()
    error = (result.data.internal_wrench - result.data.desired_internal_wrench).values[late, :, :3]
    force = np.linalg.norm(error, axis=2).max()
    print(f"{name}: {1e3 * position:.4f} mm, {force:.4f} N")
    assert position < LIMITS[name][0]
    assert force < LIMITS[name][1]
    assert max(result.closure_error_max()) < 1e-8
    assert result.energy_balance_max() < 1e-5
    if name == "three-driven-ur5":
        assert np.ptp(result.data.payload_position.values[:, 0]) >= 3.0
