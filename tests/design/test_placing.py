"""Places of the arms of new cells: margins as a run counts them, five joints, options of robots."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, InfeasibleMotionError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, log3
from coop_pin.cli import main
from coop_pin.description.cell.grasp import JointGrasp
from coop_pin.description.thresholds import TrustThresholds
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.design.named_arms import RobotFiles, named_arms
from coop_pin.design.new_cell import new_cell
from coop_pin.design.placing.contacts import Shoulders, contacts
from coop_pin.design.placing.drafts import calmer_motions, searches
from coop_pin.design.placing.workspace import common_places
from coop_pin.feasibility import maximum_reach, reachability
from coop_pin.feasibility.motion_feasibility import joint_heights
from coop_pin.feasibility.task_inertia import HeldArm
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.cell_arm import CellArm

ROBOTS = {"planar": "adept_3dof", "spatial": "ur5", "five joints": "so100"}


@pytest.mark.parametrize("kind", ROBOTS)
def test_a_margin_is_the_least_of_torque_range_and_condition_as_a_run_counts_them(kind):
    """Near singular postures, too: the condition of the payload Jacobian, on a hinge in its rows."""
    payload = cp.Payload.box(2.0, (0.2, 0.2, 0.1))
    named = named_arms([ROBOTS[kind]] * 2, (), RobotFiles())
    placement, _ = searches(named, payload, "sides", "facing")
    hold = placement.holds[1]
    grasps = {"left": hold.grasp, "right": Pose(xyz=(0.1, 0.0, 0.0))}
    cell = cp.Cell(
        arms=named, payload=payload, grasps=grasps, rows="planar" if placement.is_planar else "full"
    )
    arm, load = CellArm(cell, "left"), payload.mass / 2.0 * np.array(cell.gravity)
    conditions = []
    for q in arm.limits.random_configurations(40):
        torque = arm.nonlinear_effects(q, np.zeros(arm.nv)) - arm.payload_jacobian(q)[:3].T @ load
        used = np.abs(torque @ arm.from_drive / arm.limits.torque).max()
        conditions.append(np.linalg.cond(arm.task_jacobian(q)))
        least = min(1.0 - used, arm.limits.margin(q), 1.0 - conditions[-1] / cell_limit())
        X_BP = arm.tip_pose(q) @ inverse_pose(hold.grasp.matrix)
        assert_allclose(placement.margin(q, X_BP, hold), least, rtol=1e-6, atol=1e-6)
    assert max(conditions) > cell_limit() > min(conditions)


def cell_limit() -> float:
    """Condition number from which on a run is not trustworthy."""
    return TrustThresholds().jacobian_condition


@pytest.mark.gate
def test_two_arms_of_five_joints_hold_by_upright_hinges_and_keep_their_task():
    suggestion = new_cell(["so100"] * 2)
    assert any("hinges of left, right" in change for change in suggestion.changes)
    scenario = suggestion.scenario.override({"duration": 4.5})
    for grasp in scenario.cell.grasps.values():
        assert isinstance(grasp, JointGrasp)
        assert_allclose(np.abs(grasp.matrix[:3, :3] @ grasp.axis), (0.0, 0.0, 1.0), atol=1e-5)
    metrics = cp.run(scenario).metrics()
    assert metrics["task_kept"] == metrics["simulation_sound"] == 1.0
    assert metrics["position_error_max_m"] < 1e-4


def test_locked_joints_and_repairs_are_those_of_every_arm_that_has_them():
    files = RobotFiles(locked={"wrist_roll": 0.3}, impossible_inertia="repair")
    arms = named_arms(["so100", "ur5"], (), files)
    assert [len(arm.moving_joints()) for arm in arms.values()] == [4, 6]
    assert arms["left"].locked["wrist_roll"] == 0.3
    assert {arm.impossible_inertia for arm in arms.values()} == {"repair"}


@pytest.mark.parametrize("words", [("wrist_roll",), ("=0.1",), ("wrist_roll=much",)])
def test_locked_joints_are_named_with_their_angles(words, tmp_path, capsys):
    path = str(tmp_path / "cell.toml")
    assert main(["new", path, "--arms", "so100", "so100", "--locked", *words])
    assert FieldError.__name__ not in (said := capsys.readouterr().err)
    assert "--locked" in said


@pytest.mark.parametrize("stiffness", [40.0, 4e4])
def test_spare_joints_follow_springs_that_are_stiff_for_the_steps(stiffness):
    """Proposals try springs by doubling: the path stays at the posture, and does not run away."""
    scenario = cp.Scenario.load("two-pandas-box")
    reach = reachability(scenario, poses=5).arms[0]
    held = HeldArm(scenario, reach, cp.laws.PostureGains(stiffness=stiffness, damping=0.4))
    times = np.linspace(0.0, 8.0, 101)
    path = held.path(times, reach.times[reach.first :], reach.q[reach.first :])
    assert np.abs(path - path[0]).max() < 1.0


def test_arms_on_platforms_are_told_which_joints_to_lock(tmp_path):
    """A platform of two slides of 5 m under a UR5: at the places that are tried it stands far away."""
    text = load_checked(find_urdf("ur5"))
    heavy = '<inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    slides = "".join(
        f'<link name="{name}">{heavy}</link>'
        f'<joint name="{name}_slide" type="prismatic"><parent link="{name}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-5" upper="5" effort="100" velocity="1"/></joint>'
        for name, child, axis in (("far", "near", "1 0 0"), ("near", "world", "0 1 0"))
    )
    (tmp_path / "driven.urdf").write_text(text.replace("</robot>", f"{slides}</robot>"))
    with pytest.raises(InfeasibleMotionError, match="far_slide, near_slide"):
        new_cell([tmp_path / "driven.urdf"] * 2)


@pytest.mark.parametrize(("robot", "turn"), [("so100", np.pi / 2.0), ("ur5", 0.0), ("adept_3dof", 0.0)])
def test_a_base_turns_the_way_that_its_arm_reaches_to_the_payload(robot, turn):
    """The SO-100 reaches along -y of its base; arms that turn around stand with x ahead."""
    named = named_arms([robot] * 2, (), RobotFiles())
    left, right = searches(named, cp.Payload.box(1.0, (0.2, 0.2, 0.1)), "sides", "facing")
    assert_allclose(left.base(0.5, 0.2, None).rpy[2], turn, atol=1e-6)
    assert_allclose(np.cos(right.base(0.5, 0.2, None).rpy[2] - turn), -1.0, atol=1e-9)


def place_of(robots, side, distance=None):
    """The arms, and the first workspace of them around a box."""
    named = named_arms(robots, (), RobotFiles())
    payload = cp.Payload.box(1.0, (0.4, 0.3, 0.2))
    return named, next(common_places(searches(named, payload, side, "facing"), payload, distance))


def test_arms_that_hang_have_raised_bases_and_others_stand_on_the_ground():
    """The tips of an arm of TALOS just reach down to the ground, and joints stay above it."""
    named, workspace = place_of(["talos_arm", "panda"], "above")
    left, right = workspace.places
    model = ArmModel(named["left"].replace(base=left.base), name="left")
    tips = [model.tip_pose(q)[2, 3] for q in model.limits.random_configurations(200)]
    assert min(tips) == pytest.approx(0.0, abs=0.01)
    assert left.base.xyz[2] > 0.4
    assert right.base.xyz[2] == 0.0
    assert min(joint_heights(model, np.array(left.posture)).values()) >= -left.base.xyz[2]
    assert workspace.height > 0.15


def test_a_payload_is_looked_for_where_arms_on_columns_reach(tmp_path):
    """A column of 1.4 m in the file of the robot."""
    tree = ElementTree.ElementTree(ElementTree.fromstring(load_checked(find_urdf("ur5"))))
    ElementTree.SubElement(tree.getroot(), "link", name="column")
    joint = ElementTree.SubElement(tree.getroot(), "joint", name="mount", type="fixed")
    ElementTree.SubElement(joint, "parent", link="column")
    ElementTree.SubElement(joint, "child", link="world")
    ElementTree.SubElement(joint, "origin", xyz="0 0 1.4")
    tree.write(tmp_path / "high.urdf")
    named, workspace = place_of([tmp_path / "high.urdf"] * 2, "sides")
    assert workspace.height > 1.4 - maximum_reach(named["left"])
    assert [place.base.xyz[2] for place in workspace.places] == [0.0, 0.0]


def test_an_arm_that_nowhere_holds_itself_is_refused_by_its_drive(tmp_path):
    """A UR5 with a thousandth of its efforts: more than its weight asks of a thousand times as much."""
    text = load_checked(find_urdf("ur5"))
    weak = re.sub(r'effort="([0-9.]+)"', lambda found: f'effort="{float(found[1]) / 1000.0}"', text)
    (tmp_path / "weak.urdf").write_text(weak)
    with pytest.raises(InfeasibleMotionError) as caught:
        place_of([tmp_path / "weak.urdf"] * 2, "sides", 1.1)
    assert caught.value.cause == "torque"
    payload = cp.Payload.box(1.0, (0.4, 0.3, 0.2))
    strong, weak = (
        searches(named_arms([robot] * 2, (), RobotFiles()), payload, "sides", "facing")[0].own_weight()
        for robot in ("ur5", tmp_path / "weak.urdf")
    )
    assert weak[0] == pytest.approx(1000.0 * strong[0], rel=1e-6)
    assert weak[1] == strong[1]
    assert strong[0] < 0.01 < 1.0 < weak[0]


@pytest.mark.gate
def test_a_new_cell_says_which_bases_it_raised():
    suggestion = new_cell(["talos_arm"] * 2)
    height = suggestion.scenario.cell.arms["left"].base.xyz[2]
    assert any(f"left by {height:g} m, right by {height:g} m" in change for change in suggestion.changes)
    assert suggestion.findings().ok


BOX, BAR = cp.Payload.box(1.0, (0.4, 0.2, 0.1)), cp.Payload.box(1.0, (0.6, 0.1, 0.08))
DISC = cp.Payload(mass=1.0, inertia=(0.01, 0.01, 0.01, 0.0, 0.0, 0.0), shape="cylinder", size=(0.3, 0.3, 0.2))
S = np.sqrt(0.75)


@pytest.mark.parametrize(
    ("payload", "count", "side", "layout", "points", "approaches", "degrees"),
    [
        (BOX, 2, "sides", "facing", [(-0.2, 0, 0), (0.2, 0, 0)], [(1, 0, 0), (-1, 0, 0)], (180, 360)),
        (BOX, 2, "above", "facing", [(-0.16, 0, 0.05), (0.16, 0, 0.05)], [(0, 0, -1)] * 2, (180, 360)),
        (
            *(DISC, 3, "sides", "facing", [(-0.15, 0, 0), (0.075, -0.15 * S, 0), (0.075, 0.15 * S, 0)]),
            *([(1, 0, 0), (-0.5, S, 0), (-0.5, -S, 0)], (180, 300, 420)),
        ),
        (
            *(BOX, 3, "sides", "side-by-side", [(-0.2, 0, 0), (0, -0.1, 0), (0.2, 0, 0)]),
            *([(1, 0, 0), (0, 1, 0), (-1, 0, 0)], (-150, -90, -30)),
        ),
        (
            *(BOX, 2, "ahead", "side-by-side", [(-0.2, 0, 0), (0.2, 0, 0)]),
            *([(0.5, S, 0), (-0.5, S, 0)], (-120, -60)),
        ),
        (BOX, 2, "sides", "one-base", [(-0.2, 0, 0), (0.2, 0, 0)], [(1, 0, 0), (-1, 0, 0)], (-90, -90)),
        (
            *(BAR, 3, "sides", "facing", [(-0.3, 0, 0), (0, -0.05, 0), (0.3, 0, 0)]),
            *([(1, 0, 0), (0, 1, 0), (-1, 0, 0)], (-180, -90, 0)),
        ),
        (
            *(BAR, 4, "sides", "facing", [(-0.3, 0, 0), (-0.3 / np.sqrt(3.0), -0.05, 0)]),
            *([(1, 0, 0), (0.5, S, 0)], (-180, -120)),
        ),
    ],
)
def test_contacts_are_around_a_payload_or_along_its_side(
    payload, count, side, layout, points, approaches, degrees
):
    found = [*contacts(payload, count, side, layout)]
    assert len(found) == count
    for contact, point, approach, around in zip(found, points, approaches, degrees, strict=False):
        assert_allclose(contact.point, point, atol=1e-12)
        assert_allclose(contact.approach, approach, atol=1e-12)
        assert_allclose(np.degrees(contact.around), around, atol=1e-9)
        assert contact.one_base == (layout == "one-base")


@pytest.mark.parametrize("robot", ["adept_3dof", "ur5"])
def test_a_robot_stands_with_its_shoulders_before_the_payload(robot):
    """At a distance along their forward direction, to the payload; its lowest link on the ground."""
    named = named_arms([robot] * 2, (), RobotFiles())
    left, _ = searches(named, BOX, "sides", "facing")
    origin = Shoulders(np.array((0.1, -0.05, 0.9)), np.array((0.6, 0.8, 0.0)), -0.2)
    X_WB = left.base(0.5, 0.3, origin).matrix
    middle, forward = X_WB[:3, :3] @ origin.middle + X_WB[:3, 3], X_WB[:3, :3] @ origin.forward
    assert_allclose(middle[:2], (-0.5, 0.0), atol=1e-3)
    assert_allclose(forward, (1.0, 0.0, 0.0), atol=1e-5)
    assert X_WB[2, 3] == 0.2


def test_each_motion_is_calmer_than_that_before():
    """Half of the stroke in x and y, the lift in z; then without a turn, half and a quarter as far."""
    start = Pose(xyz=(0.0, 0.1, 0.3))
    lines = calmer_motions("line", start, 0.08, 0.05)
    goals = [motion["goal"] for name, motion in lines.items() if name != "at rest"]
    ways, lifts = np.array((0.04, 0.04, 0.02, 0.01)), (0.05, 0.05, 0.025, 0.0125)
    assert_allclose([goal.xyz for goal in goals], np.stack((ways, 0.1 + ways, 0.3 + np.array(lifts)), axis=1))
    assert [goal.rpy[2] for goal in goals] == [0.15, 0.0, 0.0, 0.0]
    circles = calmer_motions("circle", start, 0.08, 0.05)
    assert [motion.get("radius") for motion in circles.values()] == [0.02, 0.01, None]
    assert [*calmer_motions("hold", start, 0.08, 0.05)] == [*lines][-1:] == [*circles][-1:] == ["at rest"]


def test_a_tool_is_turned_by_quarters_about_its_approach():
    placement, _ = searches(named_arms(["ur5"] * 2, (), RobotFiles()), BOX, "sides", "facing")
    first, *others = (hold.grasp.matrix[:3, :3] for hold in placement.holds)
    turns = [log3(R @ first.T) / (np.pi / 2.0) for R in others]  # about x, along which the left arm reaches
    assert_allclose(np.abs(turns), [(1, 0, 0), (2, 0, 0), (1, 0, 0)], atol=1e-5)
    assert (turns[0][0], turns[2][0]) == pytest.approx((1.0, -1.0), abs=1e-5)
