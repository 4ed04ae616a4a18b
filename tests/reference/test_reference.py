"""Laws of the references: every twist is the rate of its pose, every acceleration the rate of its twist."""

from __future__ import annotations

import math
import pickle
import re

import numpy as np
import pytest
from close import assert_close
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from coop_pin.base.errors import (
    AmbiguousTurnError,
    FieldError,
    FileReadError,
    OutOfRangeError,
    ScenarioError,
    ShapeError,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, make_pose, pose_error, rpy_from_rotation, shift_wrench
from coop_pin.reference.csv_motion import CsvMotion
from coop_pin.reference.lines import LineMotion
from coop_pin.reference.motions import CircleMotion, ExponentialMotion, HoldMotion, SwingMotion, TurnMotion
from coop_pin.reference.pose_reference import (
    FunctionMotion,
    PoseReference,
    PoseTarget,
    check_consistency,
    pose_rates,
)
from coop_pin.reference.splines import PoseSpline, Waypoint, WaypointsMotion
from coop_pin.reference.squeeze import (
    ConstantSqueeze,
    FunctionSqueeze,
    RampSqueeze,
    TipForceSqueeze,
    TipWrenchSqueeze,
)

ROOT_3 = math.sqrt(3.0)
START, GOAL_POSE = (
    Pose(xyz=(0.3, -0.2, 0.7), rpy=(0.4, -0.9, 2.0)),
    Pose(xyz=(0.1, 0.4, 0.9), rpy=(-0.5, 0.3, -2.4)),
)
POSE, GOAL = START.matrix, GOAL_POSE.matrix
AXIS = (1.0, -2.0, 0.5)
WAYPOINT_TIMES = (0.5, 1.7, 2.1, 3.5)
WAYPOINT_POSES = (
    START,
    GOAL_POSE,
    Pose(xyz=(0, 0, 0.5), rpy=(1, 1, 1)),
    Pose(xyz=(0.2, 0, 0.5), rpy=(-1, 0.2, 3)),
)
TABLE = "time,x,y,z,roll,pitch,yaw\n0,0,0,1,0,0,3.0\n\n1,0.1,0,1,0.1,0.2,-3.0\n2.5,0.2,0.1,1,0,0,-2\n"
QUATERNIONS = Rotation.from_euler("xyz", ((0, 0, 3.0), (0.3, 0.2, -3.0), (0.5, 0.5, -2.0))).as_quat()


def waypoints(times=WAYPOINT_TIMES, poses=WAYPOINT_POSES) -> WaypointsMotion:
    points = [Waypoint(time=t, xyz=X.xyz, rpy=X.rpy) for t, X in zip(times, poses, strict=True)]
    return WaypointsMotion(points=points)


def paper() -> ExponentialMotion:
    return ExponentialMotion(
        constant=(0.4, 0.4 / ROOT_3 - 0.2, 0.0),
        amplitudes=((-0.2, -0.2 / ROOT_3, 0.0), (0.5, 0.5 / ROOT_3, 0.0)),
        time_constants=(6.6, 6.8),
        rpy=(0, 0, math.pi / 3),
    )


def circle(centre, radius, rate, ramp, normal, start_angle=0.0, **fields) -> CircleMotion:
    """A circle about a centre; the normal is not the x axis."""
    n = np.array(normal) / np.linalg.norm(normal)
    e_1 = np.array((1.0, 0.0, 0.0)) - n[0] * n
    e_1 /= np.linalg.norm(e_1)
    begin = centre + radius * (math.cos(start_angle) * e_1 + math.sin(start_angle) * np.cross(n, e_1))
    pose = Pose(xyz=begin, rpy=(0.3, 0.2, 0.1))
    return CircleMotion(
        pose=pose,
        radius=radius,
        angular_rate=rate,
        ramp=ramp,
        normal=normal,
        start_angle=start_angle,
        **fields,
    )


def spline(scale=(1.0, 1.0, 1.0)) -> PoseSpline:
    positions = np.array(((0, 0, 1), (0.2, 0.1, 1), (0.3, 0.4, 1.2)))
    return PoseSpline.through(np.array((1.0, 2.0, 3.0)), positions, QUATERNIONS * np.array(scale)[:, None])


TURN = TurnMotion(pose=START, axis=AXIS, angle=1.0, duration=1.0)


def spun(time: float) -> np.ndarray:
    return TURN.at(0.5 + 0.2 * math.sin(time)).X_WP_d


# every kind, with the times between which its formula changes
KINDS: dict[str, tuple[PoseReference, tuple[float, ...]]] = {
    "hold": (HoldMotion(pose=START), ()),
    "exponentials": (paper(), ()),
    "line": (LineMotion(start=START, goal=GOAL_POSE, duration=1.5, start_time=0.5), (0.5, 2.0)),
    "line_without_turn": (
        LineMotion(start=START, goal=START.replace(xyz=(0.3, -0.2, 1.0)), duration=1.5),
        (0.0, 1.5),
    ),
    "circle": (circle((0.1, 0.2, 0.3), 0.3, -2.0, 1.2, (1, 2, -1), 0.4, start_time=0.5), (0.5, 1.7)),
    "circle_about_x": (
        CircleMotion(pose=START, radius=0.3, angular_rate=1.0, normal=(2.0, 0, 0)),
        (0.0, 1.0),
    ),
    "turn": (TurnMotion(pose=START, axis=AXIS, angle=9.0, duration=2.0, start_time=0.5), (0.5, 2.5)),
    "turn about a point": (
        TurnMotion(pose=START, axis=AXIS, angle=2.0, duration=2.0, centre=(0.3, -0.2, 0.1)),
        (0.0, 2.0),
    ),
    "swing": (
        SwingMotion(pose=START, axis=AXIS, amplitude=0.7, period=1.3, ramp=1.0, start_time=0.5),
        (0.5, 1.5),
    ),
    "waypoints": (waypoints(), WAYPOINT_TIMES),
    "function": (FunctionMotion(target=spun), ()),
}
FROM_REST = ("line", "line_without_turn", "circle", "circle_about_x", "turn", "swing", "waypoints")
TO_REST = ("line", "line_without_turn", "turn", "waypoints")
every_kind = pytest.mark.parametrize("kind", KINDS)


def rate_of_pose(reference: PoseReference, time: float, step: float) -> np.ndarray:
    before, after = reference.at(time - step).X_WP_d, reference.at(time + step).X_WP_d
    return pose_error(after, before) / (2 * step)


def rate_of_twist(reference: PoseReference, time: float, step: float) -> np.ndarray:
    return (reference.at(time + step).V_WP_d - reference.at(time - step).V_WP_d) / (2 * step)


# ---------------------------------------------------------------- laws of every kind


@every_kind
def test_twist_is_the_rate_of_the_pose(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in (*np.linspace(-0.3, 4.1, 89), *joints):
        assert_allclose(
            reference.at(time).V_WP_d, rate_of_pose(reference, time, 1e-4), atol=5e-6, err_msg=f"t = {time}"
        )


@every_kind
def test_acceleration_is_the_rate_of_the_twist(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in np.linspace(-0.3, 4.1, 89):
        near_joint = any(abs(time - joint) < 1e-3 for joint in joints)
        step, atol = (1e-6, 2e-4) if near_joint else (1e-4, 2e-5)
        assert_allclose(
            reference.at(time).A_WP_d, rate_of_twist(reference, time, step), atol=atol, err_msg=f"t = {time}"
        )


@every_kind
def test_acceleration_is_the_rate_of_the_twist_where_segments_meet(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in joints:
        assert_allclose(
            reference.at(time).A_WP_d, rate_of_twist(reference, time, 1e-6), atol=2e-4, err_msg=f"t = {time}"
        )


@every_kind
def test_pose_twist_and_acceleration_are_continuous_where_segments_meet(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in joints:
        for before, at, after in zip(
            reference.at(time - 1e-9), reference.at(time), reference.at(time + 1e-9), strict=True
        ):
            assert_allclose(before, at, atol=1e-6)
            assert_allclose(after, at, atol=1e-6)


@every_kind
def test_every_pose_is_a_pose(kind: str) -> None:
    for time in np.linspace(-1.0, 5.0, 41):
        X = KINDS[kind][0].at(time).X_WP_d
        assert_allclose(X[:3, :3].T @ X[:3, :3], np.eye(3), atol=1e-14)
        assert_allclose(np.linalg.det(X[:3, :3]), 1.0, atol=1e-14)
        assert_array_equal(X[3], (0, 0, 0, 1))


@pytest.mark.parametrize("kind", FROM_REST)
def test_starts_at_rest(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in (joints[0] - 1.0, joints[0]):
        assert_array_equal(reference.at(time).V_WP_d, np.zeros(6))
        assert_array_equal(reference.at(time).A_WP_d, np.zeros(6))
    assert_array_equal(reference.at(joints[0] - 1.0).X_WP_d, reference.at(joints[0]).X_WP_d)


@pytest.mark.parametrize("kind", TO_REST)
def test_ends_at_rest(kind: str) -> None:
    reference, joints = KINDS[kind]
    for time in (joints[-1], joints[-1] + 1.0):
        assert_array_equal(reference.at(time).V_WP_d, np.zeros(6))
        assert_array_equal(reference.at(time).A_WP_d, np.zeros(6))
    assert_array_equal(reference.at(joints[-1] + 1.0).X_WP_d, reference.at(joints[-1]).X_WP_d)


@every_kind
def test_values_are_immutable(kind: str) -> None:
    reference = KINDS[kind][0]
    for time in (-1.0, 1.1, 10.0):
        for array in reference.at(time):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
    with pytest.raises(ValidationError, match="frozen"):
        reference.kind = "hold"  # type: ignore[attr-defined]


@every_kind
def test_survives_pickling(kind: str) -> None:
    reference = KINDS[kind][0]
    reference.at(1.2)
    again = pickle.loads(pickle.dumps(reference))
    for first, second in zip(reference.at(1.2), again.at(1.2), strict=True):
        assert_array_equal(first, second)


@every_kind
def test_equality_is_that_of_the_fields_whatever_has_been_computed(kind: str) -> None:
    reference = KINDS[kind][0]
    copy = reference.replace()
    assert copy == reference
    copy.at(0.0)
    assert copy == reference
    assert all((other == reference) == (name == kind) for name, (other, _) in KINDS.items())


@every_kind
def test_check_consistency_accepts_every_kind(kind: str) -> None:
    reference, joints = KINDS[kind]
    closure_errors = check_consistency(reference, [*np.linspace(-0.3, 4.1, 45), *joints])
    assert closure_errors.twist < 1e-6
    assert closure_errors.acceleration < 1e-4


def test_later_changes_of_an_argument_do_not_reach_the_reference() -> None:
    pose = POSE.copy()
    reference = HoldMotion(pose=pose)
    pose[0, 3] = 9.0
    assert_allclose(reference.at(0.0).X_WP_d, POSE, atol=1e-15)


# ---------------------------------------------------------------- laws of single kinds


def test_hold_returns_one_object_at_rest() -> None:
    reference = HoldMotion(pose=START)
    assert reference.at(0.0) is reference.at(7.0)
    assert_array_equal(reference.at(0.0).X_WP_d, POSE)
    assert_array_equal(reference.at(0.0).V_WP_d, np.zeros(6))


@pytest.mark.parametrize("time", [0.0, 0.3, 10.0, 20.0])
def test_exponentials_are_the_papers_motion(time: float) -> None:
    x = 0.4 - 0.2 * math.exp(-time / 6.6) + 0.5 * math.exp(-time / 6.8)
    target = paper().at(time)
    assert_allclose(target.X_WP_d, make_pose((x, x / ROOT_3 - 0.2, 0.0), (0.0, 0.0, math.pi / 3)), atol=1e-15)
    assert_allclose(target.V_WP_d[1], target.V_WP_d[0] / ROOT_3, atol=1e-15)


def test_the_papers_motion_starts_at_the_papers_numbers() -> None:
    target = paper().at(0.0)
    assert_allclose(target.X_WP_d[:3, 3], (0.7, 0.7 / ROOT_3 - 0.2, 0.0), atol=1e-15)
    assert_allclose(rpy_from_rotation(target.X_WP_d[:3, :3]), (0, 0, math.pi / 3), atol=1e-15)
    assert_allclose(target.V_WP_d[0], 0.2 / 6.6 - 0.5 / 6.8, atol=1e-15)
    assert_allclose(target.A_WP_d[0], -0.2 / 6.6**2 + 0.5 / 6.8**2, atol=1e-15)


def test_line_goes_from_start_to_goal_and_is_half_way_at_half_time() -> None:
    line = LineMotion(start=START, goal=GOAL_POSE, duration=2.0, start_time=1.0)
    assert_allclose(line.at(1.0).X_WP_d, POSE, atol=1e-15)
    assert_allclose(line.at(3.0).X_WP_d, GOAL, atol=1e-15)
    middle = line.at(2.0).X_WP_d
    assert_allclose(pose_error(middle, POSE), pose_error(GOAL, middle), atol=1e-14)


def test_line_keeps_one_direction_and_one_axis() -> None:
    line = LineMotion(start=START, goal=GOAL_POSE, duration=2.0)
    way = pose_error(GOAL, POSE)
    for time in np.linspace(0.2, 1.8, 7):
        rate = line.at(time).V_WP_d
        assert_allclose(np.cross(rate[:3], way[:3]), np.zeros(3), atol=1e-14)
        assert_allclose(np.cross(rate[3:], way[3:]), np.zeros(3), atol=1e-14)
        assert rate @ way > 0


def test_circle_keeps_its_radius_its_plane_and_after_the_ramp_its_rate() -> None:
    centre, normal = np.array((0.1, 0.2, 0.3)), np.array((1.0, 2.0, -1.0))
    motion = circle(centre, 0.3, -2.0, 1.2, normal, start_angle=0.4)
    for time in np.linspace(0.0, 5.0, 23):
        spoke = motion.at(time).X_WP_d[:3, 3] - centre
        assert_allclose(np.linalg.norm(spoke), 0.3, atol=1e-14)
        assert_allclose(spoke @ normal, 0.0, atol=1e-14)
        if time > 1.2:
            v = motion.at(time).V_WP_d[:3]
            assert_allclose(np.cross(spoke, v) / 0.3**2, -2.0 * normal / np.linalg.norm(normal), atol=1e-13)
            assert_allclose(motion.at(time).A_WP_d[:3], -4.0 * spoke, atol=1e-13)


def test_circle_about_z_starts_on_the_x_axis_and_loses_half_a_ramp() -> None:
    motion = CircleMotion(pose=(0.5, 0.0, 0.0), radius=0.5, angular_rate=math.pi, ramp=2.0)
    assert_allclose(motion.at(0.0).X_WP_d[:3, 3], (0.5, 0, 0), atol=1e-15)
    assert_allclose(motion.at(1.0 + 0.5 + 2.0).X_WP_d[:3, 3], (0.0, 0.5, 0), atol=1e-14)


def test_turn_reaches_its_angle_over_several_revolutions() -> None:
    axis, angle = np.array((0.0, 0.0, 2.0)), 4 * math.pi + 0.3
    turn = TurnMotion(pose=START, axis=axis, angle=angle, duration=2.0)
    assert_allclose(
        turn.at(2.0).X_WP_d, make_pose(POSE[:3, 3], (0, 0, 0.3)) @ _rotation_only(POSE), atol=1e-14
    )
    times = np.linspace(0.0, 2.0, 2001)
    rates = [turn.at(time).V_WP_d[5] for time in times]
    assert_allclose(np.trapezoid(rates, times), angle, atol=1e-5)


def _rotation_only(X: np.ndarray) -> np.ndarray:
    turned = X.copy()
    turned[:3, 3] = 0.0
    return turned


def test_turn_is_a_line_between_the_same_orientations() -> None:
    axis = np.array((1.0, -2.0, 0.5)) / np.linalg.norm((1.0, -2.0, 0.5))
    goal = POSE.copy()
    goal[:3, :3] = Rotation.from_rotvec(1.3 * axis).as_matrix() @ POSE[:3, :3]
    turn = TurnMotion(pose=START, axis=5.0 * axis, angle=1.3, duration=2.0)
    line = LineMotion(start=START, goal=goal, duration=2.0)
    for time in np.linspace(-0.1, 2.1, 12):
        for first, second in zip(turn.at(time), line.at(time), strict=True):
            assert_allclose(first, second, atol=1e-13)


def test_a_turn_about_a_point_keeps_the_pose_seen_from_it() -> None:
    centre = np.array((0.3, -0.2, 0.1))
    turn = TurnMotion(pose=START, axis=AXIS, angle=2.0, duration=2.0, centre=tuple(centre))
    (X_0, *_), (X, *_) = turn.at(0.0), turn.at(1.3)
    assert np.linalg.norm(X[:3, 3] - X_0[:3, 3]) > 0.1
    assert_allclose(X[:3, :3].T @ (X[:3, 3] - centre), X_0[:3, :3].T @ (X_0[:3, 3] - centre), atol=1e-15)
    assert_allclose((X[:3, 3] - X_0[:3, 3]) @ AXIS, 0.0, atol=1e-15)


def test_swing_is_a_sine_after_its_ramp() -> None:
    swing = SwingMotion(pose=START, axis=(0, 3.0, 0), amplitude=0.7, period=1.3, ramp=1.0, start_time=0.5)
    for time in (1.5, 1.9, 7.3):
        angle = 0.7 * math.sin(2 * math.pi * (time - 0.5) / 1.3)
        assert_allclose(pose_error(swing.at(time).X_WP_d, POSE), (0, 0, 0, 0, angle, 0), atol=1e-14)


def test_waypoints_pass_through_their_poses_at_their_times() -> None:
    for time, pose in zip(WAYPOINT_TIMES, WAYPOINT_POSES, strict=True):
        assert_allclose(waypoints().at(time).X_WP_d, pose.matrix, atol=1e-13)


def test_two_waypoints_make_the_position_of_a_line_on_its_geodesic() -> None:
    path, line = waypoints((0.5, 2.0), (START, GOAL_POSE)), KINDS["line"][0]
    way = pose_error(GOAL, POSE)[3:]
    for time in np.linspace(0.4, 2.1, 18):
        ours, theirs = path.at(time), line.at(time)
        assert_allclose(ours.X_WP_d[:3, 3], theirs.X_WP_d[:3, 3], atol=1e-14)
        assert_allclose(ours.V_WP_d[:3], theirs.V_WP_d[:3], atol=1e-13)
        assert_allclose(ours.A_WP_d[:3], theirs.A_WP_d[:3], atol=1e-12)
        assert_allclose(np.cross(ours.V_WP_d[3:], way), np.zeros(3), atol=1e-13)
    assert_allclose(path.at(1.25).X_WP_d, line.at(1.25).X_WP_d, atol=1e-14)


def test_waypoints_do_not_care_which_world_they_are_in() -> None:
    X_VW = make_pose((1.0, -2.0, 0.5), (0.3, 0.9, -2.0))
    path, moved = waypoints(), waypoints(poses=[Pose.from_matrix(X_VW @ X.matrix) for X in WAYPOINT_POSES])
    for time in np.linspace(0.4, 3.6, 17):
        assert_allclose(moved.at(time).X_WP_d, X_VW @ path.at(time).X_WP_d, atol=1e-13)


def test_a_fine_table_of_a_smooth_motion_reproduces_it() -> None:
    line = LineMotion(start=START, goal=GOAL_POSE, duration=2.0)
    times = np.linspace(0.0, 2.0, 101)
    path = waypoints(times, [Pose.from_matrix(line.at(time).X_WP_d) for time in times])
    for time in np.linspace(0.0, 2.0, 37):
        assert_allclose(path.at(time).X_WP_d, line.at(time).X_WP_d, atol=1e-6)
        assert_allclose(path.at(time).V_WP_d, line.at(time).V_WP_d, atol=1e-4)
        assert_allclose(path.at(time).A_WP_d, line.at(time).A_WP_d, atol=1e-2)


def test_signs_and_lengths_of_quaternions_do_not_matter() -> None:
    table, other = spline(), spline(scale=(1.0, -3.0, 0.5))
    for time in np.linspace(0.9, 3.1, 12):
        for first, second in zip(table.at(time), other.at(time), strict=True):
            assert_allclose(first, second, atol=1e-12)


# ---------------------------------------------------------------- functions of the user


SWING = SwingMotion(pose=START, axis=AXIS, amplitude=0.7, period=1.3)
LINE = LineMotion(start=START, goal=GOAL_POSE, duration=1.5)


def swinging(time: float) -> np.ndarray:
    return SWING.at(time).X_WP_d


def swinging_twist(time: float) -> np.ndarray:
    return SWING.at(time).V_WP_d


def swinging_acceleration(time: float) -> np.ndarray:
    return SWING.at(time).A_WP_d


def test_differences_of_a_function_agree_with_the_exact_derivatives() -> None:
    reference = FunctionMotion(target=swinging)
    for time in np.linspace(1.1, 4.0, 13):
        assert_allclose(reference.at(time).X_WP_d, SWING.at(time).X_WP_d, atol=0)
        assert_allclose(reference.at(time).V_WP_d, SWING.at(time).V_WP_d, atol=1e-9)
        assert_allclose(reference.at(time).A_WP_d, SWING.at(time).A_WP_d, atol=1e-7)


def test_differences_are_of_fourth_order() -> None:
    exact = CircleMotion(pose=(1.0, 0.0, 0.0), radius=1.0, angular_rate=1.0)
    errors = [
        np.linalg.norm(pose_rates(lambda t: exact.at(t).X_WP_d, 2.5, step)[0] - exact.at(2.5).V_WP_d)
        for step in (0.08, 0.04)
    ]
    assert_allclose(math.log2(errors[0] / errors[1]), 4.0, atol=0.1)


def test_given_twist_and_acceleration_are_used_as_they_are() -> None:
    reference = FunctionMotion(target=swinging, twist=swinging_twist, acceleration=swinging_acceleration)
    for first, second in zip(reference.at(0.7), SWING.at(0.7), strict=True):
        assert_array_equal(first, second)
    differenced = FunctionMotion(target=swinging, twist=swinging_twist)
    assert_allclose(differenced.at(0.7).A_WP_d, SWING.at(0.7).A_WP_d, atol=1e-8)


def in_payload_axes(target: PoseTarget) -> np.ndarray:
    R = target.X_WP_d[:3, :3]
    return np.concatenate((R.T @ target.V_WP_d[:3], R.T @ target.V_WP_d[3:]))


MISTAKEN_TWISTS = {
    "sign": (lambda target: -target.V_WP_d, "linear part of V_WP_d"),
    "axes": (in_payload_axes, "linear part of V_WP_d"),
    "order": (lambda target: np.roll(target.V_WP_d, 3), "linear part of V_WP_d"),
    "scale": (lambda target: target.V_WP_d * (1, 1, 1, 1, 1, 1.01), "angular part of V_WP_d"),
}


def on_line(time: float, **_: str) -> np.ndarray:
    return LINE.at(time).X_WP_d


def mistaken_twist(time: float, mistake: str) -> np.ndarray:
    return MISTAKEN_TWISTS[mistake][0](LINE.at(time))


def mistaken_acceleration(time: float) -> np.ndarray:
    return 1.1 * LINE.at(time).A_WP_d


@pytest.mark.parametrize("mistake", MISTAKEN_TWISTS)
def test_a_twist_that_is_not_the_rate_of_the_pose_is_refused(mistake: str) -> None:
    reference = FunctionMotion(target=on_line, twist=mistaken_twist, options={"mistake": mistake})
    with pytest.raises(OutOfRangeError) as caught:
        check_consistency(reference, np.linspace(0.1, 1.4, 9))
    part, time = re.findall(r"of the (.*) from .* at (\S+) s", caught.value.name)[0]
    assert part == MISTAKEN_TWISTS[mistake][1]
    assert caught.value.value > 0
    assert 0.1 <= float(time) <= 1.4


def test_an_acceleration_that_is_not_the_rate_of_the_twist_is_refused() -> None:
    with pytest.raises(OutOfRangeError) as caught:
        check_consistency(FunctionMotion(target=on_line, acceleration=mistaken_acceleration), [0.2, 0.3])
    assert "linear part of A_WP_d" in caught.value.name


def test_a_users_own_reference_must_return_poses() -> None:
    class Mirrored(PoseReference):
        def at(self, time: float) -> PoseTarget:
            return PoseTarget(np.diag((1.0, 1.0, -1.0, 1.0)), np.zeros(6), np.zeros(6))

    with pytest.raises(OutOfRangeError, match="mirror"):
        check_consistency(Mirrored(), [0.0])


def three_by_three(_: float) -> np.ndarray:
    return np.eye(3)


def not_numbers(_: float) -> np.ndarray:
    return np.full(6, np.nan)


def test_functions_with_wrong_values_are_refused_by_name() -> None:
    with pytest.raises(ShapeError, match=r"three_by_three at t = 2 s"):
        FunctionMotion(target=three_by_three).at(2.0)
    with pytest.raises(OutOfRangeError, match="not_numbers"):
        FunctionMotion(target=spun, twist=not_numbers).at(2.0)
    with pytest.raises(ShapeError, match="three_by_three"):
        FunctionMotion(target=spun, acceleration=three_by_three).at(2.0)


# ---------------------------------------------------------------- bad arguments

HALF_TURN = START.replace(rpy=rpy_from_rotation(POSE[:3, :3] @ np.diag((1.0, -1.0, -1.0))))
BAD_POSES = {
    "shape": np.eye(3),
    "NaN": np.full((4, 4), np.nan),
    "scale": 1.1 * np.eye(4),
    "mirror": np.diag((1.0, -1.0, 1.0, 1.0)),
    "last row": POSE + np.eye(4)[[3, 0, 1, 2]].T * 0.1,
}
VALID = {
    LineMotion: {"start": START, "goal": GOAL_POSE, "duration": 1.0},
    ExponentialMotion: {"constant": (0, 0, 0), "amplitudes": [(0, 0, 0)] * 2, "time_constants": (1.0, 2.0)},
    CircleMotion: {"pose": START, "radius": 1.0, "angular_rate": 1.0},
    TurnMotion: {"pose": START, "axis": AXIS, "angle": 1.0, "duration": 1.0},
    SwingMotion: {"pose": START, "axis": AXIS, "amplitude": 1.0, "period": 1.0},
    WaypointsMotion: {"points": waypoints().points},
}


@pytest.mark.parametrize("pose", BAD_POSES.values(), ids=BAD_POSES)
def test_a_matrix_that_is_no_pose_is_refused(pose: np.ndarray) -> None:
    with pytest.raises(FieldError) as caught:
        HoldMotion(pose=pose)
    assert caught.value.path == "pose"


@pytest.mark.parametrize(
    ("kind", "fields", "error", "path"),
    [
        (ExponentialMotion, {"constant": (0.0, 0.0)}, FieldError, "constant"),
        (ExponentialMotion, {"time_constants": (1.0,)}, FieldError, "time_constants"),
        (ExponentialMotion, {"time_constants": (1.0, 0.0)}, FieldError, "time_constants.1"),
        (ExponentialMotion, {"rpy": (0.0, 0.0)}, FieldError, "rpy"),
        (LineMotion, {"goal": np.zeros((4, 4))}, FieldError, "goal"),
        (LineMotion, {"duration": 0.0}, FieldError, "duration"),
        (LineMotion, {"start_time": math.inf}, FieldError, "start_time"),
        (LineMotion, {"goal": HALF_TURN}, FieldError, "goal.rpy"),
        (CircleMotion, {"radius": -1.0}, FieldError, "radius"),
        (CircleMotion, {"ramp": 0.0}, FieldError, "ramp"),
        (CircleMotion, {"angular_rate": math.nan}, FieldError, "angular_rate"),
        (CircleMotion, {"normal": (0, 0, 0)}, FieldError, "normal"),
        (TurnMotion, {"axis": (0, 0, 0)}, FieldError, "axis"),
        (TurnMotion, {"duration": -1.0}, FieldError, "duration"),
        (SwingMotion, {"period": 0.0}, FieldError, "period"),
        (SwingMotion, {"ramp": 0.0}, FieldError, "ramp"),
        (WaypointsMotion, {"points": waypoints().points[:1]}, FieldError, "points"),
        (
            WaypointsMotion,
            {"points": [{"time": 0.0}, {"time": math.nan}]},
            FieldError,
            "points.1.time",
        ),
        (WaypointsMotion, {"points": [{"time": t} for t in (0, 2, 2, 3)]}, FieldError, "points.2.time"),
        (
            WaypointsMotion,
            {"points": [{"time": 0.0}, {"time": 1.0, "rpy": (math.pi, 0, 0)}]},
            FieldError,
            "points.1.rpy",
        ),
    ],
)
def test_bad_fields_are_refused_by_path(kind, fields, error: type[Exception], path: str) -> None:
    with pytest.raises(FieldError) as caught:
        kind(**(VALID[kind] | fields))
    assert type(caught.value) is error
    assert caught.value.path == path


def test_all_mistakes_are_reported_at_once() -> None:
    with pytest.raises(ScenarioError) as caught:
        LineMotion(start=np.eye(3), goal=GOAL_POSE, duration=-1.0, start_time=math.nan)
    assert [problem.path for problem in caught.value.problems] == ["start", "duration", "start_time"]


def test_times_of_the_consistency_check_are_a_list() -> None:
    with pytest.raises(ShapeError, match="times"):
        check_consistency(HoldMotion(pose=START), 0.0)


def test_waypoints_whose_orientation_swings_wildly_between_uneven_times_are_refused() -> None:
    turns = Rotation.from_rotvec([(0, 0, yaw) for yaw in (0.0, -2.2, -3.4, -4.6)]).as_quat()
    with pytest.raises(AmbiguousTurnError) as caught:
        PoseSpline.through(np.array((0.0, 0.2, 2.2, 4.2)), np.zeros((4, 3)), turns)
    assert caught.value.index == (3,)
    assert_allclose(caught.value.angle, 1.2, atol=1e-12)


def test_times_that_do_not_increase_are_refused_by_index() -> None:
    with pytest.raises(OutOfRangeError) as caught:
        PoseSpline.through(np.array((0.0, 2.0, 2.0)), np.zeros((3, 3)), QUATERNIONS)
    assert caught.value.index == (2,)


# ---------------------------------------------------------------- tables in files


def csv_motion(folder, text: str) -> CsvMotion:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return CsvMotion(path=str(path))


def test_a_file_of_angles_and_a_file_of_quaternions_say_the_same(tmp_path) -> None:
    path = csv_motion(tmp_path, TABLE)
    check_consistency(path, np.linspace(0.1, 2.4, 9))
    rows = np.array([line.split(",") for line in TABLE.splitlines()[1:] if line], dtype=float)
    quaternions = Rotation.from_euler("xyz", rows[:, 4:]).as_quat()
    lines = [
        ",".join(map(repr, (q.tolist() + row[:4].tolist()))) for q, row in zip(quaternions, rows, strict=True)
    ]
    text = "\ufeffqx, qy, qz, qw, time, x, y, z\n" + "\n".join(line.strip("[]") for line in lines)
    again = csv_motion(tmp_path, text)
    for time in np.linspace(-0.1, 2.6, 19):
        for first, second in zip(path.at(time), again.at(time), strict=True):
            assert_allclose(first, second, atol=1e-12)
    assert_allclose(path.at(1.0).X_WP_d, make_pose((0.1, 0, 1), (0.1, 0.2, -3.0)), atol=1e-14)


def test_a_copy_of_a_csv_motion_reads_its_file_anew(tmp_path) -> None:
    path = csv_motion(tmp_path, TABLE)
    assert path.at(0.0).X_WP_d[2, 3] == 1.0
    csv_motion(tmp_path, TABLE.replace("\n0,0,0,1,", "\n0,0,0,2,"))
    assert path.at(0.0).X_WP_d[2, 3] == 1.0
    assert path.replace().at(0.0).X_WP_d[2, 3] == 2.0


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "columns missing: time"),
        (TABLE.replace("roll,", ""), 1, "columns missing: roll"),
        (TABLE.replace("roll,pitch,yaw", "qx,qy,qz"), 1, "columns missing: qw"),
        (TABLE.replace("yaw", "yaw,force"), 1, "unknown column 'force'"),
        (TABLE.replace("yaw", "yaw,x"), 1, "'x' is given twice"),
        (TABLE.replace("1,0.1,0,1,", "1,0.1,0,nan,"), 4, "z is 'nan'"),
        (TABLE.replace("1,0.1,0,1,", "1,abc,0,1,"), 4, "x is 'abc'"),
        (TABLE.replace("1,0.1,0,1,", "1,,0,1,"), 4, "x is ''"),
        (TABLE.replace("1,0.1,0,1,", "1,0.1,0,"), 4, "6 cells"),
        (TABLE.replace("2.5,0.2", "1,0.2"), 5, "increase strictly"),
        (TABLE.replace("2.5,0.2", "0.5,0.2"), 5, "increase strictly"),
        (TABLE.replace("1,0,0,-2\n", f"1,{0.1 + math.pi},0.2,-3\n"), 5, "ambiguous"),
        (TABLE[: TABLE.index("\n1,")], 0, "has 1 rows"),
        ("time,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0.1,1\n", 3, "length 1.00499"),
    ],
)
def test_bad_tables_are_refused_with_the_line(text: str, line: int, words: str, tmp_path) -> None:
    motion = csv_motion(tmp_path, text)
    with pytest.raises(FileReadError, match=words) as caught:
        motion.at(0.0)
    assert caught.value.line == line
    assert caught.value.path == motion.path


def test_a_missing_file_and_a_binary_file_are_refused(tmp_path) -> None:
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    for file in (tmp_path / "nowhere.csv", binary):
        with pytest.raises(FileReadError, match="cannot be read"):
            CsvMotion(path=str(file)).at(0.0)


# ---------------------------------------------------------------- squeeze

ARMS = {"left": Pose(xyz=(-0.12, 0.0, 0.0)), "right": Pose(xyz=(0.12, 0.0, 0.0))}
SWAPPED = dict(reversed(ARMS.items()))
NONE = np.zeros((2, 6))
BAR = np.array(((-10.0, 0, 0, 0, 0, 0), (10.0, 0, 0, 0, 0, 0)))


def table(rows: np.ndarray) -> dict[str, list[float]]:
    return dict(zip(ARMS, rows.tolist(), strict=True))


def harder(time: float) -> np.ndarray:
    return time * BAR


def six(_: float) -> np.ndarray:
    return np.zeros(6)


def test_constant_squeeze_has_the_rows_of_the_arms_asked_for() -> None:
    squeeze = ConstantSqueeze(wrenches=table(BAR))
    assert not squeeze.at(0.0, ARMS).flags.writeable
    assert_array_equal(squeeze.at(5.0, ARMS), BAR)
    assert_array_equal(squeeze.at(5.0, SWAPPED), BAR[::-1])
    assert_array_equal(ConstantSqueeze().at(0.0, ARMS), NONE)


OFF_CENTRE = {
    "left": Pose(xyz=(-0.2, 0.03, 0.05)),
    "right": Pose(xyz=(0.2, -0.01, 0.08)),
    "third": Pose(xyz=(0.0, 0.3, 0.0)),
}


@pytest.mark.parametrize("arms", [2, 3])
def test_tip_forces_press_along_the_lines_between_tips_and_move_nothing(arms: int) -> None:
    grasps = dict(list(OFF_CENTRE.items())[:arms])
    tips = np.array([grasp.xyz for grasp in grasps.values()])
    f_P = TipForceSqueeze(force=20.0).at(1.0, grasps)
    assert not f_P.flags.writeable
    assert_allclose(f_P.sum(axis=0), np.zeros(6), atol=1e-13)
    at_tips = shift_wrench(f_P, -tips)
    assert_allclose(at_tips[:, 3:], 0.0, atol=1e-14)  # no moment at a wrist
    assert_allclose(np.linalg.norm(at_tips[:, :3], axis=1).mean(), 20.0, rtol=1e-12)
    centre = tips.mean(axis=0)
    assert (np.einsum("ij,ij->i", at_tips[:, :3], tips - centre) > 0.0).all()  # the payload pushes outwards
    assert_allclose(TipForceSqueeze(force=-20.0).at(0.0, grasps), -f_P, rtol=0.0)
    if arms == 2:
        assert_allclose(np.cross(at_tips[0, :3], tips[1] - tips[0]), 0.0, atol=1e-13)


def test_wrenches_stated_at_the_tips_are_shifted_to_p() -> None:
    force, grasps = np.array((-10.0, 0.0, 2.0)), {name: OFF_CENTRE[name] for name in ("left", "right")}
    lever = np.subtract(grasps["left"].xyz, grasps["right"].xyz)
    balance = np.concatenate((-force, np.cross(lever, -force) - (0.1, 0.2, 0.3)))
    squeeze = TipWrenchSqueeze(wrenches={"left": (*force, 0.1, 0.2, 0.3), "right": tuple(balance)})
    squeeze.check_arms(grasps)
    f_P = squeeze.at(0.0, grasps)
    assert_allclose(f_P.sum(axis=0), np.zeros(6), atol=1e-14)
    moment = np.cross(grasps["left"].xyz, force) + np.array((0.1, 0.2, 0.3))
    assert_allclose(f_P[0], [*force, *moment], atol=1e-14)


def test_tip_squeezes_that_cannot_be_are_refused() -> None:
    grasps = {name: OFF_CENTRE[name] for name in ("left", "right")}
    moving = TipWrenchSqueeze(wrenches={"left": (1.0, 0, 0, 0, 0, 0), "right": (-1.0, 0, 0, 0, 0, 0)})
    for squeeze, wrong in (
        (moving, grasps),
        (TipForceSqueeze(force=1.0), {"left": OFF_CENTRE["left"]}),
        (TipForceSqueeze(force=1.0), dict.fromkeys(("left", "right"), OFF_CENTRE["left"])),
    ):
        with pytest.raises(FieldError):
            squeeze.check_arms(wrong)


def test_ramped_squeeze_goes_smoothly_from_start_to_goal() -> None:
    start = -0.4 * BAR[:, ::-1]
    squeeze = RampSqueeze(start=table(start), goal=table(BAR), duration=2.0, start_time=1.0)
    for time in (0.0, 1.0):
        assert_array_equal(squeeze.at(time, ARMS), start)
    assert_allclose(squeeze.at(2.0, ARMS), (start + BAR) / 2, atol=1e-14)
    for time in (3.0, 9.0):
        assert_array_equal(squeeze.at(time, ARMS), BAR)
    assert not squeeze.at(2.0, ARMS).flags.writeable
    for time in (1.0, 3.0):
        rate = (squeeze.at(time + 1e-6, ARMS) - squeeze.at(time - 1e-6, ARMS)) / 2e-6
        assert_allclose(rate, NONE, atol=1e-7)
    for time in np.linspace(1.0, 3.0, 11):
        assert_allclose(squeeze.at(time, ARMS).sum(axis=0), np.zeros(6), atol=1e-14)


def test_squeeze_from_a_function_is_checked() -> None:
    squeeze = FunctionSqueeze(target=harder)
    assert_array_equal(squeeze.at(0.5, ARMS), 0.5 * BAR)
    assert not squeeze.at(0.5, ARMS).flags.writeable
    with pytest.raises(ShapeError, match="six at t = 1 s"):
        FunctionSqueeze(target=six).at(1.0, ARMS)
    with pytest.raises(OutOfRangeError):
        FunctionSqueeze(target=harder).at(math.nan, ARMS)


@pytest.mark.parametrize(
    ("make", "error", "path"),
    [
        (lambda: ConstantSqueeze(wrenches={"left": (0.0, 0.0)}), FieldError, "wrenches.left"),
        (lambda: ConstantSqueeze(wrenches=table(np.full((2, 6), math.inf))), FieldError, "wrenches.left.0"),
        (lambda: RampSqueeze(goal=table(BAR), duration=0.0), FieldError, "duration"),
    ],
)
def test_bad_squeezes_are_refused_by_path(make, error: type[FieldError], path: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        make()
    assert isinstance(caught.value.problems[0], error)
    assert caught.value.problems[0].path == path


def test_inverse_of_a_moving_pose_turns_with_minus_the_twist() -> None:
    """The twist is about P's origin in world axes: seen from P, the world moves by the opposite motion."""
    reference = KINDS["waypoints"][0]
    time, step = 1.3, 1e-5
    X, V = reference.at(time).X_WP_d, reference.at(time).V_WP_d
    moved = reference.at(time + step).X_WP_d @ inverse_pose(reference.at(time - step).X_WP_d)
    point = X[:3, 3] + np.array((0.2, -0.1, 0.4))
    displaced = moved[:3, :3] @ point + moved[:3, 3] - point
    assert_allclose(displaced / (2 * step), V[:3] + np.cross(V[3:], point - X[:3, 3]), atol=1e-4)


def test_a_ramp_of_the_squeeze_begins_at_once_unless_told_otherwise() -> None:
    ramp = RampSqueeze(goal=table(BAR), duration=2.0)
    assert_close(ramp.at(0.0, ARMS), NONE, atol=0.0)
    assert_close(ramp.at(1.0, ARMS), 0.5 * BAR, atol=1e-14)
    assert_close(ramp.at(2.0, ARMS), BAR, atol=0.0)
