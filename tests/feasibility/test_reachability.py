"""Reachability, singularities, limits and speeds along the reference, against closed forms and runs."""

import math

import numpy as np
import pytest
from cells import SPATIAL_START, planar_scenario, spatial_scenario
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, JointLimitError, UnreachablePoseError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, pose_error
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.controller import UserController
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf
from coop_pin.feasibility import reachability
from coop_pin.feasibility.path_following import payload_path
from coop_pin.model import ArmModel
from coop_pin.reference.lines import LineMotion
from coop_pin.reference.motions import CircleMotion, HoldMotion, TurnMotion
from coop_pin.reference.pose_reference import FunctionMotion
from coop_pin.reference.quintic import quintic

L_1, L_2 = 0.425, 0.375
ANY_CONTROLLER = UserController(target="nowhere:Nothing")
FINGERS = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}


def one_arm(arm, motion, start, rows="full", duration=2.0):
    """A scenario of a single arm that holds the payload at its tip."""
    cell = Cell(
        arms={"only": arm}, payload=Payload.box(1.0, (0.1, 0.1, 0.1)), grasps={"only": Pose()}, rows=rows
    )
    return Scenario(
        name="one", cell=cell, controller=ANY_CONTROLLER, motion=motion, start=start, duration=duration
    )


def planar_arm(motion, start, posture=(0.3, 0.9, 0.0), duration=2.0):
    arm = Arm(urdf="adept_3dof", tip="tip", posture=posture)
    return one_arm(arm, motion, start, rows="planar", duration=duration)


def held(report, name, scenario):
    """How far the payload is off the pose that the arm should hold, at every pose of the reference."""
    arm, reference = next(arm for arm in report.arms if arm.arm == name), scenario.motion
    model = ArmModel(scenario.cell.arms[name], scenario.cell.grasps[name].matrix)
    walked = zip(arm.times[-report.poses :], arm.q[-report.poses :], strict=True)
    return np.array(
        [pose_error(model.payload_pose(q), np.array(reference.at(float(time)).X_WP_d)) for time, q in walked]
    )


# ---------------------------------------------------------------- the paper's cell


@pytest.fixture(scope="module")
def paper():
    return reachability(planar_scenario())


def paper_singular_values(time, arm, grasp, elbow):
    """Singular values of J in drive coordinates (q1, q2 absolute), from the law of cosines."""
    x_d = 0.4 - 0.2 * math.exp(-time / 6.6) + 0.5 * math.exp(-time / 6.8)
    psi = math.pi / 3
    offset = grasp * np.array((math.cos(psi), math.sin(psi)))
    x, y = np.array((x_d, x_d / math.sqrt(3.0) - 0.2)) + offset - np.array(arm)
    relative = elbow * math.acos((x * x + y * y - L_1**2 - L_2**2) / (2 * L_1 * L_2))
    q_1 = math.atan2(y, x) - math.atan2(L_2 * math.sin(relative), L_1 + L_2 * math.cos(relative))
    q_2 = q_1 + relative
    J = np.array(
        [
            [-L_1 * math.sin(q_1), -L_2 * math.sin(q_2) + offset[1], offset[1]],
            [L_1 * math.cos(q_1), L_2 * math.cos(q_2) - offset[0], -offset[0]],
            [0.0, 1.0, 1.0],
        ]
    )
    return np.linalg.svd(J, compute_uv=False)


@pytest.mark.parametrize(
    ("index", "base", "grasp", "elbow"), [(0, (0.0, 0.0), -0.12, -1.0), (1, (1.0, 0.0), 0.12, 1.0)]
)
def test_singular_values_along_the_papers_reference_are_those_of_the_closed_form(
    paper, index, base, grasp, elbow
):
    arm = paper.arms[index]
    expected = np.array(
        [paper_singular_values(time, base, grasp, elbow) for time in np.linspace(0.0, 20.0, 401)]
    )
    assert_allclose(arm.sigma_min[-401:], expected[:, -1], rtol=1e-9)
    assert_allclose(arm.condition[-401:], expected[:, 0] / expected[:, -1], rtol=1e-9)
    assert arm.nearest_singularity.sigma_min == pytest.approx(arm.sigma_min.min())
    assert arm.nearest_singularity.sigma_min > 0.19


def test_the_papers_arms_follow_within_all_limits(paper):
    assert paper.ok
    for arm in paper.arms:
        assert arm.ok
        assert (arm.start_error, arm.unreachable, arm.limit_violation) == (None, None, None)
        assert arm.smallest_margin.margin > 3.0
        assert arm.fastest_joint.speed < 0.2
        assert_allclose(held(paper, arm.arm, planar_scenario()), 0.0, atol=1e-9)
    for part in ("adept-paper", "401 poses", "left: ok", "sigma_min 0.195, condition 7.31 at t = 20 s"):
        assert part in paper.summary()


def test_the_way_from_the_start_to_the_reference_comes_first(paper):
    start = planar_scenario().start.matrix
    arm = paper.arms[0]
    model = ArmModel(planar_scenario().cell.arms["left"], planar_scenario().cell.grasps["left"].matrix)
    assert_allclose(pose_error(model.payload_pose(arm.q[0]), start), np.zeros(6), atol=1e-9)
    assert len(arm.times) == 401 + 20
    assert np.all(arm.times[:21] == 0.0)
    assert np.abs(np.diff(arm.q, axis=0)).max() < 0.1


def test_arrays_are_read_only(paper):
    assert not any(
        array.flags.writeable for array in (paper.arms[0].q, paper.arms[0].times, paper.arms[0].sigma_min)
    )


# ---------------------------------------------------------------- leaving the reach


def test_a_line_that_leaves_the_reach_is_reported_with_the_arm_the_moment_and_the_gap():
    """Along the x axis through the base, reach ends at l_1 + l_2; the quintic says when."""
    motion = LineMotion(start=Pose(xyz=(0.5, 0, 0)), goal=Pose(xyz=(1.2, 0, 0)), duration=2.0)
    scenario = planar_arm(motion, Pose(xyz=(0.5, 0, 0)))
    report = reachability(scenario)
    times = np.linspace(0.0, 2.0, 200001)
    at_edge = times[np.argmax([0.5 + 0.7 * quintic(t, 0.0, 2.0).value >= L_1 + L_2 for t in times])]
    loss = report.arms[0].unreachable
    assert not report.ok
    assert loss.time == pytest.approx(at_edge, abs=1e-4)
    assert (loss.gap_time, loss.other_branch) == (2.0, False)
    assert loss.gap_m == pytest.approx(1.2 - L_1 - L_2, rel=1e-4)
    assert loss.gap_rad < 1e-3
    for part in ("only: not ok", f"from t = {loss.time:.4g} s", "at t = 2 s", "0.4 m"):
        assert part in report.summary()


def test_an_arm_that_comes_back_into_reach_is_followed_again():
    motion = FunctionMotion(target=out_and_back)
    report = reachability(planar_arm(motion, Pose(xyz=(0.6, 0, 0)), duration=2.0))
    arm = report.arms[0]
    assert arm.unreachable.gap_m == pytest.approx(0.1, rel=1e-3)
    assert arm.unreachable.gap_time == pytest.approx(1.0)
    errors = held(report, "only", planar_arm(motion, Pose(xyz=(0.6, 0, 0))))
    assert_allclose(errors[-50:], 0.0, atol=1e-9)


def out_and_back(time):
    X = np.eye(4)
    X[0, 3] = 0.75 - 0.15 * math.cos(math.pi * time)
    return X


def test_of_two_arms_only_the_one_that_cannot_follow_is_blamed():
    goal = Pose(xyz=(0.3, 0.05, 0.4), rpy=SPATIAL_START.rpy)
    scenario = spatial_scenario().replace(
        motion=LineMotion(start=SPATIAL_START, goal=goal, duration=3.0), duration=3.0
    )
    cell = scenario.cell
    far = cell.arms["right"].replace(base=Pose(xyz=(1.27, 0.1, 0.05), rpy=(0, 0, 3.0)))
    report = reachability(
        scenario.replace(cell=cell.replace(arms={"left": cell.arms["left"], "right": far})), poses=101
    )
    assert report.arms[0].unreachable is None
    assert 0.0 < report.arms[1].unreachable.time < 3.0
    assert report.arms[1].unreachable.gap_m + report.arms[1].unreachable.gap_rad > 1e-3
    assert "right: not ok" in report.summary()


def test_a_start_out_of_reach_is_reported_not_raised():
    report = reachability(planar_arm(HoldMotion(pose=Pose(xyz=(0.9, 0, 0))), Pose(xyz=(0.9, 0, 0))))
    arm = report.arms[0]
    assert not report.ok
    assert isinstance(arm.start_error, UnreachablePoseError)
    assert arm.start_error.distance == pytest.approx(0.1, rel=1e-3)
    assert (arm.unreachable, arm.nearest_singularity, arm.fastest_joint, len(arm.times)) == (
        None,
        None,
        None,
        0,
    )
    assert str(arm.start_error) in report.summary()


# ---------------------------------------------------------------- limits


TURNING = TurnMotion(pose=Pose(xyz=(0.5, 0, 0)), axis=(0, 0, 1), angle=9.0, duration=2.0)


def test_the_first_limit_that_is_met_is_reported_with_its_joint_and_its_moment():
    """The payload turns about the wrist: joint 3 alone moves, and the quintic says when it is at 2 pi."""
    scenario = planar_arm(TURNING, TURNING.pose)
    report = reachability(scenario)
    arm = report.arms[0]
    first = float(arm.q[0][2])
    times = np.linspace(0.0, 2.0, 200001)
    expected = times[np.argmax([first + 9.0 * quintic(t, 0.0, 2.0).value >= 2 * math.pi for t in times])]
    assert not report.ok
    assert arm.unreachable is None
    assert arm.limit_violation.joint == "joint_3"
    assert arm.limit_violation.time == pytest.approx(expected, abs=1e-3)
    assert arm.limit_violation.value == pytest.approx(2 * math.pi)
    assert arm.smallest_margin.joint == "joint_3"
    assert arm.smallest_margin.margin == pytest.approx(2 * math.pi - first - 9.0)
    for part in ("joint_3", "-6.283 to 6.283 rad", f"t = {arm.limit_violation.time:.4g} s"):
        assert part in report.summary()


def test_the_largest_speed_is_that_of_the_quintic_in_its_middle():
    report = reachability(planar_arm(TURNING, TURNING.pose))
    fastest = report.arms[0].fastest_joint
    assert (fastest.joint, fastest.time, fastest.unit) == ("joint_3", 1.0, "rad/s")
    assert fastest.speed == pytest.approx(9.0 * 1.875 / 2.0)
    assert fastest.limit == 20.0


def test_a_joint_that_must_move_too_fast_is_reported():
    quick = TURNING.replace(duration=0.5)
    arm = reachability(planar_arm(quick, quick.pose, duration=0.5)).arms[0]
    assert arm.fastest_joint.speed == pytest.approx(9.0 * 1.875 / 0.5)
    speed = f"{arm.fastest_joint.speed:.3g} rad/s"  # 33.75 but for rounding
    assert any("joint_3" in problem and speed in problem for problem in arm.problems())


def test_a_start_that_only_a_limit_forbids_names_the_joint(tmp_path):
    head, elbow = find_urdf("adept_3dof").path.read_text().split('<joint name="joint_2"')
    elbow = elbow.replace(
        'lower="-6.283185307179586" upper="6.283185307179586"', 'lower="-0.2" upper="0.3"', 1
    )
    (tmp_path / "narrow.urdf").write_text(head + '<joint name="joint_2"' + elbow)
    start = Pose(xyz=(0.6, 0, 0))
    arm = Arm(urdf=str(tmp_path / "narrow.urdf"), tip="tip")
    report = reachability(one_arm(arm, HoldMotion(pose=start), start, rows="planar"))
    assert isinstance(report.arms[0].start_error, JointLimitError)
    assert report.arms[0].start_error.joint == "joint_2"
    assert "'joint_2'" in report.summary()


# ---------------------------------------------------------------- space


def test_a_spatial_pair_follows_a_circle_and_holds_every_pose():
    motion = CircleMotion(pose=SPATIAL_START, radius=0.08, angular_rate=1.0, normal=(0.0, 1.0, 0.3))
    scenario = spatial_scenario().replace(motion=motion, duration=6.0)
    report = reachability(scenario, poses=151)
    assert report.ok
    for arm in report.arms:
        assert_allclose(held(report, arm.arm, scenario), 0.0, atol=1e-9)
        assert np.abs(np.diff(arm.q, axis=0)).max() < 0.2
        rates = np.diff(arm.q[-151:], axis=0) / (6.0 / 150.0)
        assert arm.fastest_joint.speed <= 1.02 * np.abs(rates).max()
        assert (
            arm.fastest_joint.speed
            >= 0.9 * np.abs(rates / np.array((3.15, 3.15, 3.15, 3.2, 3.2, 3.2))).max() * 3.15
        )


@pytest.mark.parametrize("build", [planar_scenario, spatial_scenario])
def test_the_condition_number_at_the_start_is_the_one_that_a_run_records(build):
    scenario = build().replace(duration=0.02, events=())
    recorded = cp.run(scenario).data.jacobian_condition.values[0]
    report = reachability(scenario, poses=2)
    assert_allclose([arm.condition[0] for arm in report.arms], recorded, rtol=1e-6)


WRIST = np.array((0.4, -1.1, 1.3, -0.9, 0.0, 0.5))


def through_the_wrist(time):
    """The pose of a UR5 whose wrist joint goes through zero, where it is singular."""
    q = WRIST.copy()
    q[4] = 0.3 - 0.6 * time
    return ArmModel(Arm(urdf="ur5", tip="tool0")).payload_pose(q)


def test_a_path_through_a_singular_pose_is_found_though_no_sample_stands_on_it():
    arm = Arm(urdf="ur5", tip="tool0", posture=tuple(WRIST + np.array((0, 0, 0, 0, 0.3, 0))))
    scenario = one_arm(
        arm, FunctionMotion(target=through_the_wrist), Pose.from_matrix(through_the_wrist(0.0)), duration=1.0
    )
    report = reachability(scenario, poses=50)
    only = report.arms[0]
    assert not report.ok
    assert only.nearest_singularity.sigma_min == 0.0
    assert only.nearest_singularity.time == pytest.approx(0.5, abs=0.02)
    assert "singular at t = 0.5" in report.summary()


@pytest.mark.parametrize("kind", ["xarm7", "panda"])
def test_redundant_arms_follow_and_stay_near_their_posture(kind):
    """On a closed path a redundant arm ends where it began: it is drawn to its posture and does not drift."""
    arms = {
        "xarm7": Arm(urdf="xarm7", tip="link_eef", posture=(0.1, -0.3, 0.2, 1.2, 0.1, 1.0, 0.0)),
        "panda": Arm(
            urdf="panda", tip="panda_hand", locked=FINGERS, posture=(0.1, -0.2, 0.1, -2.0, 0.1, 1.9, 0.6)
        ),
    }
    model = ArmModel(arms[kind])
    start = Pose.from_matrix(model.payload_pose(arms[kind].posture))
    motion = CircleMotion(
        pose=start, radius=0.1, angular_rate=2 * math.pi / 4.0, ramp=1.0, normal=(0, 1, 0), start_time=0.0
    )
    scenario = one_arm(arms[kind], motion, start, duration=4.5)
    report = reachability(scenario, poses=181)
    arm = report.arms[0]
    assert report.ok
    assert_allclose(held(report, "only", scenario), 0.0, atol=1e-9)
    assert_allclose(arm.q[0], arms[kind].posture, atol=1e-7)
    assert_allclose(arm.q[-1], arm.q[0], atol=2e-3)


KINOVA = Arm(urdf="kinova", tip="j2s6s200_end_effector", posture=(0.3, 2.6, 1.8, 0.4, 2.0, 0.7))


def spinning(time):
    """The pose of a Kinova whose last joint, a continuous one, turns on and on."""
    model = ArmModel(KINOVA)
    return model.payload_pose(
        model.configuration(np.array(KINOVA.posture) + np.array((0, 0, 0, 0, 0, 2.0 * time)))
    )


def test_continuous_joints_turn_on_and_on_without_limits():
    scenario = one_arm(KINOVA, FunctionMotion(target=spinning), Pose.from_matrix(spinning(0.0)), duration=4.0)
    report = reachability(scenario, poses=81)
    arm, model = report.arms[0], ArmModel(KINOVA)
    assert (arm.unreachable, arm.limit_violation) == (None, None)
    assert arm.q.shape == (101, 9)
    assert_allclose(held(report, "only", scenario), 0.0, atol=1e-9)
    angles = np.unwrap([model.joint_angles(q)[5] for q in arm.q])
    assert_allclose(angles[-81:] - angles[0], 2.0 * arm.times[-81:], atol=1e-7)
    assert arm.fastest_joint.joint == "j2s6s200_joint_6"
    assert arm.fastest_joint.speed == pytest.approx(2.0, rel=1e-6)


def test_fewer_than_two_poses_are_refused():
    with pytest.raises(ArgumentError, match="poses is 1"):
        reachability(planar_scenario(), poses=1)


def test_the_path_leads_straight_from_the_start_to_the_first_pose_of_the_reference():
    motion = LineMotion(start=Pose(xyz=(1.0, 0.2, 0.0)), goal=Pose(xyz=(3.0, 0.2, 0.0)), duration=2.0)
    path = payload_path(planar_arm(motion, Pose(xyz=(0.0, 0.2, 0.0), rpy=(0, 0, 0.4)), duration=2.0), 3)
    assert_close(
        path.poses[:, 0, 3], [*np.arange(20) / 20.0, 1.0, 2.0, 3.0], atol=1e-2
    )  # the geodesic is a screw
    assert_close(path.poses[:, 1, 0], np.sin([*np.linspace(0.4, 0.0, 21)[:20], 0.0, 0.0, 0.0]), atol=1e-12)
    assert_close(path.poses[0], make_pose((0.0, 0.2, 0.0), (0, 0, 0.4)), atol=1e-12)
    assert_close(path.times, [0.0] * 20 + [0.0, 1.0, 2.0], atol=1e-12)
    assert_close(path.twists[:, 0], [0.0] * 20 + [0.0, 15.0 / 8.0, 0.0], atol=1e-12)
