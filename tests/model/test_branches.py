"""Branches of inverse kinematics: each solves, none is missing or double, within limits, nearest first."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from close import assert_close
from numpy.testing import assert_allclose, assert_array_equal

from coop_pin.base.errors import JointLimitError, ShapeError, UnreachablePoseError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, pose_error
from coop_pin.description.cell.arm import Arm
from coop_pin.description.urdf import find_urdf
from coop_pin.model import ArmModel, ik_branches
from coop_pin.model.ik_solver import IKSolver
from coop_pin.model.inverse_kinematics import solve_ik

LENGTHS = 0.425, 0.375
X_PE = make_pose((-0.12, 0.03, 0.05), (0.3, 1.2, -0.4))
FINGERS = {"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0}
ARMS = {
    "adept": (Arm(urdf="adept_3dof", tip="tip"), make_pose((-0.12, 0.0, 0.0))),
    "ur5": (Arm(urdf="ur5", tip="tool0", base=Pose(xyz=(0.1, 0.2, 0.3), rpy=(0.1, 0.2, 2.0))), X_PE),
    "kinova": (Arm(urdf="kinova", tip="j2s6s200_end_effector"), X_PE),
    "panda": (Arm(urdf="panda", tip="panda_hand", locked=FINGERS), X_PE),
    "xarm7": (Arm(urdf="xarm7", tip="link_eef"), X_PE),
}
REDUNDANT = ("panda", "xarm7")


@pytest.fixture(scope="module")
def models():
    return {name: ArmModel(*parts, name=name) for name, parts in ARMS.items()}


def poses_of(model, count):
    """Configurations within the limits, and the payload poses that they hold."""
    limits = model.limits
    spread = [limits.wrap_near(q, q) for q in limits.random_configurations(40 + count)[40:]]
    return [(q, model.payload_pose(q)) for q in spread]


def distance(model, q, near):
    return float(np.linalg.norm(pin.difference(model.model, q, near)))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("panda", "xarm7"))) for name in ARMS]
)
def test_every_branch_closes_within_the_limits_and_the_nearest_comes_first(models, name):
    model = models[name]
    limits = model.limits
    for q, X_WP in poses_of(model, 3):
        branches = ik_branches(model, X_WP, posture=q)
        for branch in branches:
            assert_close(pose_error(model.payload_pose(branch), X_WP), np.zeros(6), atol=1e-9)
            assert_array_equal(limits.violation(branch), np.zeros(model.nv))
        away = [distance(model, branch, q) for branch in branches]
        assert away == sorted(away)
        for one, other in itertools.combinations(branches, 2):
            assert distance(model, one, other) > 1e-3
        assert away[0] < 1e-6, "the configuration that made the pose is a branch itself"


@pytest.mark.parametrize("name", ARMS)
def test_the_angles_are_no_farther_from_the_posture_than_the_angles_that_made_the_pose(models, name):
    model = models[name]
    for q, X_WP in poses_of(model, 4):
        posture = pin.integrate(model.model, q, 0.3 * np.cos(np.arange(model.nv)))
        found = solve_ik(model, X_WP, posture=posture)
        assert_close(pose_error(model.payload_pose(found), X_WP), np.zeros(6), atol=1e-9)
        assert distance(model, found, posture) <= distance(model, q, posture) + 1e-9


def closed_form(X_WP):
    """Both elbows of the planar arm, in relative angles."""
    tip = X_WP @ ARMS["adept"][1]
    x, y = tip[:2, 3]
    l_1, l_2 = LENGTHS
    yaw = np.arctan2(tip[1, 0], tip[0, 0])
    branches = []
    for elbow in (1.0, -1.0):
        relative = elbow * np.arccos((x * x + y * y - l_1**2 - l_2**2) / (2.0 * l_1 * l_2))
        first = np.arctan2(y, x) - np.arctan2(l_2 * np.sin(relative), l_1 + l_2 * np.cos(relative))
        branches.append((first, relative, yaw - first - relative))
    return np.array(branches)


def test_the_planar_arm_has_the_two_branches_of_the_closed_form(models):
    for _, X_WP in poses_of(models["adept"], 5):
        found = ik_branches(models["adept"], X_WP)
        expected = closed_form(X_WP)
        assert len(found) == 2
        for branch in expected:
            assert min(np.abs(np.exp(1j * q) - np.exp(1j * branch)).max() for q in found) < 1e-8


def test_a_ur5_has_eight_branches_and_all_are_found(models):
    q = np.array((0.4, -1.1, 1.3, -0.9, 1.2, 0.5))
    for shift in (0.0, 0.1, -0.15):
        branches = ik_branches(models["ur5"], models["ur5"].payload_pose(q + shift), posture=q)
        assert len(branches) == 8
        signs = {(np.sign(np.sin(b[4])), np.sign(np.sin(b[2]))) for b in branches}
        assert len(signs) == 4, "each sign of elbow and wrist, once for each shoulder"


def test_a_posture_for_continuous_joints_is_angles_or_a_configuration(models):
    model = models["kinova"]
    assert model.nq > model.nv
    q, X_WP = poses_of(model, 1)[0]
    angles = model.joint_angles(q)
    assert_close(solve_ik(model, X_WP, posture=angles), solve_ik(model, X_WP, posture=q), atol=1e-9)
    with pytest.raises(ShapeError, match="posture of arm 'kinova'"):
        solve_ik(model, X_WP, posture=q[:-1])


def test_a_joint_of_several_turns_stays_on_the_turn_of_the_posture_while_its_limits_allow(models):
    model = models["ur5"]
    q = np.array((0.4, -1.1, 1.3, -0.9, 1.2, 0.5))
    X_WP = model.payload_pose(q)
    turned = q - np.array((0, 0, 0, 0, 0, 2 * np.pi))
    assert_close(solve_ik(model, X_WP, posture=turned), turned, atol=1e-8)
    beyond = q + np.array((4 * np.pi, 0, 0, 0, 0, 0))
    assert min(distance(model, branch, q) for branch in ik_branches(model, X_WP, posture=beyond)) < 1e-8


@pytest.mark.parametrize("name", REDUNDANT)
def test_a_redundant_arm_stands_as_near_to_its_posture_as_self_motion_and_limits_allow(models, name):
    """At the nearest point the step to the posture has no self-motion part, except at joint limits."""
    model = models[name]
    limits = model.limits
    q, X_WP = poses_of(model, 1)[0]
    posture = pin.integrate(model.model, q, 0.4 * np.sin(1.0 + np.arange(model.nv)))
    found = solve_ik(model, X_WP, posture=posture)
    self_motion = np.linalg.svd(model.payload_jacobian(found))[2][6]
    way = posture - found
    along = float(self_motion @ way)
    outward = limits.at_limit(found, np.sign(along) * self_motion)
    assert abs(along) < 1e-4 or outward.any()
    assert distance(model, found, posture) < distance(model, q, posture)


@pytest.mark.parametrize("name", REDUNDANT)
def test_angles_that_already_close_are_kept(models, name):
    q, X_WP = poses_of(models[name], 1)[0]
    assert_close(solve_ik(models[name], X_WP, posture=q), q, atol=1e-9)


def test_without_a_posture_a_panda_is_within_the_limits_though_zero_is_not(models):
    model = models["panda"]
    for _, X_WP in poses_of(model, 3):
        q = solve_ik(model, X_WP)
        assert np.all(q >= model.model.lowerPositionLimit)
        assert np.all(q <= model.model.upperPositionLimit)


def test_the_same_question_gets_the_same_bits(models):
    _, X_WP = poses_of(models["xarm7"], 1)[0]
    first, second = (ik_branches(models["xarm7"], X_WP) for _ in range(2))
    assert all(np.array_equal(one, other) for one, other in zip(first, second, strict=True))


# ---------------------------------------------------------------- limits


@pytest.fixture
def narrow(tmp_path):
    """The planar arm with other limits of its elbow."""

    def build(lower, upper):
        text = find_urdf("adept_3dof").path.read_text()
        head, elbow = text.split('<joint name="joint_2"')
        elbow = elbow.replace(
            'lower="-6.283185307179586" upper="6.283185307179586"', f'lower="{lower}" upper="{upper}"', 1
        )
        path = tmp_path / "narrow.urdf"
        path.write_text(head + '<joint name="joint_2"' + elbow)
        return ArmModel(Arm(urdf=str(path), tip="tip"), name="left")

    return build


AWAY = 0.6
ELBOW = np.arccos((AWAY**2 - LENGTHS[0] ** 2 - LENGTHS[1] ** 2) / (2.0 * LENGTHS[0] * LENGTHS[1]))


@pytest.mark.parametrize(("lower", "upper", "sign"), [(0.1, 3.0, 1.0), (-3.0, -0.1, -1.0), (ELBOW, 3.0, 1.0)])
def test_a_branch_beyond_the_limits_is_no_solution_however_near(narrow, lower, upper, sign):
    branches = ik_branches(
        narrow(lower, upper), make_pose((AWAY, 0.0, 0.0)), posture=(0.5, -sign * ELBOW, 0.0)
    )
    assert len(branches) == 1
    assert_close(branches[0][1], sign * ELBOW, atol=1e-7)


def test_limits_a_whole_turn_away_are_reached_by_unwinding(narrow):
    branches = ik_branches(narrow(4.0, 9.0), make_pose((AWAY, 0.0, 0.0)))
    elbows = sorted(float(q[1]) for q in branches)
    assert_close(elbows, (2 * np.pi - ELBOW, 2 * np.pi + ELBOW), atol=1e-7)


def test_where_only_a_limit_prevents_it_the_joint_is_named_with_the_gap_that_it_leaves(narrow):
    """The law of cosines at the limit of the elbow is the oracle; the wrist makes up the angle."""
    with pytest.raises(JointLimitError) as caught:
        solve_ik(narrow(-0.2, 0.3), make_pose((AWAY, 0.0, 0.0)))
    error = caught.value
    l_1, l_2 = LENGTHS
    assert (error.arm, error.joint, error.lower, error.upper) == ("left", "joint_2", -0.2, 0.3)
    assert error.value == pytest.approx(ELBOW, abs=1e-7)
    assert_allclose(error.distance, np.sqrt(l_1**2 + l_2**2 + 2 * l_1 * l_2 * np.cos(0.3)) - AWAY, rtol=1e-4)
    assert error.angle < 1e-3
    assert "joint_2" in str(error)


def test_out_of_reach_no_joint_is_blamed(narrow):
    with pytest.raises(UnreachablePoseError) as caught:
        ik_branches(narrow(-0.2, 0.3), make_pose((1.1, 0.0, 0.0)))
    assert not isinstance(caught.value, JointLimitError)
    assert_allclose(caught.value.distance, 0.3, rtol=1e-4)


@pytest.mark.parametrize("name", ["ur5", pytest.param("panda", marks=pytest.mark.slow)])
def test_the_gap_of_a_spatial_arm_is_the_least_distance_first_and_then_the_least_angle(models, name):
    """No angles found by brute force come nearer to the grasp than the gap says."""
    model = models[name]
    X_WP = make_pose((2.0, 0.5, 0.4), (0.2, 0.1, 0.3))
    grasp = X_WP @ X_PE
    with pytest.raises(UnreachablePoseError) as caught:
        solve_ik(model, X_WP)
    tried = [
        np.linalg.norm(model.tip_pose(q)[:3, 3] - grasp[:3, 3])
        for q in model.limits.random_configurations(3000)
    ]
    assert min(tried) >= caught.value.distance
    solver = IKSolver(model)
    for start in solver.limits.random_configurations(20):
        solution = solver.solve(solver.tip_target(X_WP), start, angle_weight=1e-4)
        assert solution.distance >= caught.value.distance - 2e-5
        assert solution.distance > caught.value.distance + 1e-5 or solution.angle >= caught.value.angle - 1e-2


def test_unwinding_finds_the_turn_that_a_search_over_all_turns_finds(models):
    limits = models["ur5"].limits
    generator = np.random.default_rng(5)
    for _ in range(50):
        q, near = generator.uniform(-15.0, 15.0, 6), generator.uniform(-6.0, 6.0, 6)
        wrapped = limits.wrap_near(q, near)
        for joint in range(6):
            turns = q[joint] + 2 * np.pi * np.arange(-5, 6)
            inside = turns[(turns >= limits.lower[joint]) & (turns <= limits.upper[joint])]
            nearest = inside[np.argmin(np.abs(inside - near[joint]))]
            assert_close(wrapped[joint], nearest, atol=1e-9)


SLIDER = """<robot name="slider">
  <link name="base"/><link name="carriage"/><link name="arm"/><link name="hand"/>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="-5" upper="15" effort="100" velocity="1"/></joint>
  <joint name="turn" type="continuous"><parent link="carriage"/><child link="arm"/><axis xyz="0 0 1"/></joint>
  <joint name="reach" type="revolute"><parent link="arm"/><child link="hand"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="100" velocity="1"/></joint>
  {links}
</robot>"""
LINK = (
    '<link name="{}"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def test_a_slide_has_no_whole_turns(tmp_path):
    """Ten metres are not ten metres less two pi; both angles of the continuous joint are found."""
    path = tmp_path / "slider.urdf"
    text = SLIDER.format(links="").replace('<link name="carriage"/><link name="arm"/><link name="hand"/>', "")
    path.write_text(
        text.replace(
            '<link name="base"/>',
            '<link name="base"/>' + "".join(map(LINK.format, ("carriage", "arm", "hand"))),
        )
    )
    model = ArmModel(Arm(urdf=str(path), tip="hand"))
    branches = ik_branches(model, make_pose((10.0, 0.3, 0.0), (0.0, 0.0, 0.9)), posture=(9.0, 0.0, 0.0))
    angle = np.arcsin(0.6)
    found = [(q[0], np.arctan2(q[2], q[1]), q[3]) for q in branches]
    assert_close(found[0], (9.6, angle, 0.9 - angle), atol=1e-8)
    assert_close(found[1], (10.4, np.pi - angle, 0.9 - np.pi + angle), atol=1e-8)
    assert len(found) == 2


def test_a_path_out_of_reach_is_followed_beyond_the_joint_limits(narrow):
    """The nearest configuration is the stretched arm, which the limit of the elbow forbids."""
    model = narrow(0.5, 3.0)
    distances = np.linspace(AWAY, 1.0, 21)
    q = solve_ik(model, make_pose((AWAY, 0.0, 0.0)))
    found = IKSolver(model).follow([make_pose((x, 0.0, 0.0)) for x in distances], q, q)
    assert_close(
        [solution.distance for solution in found], np.maximum(distances - sum(LENGTHS), 0.0), atol=1e-5
    )
    assert abs(found[-1].q[1]) < 0.01


def test_a_path_is_followed_through_the_joint_limits(narrow):
    model = narrow(0.5, ELBOW + 0.05)
    distances = np.linspace(AWAY, 0.4, 21)
    q = solve_ik(model, make_pose((AWAY, 0.0, 0.0)))
    found = IKSolver(model).follow([make_pose((x, 0.0, 0.0)) for x in distances], q, q)
    assert_close([solution.distance for solution in found], np.zeros(21), atol=1e-9)
    l_1, l_2 = LENGTHS
    expected = np.arccos((distances**2 - l_1**2 - l_2**2) / (2.0 * l_1 * l_2))
    assert_close([solution.q[1] for solution in found], expected, atol=1e-7)
