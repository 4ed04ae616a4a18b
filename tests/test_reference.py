"""Laws of the references: every twist is the rate of its pose, every acceleration the rate of its twist."""

from __future__ import annotations

import dataclasses
import math
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from coop_pin.errors import (
    AmbiguousTurnError,
    FileReadError,
    InconsistentReferenceError,
    NotAPoseError,
    NotIncreasingError,
    OutOfRangeError,
    ShapeError,
)
from coop_pin.reference import (
    Circle,
    ConstantSqueeze,
    Exponentials,
    FromFunction,
    Hold,
    Line,
    PoseReference,
    PoseTarget,
    RampedSqueeze,
    SqueezeFromFunction,
    Swing,
    Tabulated,
    Turn,
    Waypoints,
    check_consistency,
)
from coop_pin.spatial import inverse_pose, make_pose, pose_error, rpy_from_rotation

ROOT_3 = math.sqrt(3.0)
POSE = make_pose((0.3, -0.2, 0.7), (0.4, -0.9, 2.0))
GOAL = make_pose((0.1, 0.4, 0.9), (-0.5, 0.3, -2.4))
WAYPOINT_TIMES = (0.5, 1.7, 2.1, 3.5)
WAYPOINT_POSES = np.stack(
    (POSE, GOAL, make_pose((0, 0, 0.5), (1, 1, 1)), make_pose((0.2, 0, 0.5), (-1, 0.2, 3)))
)


def paper() -> Exponentials:
    amplitudes = np.array(((-0.2, -0.2 / ROOT_3, 0.0), (0.5, 0.5 / ROOT_3, 0.0)))
    return Exponentials(
        np.array((0.4, 0.4 / ROOT_3 - 0.2, 0.0)),
        amplitudes,
        np.array((6.6, 6.8)),
        np.array((0, 0, math.pi / 3)),
    )


def tabulated() -> Tabulated:
    positions = np.array(((0, 0, 1), (0.2, 0.1, 1), (0.3, 0.4, 1.2)))
    quaternions = Rotation.from_euler("xyz", ((0, 0, 3.0), (0.3, 0.2, -3.0), (0.5, 0.5, -2.0))).as_quat()
    return Tabulated(np.array((1.0, 2.0, 3.0)), positions, quaternions)


def spun(time: float) -> np.ndarray:
    return Turn(POSE, np.array((1.0, -2.0, 0.5)), 1.0, 1.0).at(0.5 + 0.2 * math.sin(time)).X_WP_d


# every kind, with the times between which its formula changes
KINDS: dict[str, tuple[PoseReference, tuple[float, ...]]] = {
    "hold": (Hold(POSE), ()),
    "exponentials": (paper(), ()),
    "line": (Line(POSE, GOAL, duration=1.5, start_time=0.5), (0.5, 2.0)),
    "line_without_turn": (Line(POSE, make_pose((0, 0, 0.3)) @ POSE, duration=1.5), (0.0, 1.5)),
    "circle": (
        Circle(
            np.array((0.1, 0.2, 0.3)),
            0.3,
            -2.0,
            1.2,
            np.array((1, 2, -1)),
            0.4,
            0.5,
            np.array((0.3, 0.2, 0.1)),
        ),
        (0.5, 1.7),
    ),
    "circle_about_x": (Circle(np.zeros(3), 0.3, 1.0, 1.0, np.array((2.0, 0, 0))), (0.0, 1.0)),
    "turn": (Turn(POSE, np.array((1, -2, 0.5)), 9.0, 2.0, 0.5), (0.5, 2.5)),
    "swing": (Swing(POSE, np.array((1, -2, 0.5)), 0.7, 1.3, 1.0, 0.5), (0.5, 1.5)),
    "waypoints": (Waypoints(np.array(WAYPOINT_TIMES), WAYPOINT_POSES), WAYPOINT_TIMES),
    "tabulated": (tabulated(), (1.0, 2.0, 3.0)),
    "from_function": (FromFunction(spun), ()),
}
FROM_REST = (
    "line",
    "line_without_turn",
    "circle",
    "circle_about_x",
    "turn",
    "swing",
    "waypoints",
    "tabulated",
)
TO_REST = ("line", "line_without_turn", "turn", "waypoints", "tabulated")
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
    for name, value in vars(reference).items():
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, name
    for time in (-1.0, 1.1, 10.0):
        for array in reference.at(time):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        reference.anything = 1.0  # type: ignore[attr-defined]


@every_kind
def test_survives_pickling(kind: str) -> None:
    reference = KINDS[kind][0]
    again = pickle.loads(pickle.dumps(reference))
    for first, second in zip(reference.at(1.2), again.at(1.2), strict=True):
        assert_array_equal(first, second)


@every_kind
def test_check_consistency_accepts_every_kind(kind: str) -> None:
    reference, joints = KINDS[kind]
    closure_errors = check_consistency(reference, [*np.linspace(-0.3, 4.1, 45), *joints])
    assert closure_errors.twist < 1e-6
    assert closure_errors.acceleration < 1e-4


def test_later_changes_of_an_argument_do_not_reach_the_reference() -> None:
    pose = POSE.copy()
    reference = Hold(pose)
    pose[0, 3] = 9.0
    assert_array_equal(reference.at(0.0).X_WP_d, POSE)


# ---------------------------------------------------------------- laws of single kinds


def test_hold_returns_one_object_at_rest() -> None:
    reference = Hold(POSE)
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
    line = Line(POSE, GOAL, duration=2.0, start_time=1.0)
    assert_allclose(line.at(1.0).X_WP_d, POSE, atol=1e-15)
    assert_allclose(line.at(3.0).X_WP_d, GOAL, atol=1e-15)
    middle = line.at(2.0).X_WP_d
    assert_allclose(pose_error(middle, POSE), pose_error(GOAL, middle), atol=1e-14)


def test_line_keeps_one_direction_and_one_axis() -> None:
    line = Line(POSE, GOAL, duration=2.0)
    way = pose_error(GOAL, POSE)
    for time in np.linspace(0.2, 1.8, 7):
        rate = line.at(time).V_WP_d
        assert_allclose(np.cross(rate[:3], way[:3]), np.zeros(3), atol=1e-14)
        assert_allclose(np.cross(rate[3:], way[3:]), np.zeros(3), atol=1e-14)
        assert rate @ way > 0


def test_circle_keeps_its_radius_its_plane_and_after_the_ramp_its_rate() -> None:
    centre, normal = np.array((0.1, 0.2, 0.3)), np.array((1.0, 2.0, -1.0))
    circle = Circle(centre, 0.3, -2.0, 1.2, normal, start_angle=0.4)
    for time in np.linspace(0.0, 5.0, 23):
        spoke = circle.at(time).X_WP_d[:3, 3] - centre
        assert_allclose(np.linalg.norm(spoke), 0.3, atol=1e-14)
        assert_allclose(spoke @ normal, 0.0, atol=1e-14)
        if time > 1.2:
            v = circle.at(time).V_WP_d[:3]
            assert_allclose(np.cross(spoke, v) / 0.3**2, -2.0 * normal / np.linalg.norm(normal), atol=1e-13)
            assert_allclose(circle.at(time).A_WP_d[:3], -4.0 * spoke, atol=1e-13)


def test_circle_about_z_starts_on_the_x_axis_and_loses_half_a_ramp() -> None:
    circle = Circle(np.zeros(3), 0.5, math.pi, ramp=2.0)
    assert_allclose(circle.at(0.0).X_WP_d[:3, 3], (0.5, 0, 0), atol=1e-15)
    assert_allclose(circle.at(1.0 + 0.5 + 2.0).X_WP_d[:3, 3], (0.0, 0.5, 0), atol=1e-14)


def test_turn_reaches_its_angle_over_several_revolutions() -> None:
    axis, angle = np.array((0.0, 0.0, 2.0)), 4 * math.pi + 0.3
    turn = Turn(POSE, axis, angle, duration=2.0)
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
    turn, line = Turn(POSE, 5.0 * axis, 1.3, 2.0), Line(POSE, goal, 2.0)
    for time in np.linspace(-0.1, 2.1, 12):
        for first, second in zip(turn.at(time), line.at(time), strict=True):
            assert_allclose(first, second, atol=1e-13)


def test_swing_is_a_sine_after_its_ramp() -> None:
    swing = Swing(POSE, np.array((0.0, 3.0, 0.0)), 0.7, period=1.3, ramp=1.0, start_time=0.5)
    for time in (1.5, 1.9, 7.3):
        angle = 0.7 * math.sin(2 * math.pi * (time - 0.5) / 1.3)
        assert_allclose(pose_error(swing.at(time).X_WP_d, POSE), (0, 0, 0, 0, angle, 0), atol=1e-14)


def test_waypoints_pass_through_their_poses_at_their_times() -> None:
    path = Waypoints(np.array(WAYPOINT_TIMES), WAYPOINT_POSES)
    for time, pose in zip(WAYPOINT_TIMES, WAYPOINT_POSES, strict=True):
        assert_allclose(path.at(time).X_WP_d, pose, atol=1e-13)


def test_two_waypoints_make_the_position_of_a_line_on_its_geodesic() -> None:
    path, line = Waypoints(np.array((0.5, 2.0)), np.stack((POSE, GOAL))), Line(POSE, GOAL, 1.5, 0.5)
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
    path, moved = (
        Waypoints(np.array(WAYPOINT_TIMES), poses) for poses in (WAYPOINT_POSES, X_VW @ WAYPOINT_POSES)
    )
    for time in np.linspace(0.4, 3.6, 17):
        assert_allclose(moved.at(time).X_WP_d, X_VW @ path.at(time).X_WP_d, atol=1e-13)


def test_a_fine_table_of_a_smooth_motion_reproduces_it() -> None:
    line = Line(POSE, GOAL, duration=2.0)
    times = np.linspace(0.0, 2.0, 101)
    path = Waypoints(times, np.stack([line.at(time).X_WP_d for time in times]))
    for time in np.linspace(0.0, 2.0, 37):
        assert_allclose(path.at(time).X_WP_d, line.at(time).X_WP_d, atol=1e-6)
        assert_allclose(path.at(time).V_WP_d, line.at(time).V_WP_d, atol=1e-4)
        assert_allclose(path.at(time).A_WP_d, line.at(time).A_WP_d, atol=1e-2)


def test_signs_and_lengths_of_quaternions_do_not_matter() -> None:
    table = tabulated()
    other = Tabulated(table.times, table.positions, table.quaternions * np.array((1.0, -3.0, 0.5))[:, None])
    for time in np.linspace(0.9, 3.1, 12):
        for first, second in zip(table.at(time), other.at(time), strict=True):
            assert_allclose(first, second, atol=1e-12)


# ---------------------------------------------------------------- functions of the user


def test_differences_of_a_function_agree_with_the_exact_derivatives() -> None:
    exact = Swing(POSE, np.array((1.0, -2.0, 0.5)), 0.7, 1.3, 1.0)
    reference = FromFunction(lambda time: exact.at(time).X_WP_d)
    for time in np.linspace(1.1, 4.0, 13):
        assert_allclose(reference.at(time).X_WP_d, exact.at(time).X_WP_d, atol=0)
        assert_allclose(reference.at(time).V_WP_d, exact.at(time).V_WP_d, atol=1e-9)
        assert_allclose(reference.at(time).A_WP_d, exact.at(time).A_WP_d, atol=1e-7)


def test_differences_are_of_fourth_order() -> None:
    exact = Circle(np.zeros(3), 1.0, 1.0, 1.0)
    closure_errors = [
        np.linalg.norm(
            FromFunction(lambda time: exact.at(time).X_WP_d, step=step).at(2.5).V_WP_d - exact.at(2.5).V_WP_d
        )
        for step in (0.08, 0.04)
    ]
    assert_allclose(math.log2(closure_errors[0] / closure_errors[1]), 4.0, atol=0.1)


def test_given_twist_and_acceleration_are_used_as_they_are() -> None:
    circle = Circle(np.zeros(3), 1.0, 1.0, 1.0)
    reference = FromFunction(
        lambda t: circle.at(t).X_WP_d, lambda t: circle.at(t).V_WP_d, lambda t: circle.at(t).A_WP_d
    )
    for first, second in zip(reference.at(0.7), circle.at(0.7), strict=True):
        assert_array_equal(first, second)
    differenced = FromFunction(lambda t: circle.at(t).X_WP_d, lambda t: circle.at(t).V_WP_d)
    assert_allclose(differenced.at(0.7).A_WP_d, circle.at(0.7).A_WP_d, atol=1e-8)


def in_payload_axes(target: PoseTarget) -> np.ndarray:
    R = target.X_WP_d[:3, :3]
    return np.concatenate((R.T @ target.V_WP_d[:3], R.T @ target.V_WP_d[3:]))


@pytest.mark.parametrize(
    ("mistake", "part"),
    [
        (lambda target: -target.V_WP_d, "linear part of V_WP_d"),
        (in_payload_axes, "linear part of V_WP_d"),
        (lambda target: np.roll(target.V_WP_d, 3), "linear part of V_WP_d"),
        (lambda target: target.V_WP_d * (1, 1, 1, 1, 1, 1.01), "angular part of V_WP_d"),
    ],
)
def test_a_twist_that_is_not_the_rate_of_the_pose_is_refused(mistake, part: str) -> None:
    line = Line(POSE, GOAL, duration=1.5)
    reference = FromFunction(lambda t: line.at(t).X_WP_d, lambda t: mistake(line.at(t)))
    with pytest.raises(InconsistentReferenceError) as caught:
        check_consistency(reference, np.linspace(0.1, 1.4, 9))
    assert caught.value.quantity == part
    assert caught.value.gap > 0
    assert 0.1 <= caught.value.time <= 1.4


def test_an_acceleration_that_is_not_the_rate_of_the_twist_is_refused() -> None:
    line = Line(POSE, GOAL, duration=1.5)
    reference = FromFunction(
        lambda t: line.at(t).X_WP_d, acceleration_function=lambda t: 1.1 * line.at(t).A_WP_d
    )
    with pytest.raises(InconsistentReferenceError) as caught:
        check_consistency(reference, [0.2, 0.3])
    assert caught.value.quantity == "linear part of A_WP_d"


def test_a_users_own_reference_must_return_poses() -> None:
    class Mirrored(PoseReference):
        def at(self, time: float) -> PoseTarget:
            return PoseTarget(np.diag((1.0, 1.0, -1.0, 1.0)), np.zeros(6), np.zeros(6))

    with pytest.raises(NotAPoseError, match="mirror"):
        check_consistency(Mirrored(), [0.0])


def test_functions_with_wrong_values_are_refused_by_name() -> None:
    with pytest.raises(ShapeError, match=r"pose_function\(2.0\)"):
        FromFunction(lambda _: np.eye(3)).at(2.0)
    with pytest.raises(OutOfRangeError, match=r"twist_function"):
        FromFunction(lambda _: POSE, lambda _: np.full(6, np.nan)).at(2.0)
    with pytest.raises(ShapeError, match="acceleration_function"):
        FromFunction(lambda _: POSE, acceleration_function=lambda _: np.zeros(3)).at(2.0)
    with pytest.raises(OutOfRangeError, match="step"):
        FromFunction(lambda _: POSE, step=0.0)


# ---------------------------------------------------------------- bad arguments

X_AXIS = np.array((1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("make", "error", "name"),
    [
        (lambda: Hold(np.eye(3)), ShapeError, "pose"),
        (lambda: Hold(np.full((4, 4), np.nan)), OutOfRangeError, "pose"),
        (lambda: Hold(1.1 * np.eye(4)), NotAPoseError, "pose"),
        (lambda: Hold(np.diag((1.0, -1.0, 1.0, 1.0))), NotAPoseError, "mirror"),
        (lambda: Hold(POSE + np.eye(4)[[3, 0, 1, 2]].T * 0.1), NotAPoseError, "pose"),
        (
            lambda: Exponentials(np.zeros(2), np.zeros((1, 3)), np.ones(1), np.zeros(3)),
            ShapeError,
            "constant",
        ),
        (
            lambda: Exponentials(np.zeros(3), np.zeros((2, 3)), np.ones(1), np.zeros(3)),
            ShapeError,
            "time_constants",
        ),
        (
            lambda: Exponentials(np.zeros(3), np.zeros((2, 3)), np.array((1.0, 0.0)), np.zeros(3)),
            OutOfRangeError,
            r"time_constants\[1\]",
        ),
        (lambda: Exponentials(np.zeros(3), np.zeros((1, 3)), np.ones(1), np.zeros(2)), ShapeError, "rpy"),
        (lambda: Line(POSE, np.zeros((4, 4)), 1.0), NotAPoseError, "goal"),
        (lambda: Line(POSE, GOAL, 0.0), OutOfRangeError, "duration"),
        (lambda: Line(POSE, GOAL, 1.0, math.inf), OutOfRangeError, "start_time"),
        (lambda: Line(POSE, POSE @ make_pose(rpy=(math.pi, 0, 0)), 1.0), AmbiguousTurnError, "goal"),
        (lambda: Circle(np.zeros(2), 1.0, 1.0, 1.0), ShapeError, "centre"),
        (lambda: Circle(np.zeros(3), -1.0, 1.0, 1.0), OutOfRangeError, "radius"),
        (lambda: Circle(np.zeros(3), 1.0, 1.0, 0.0), OutOfRangeError, "ramp"),
        (lambda: Circle(np.zeros(3), 1.0, math.nan, 1.0), OutOfRangeError, "angular_rate"),
        (lambda: Circle(np.zeros(3), 1.0, 1.0, 1.0, np.zeros(3)), OutOfRangeError, "length of normal"),
        (lambda: Turn(POSE, np.zeros(3), 1.0, 1.0), OutOfRangeError, "length of axis"),
        (lambda: Turn(POSE, X_AXIS, 1.0, -1.0), OutOfRangeError, "duration"),
        (lambda: Swing(POSE, X_AXIS, 1.0, 0.0, 1.0), OutOfRangeError, "period"),
        (lambda: Swing(POSE, X_AXIS, 1.0, 1.0, 0.0), OutOfRangeError, "ramp"),
        (lambda: Waypoints(np.zeros(1), POSE[None]), ShapeError, "times"),
        (lambda: Waypoints(np.arange(3.0), WAYPOINT_POSES), ShapeError, "poses"),
        (lambda: Waypoints(np.array((0.0, 1.0)), np.stack((POSE, 2 * POSE))), NotAPoseError, r"poses\[1\]"),
        (
            lambda: Waypoints(np.array((0.0, 2.0, 2.0, 3.0)), WAYPOINT_POSES),
            NotIncreasingError,
            r"times\[2\]",
        ),
        (
            lambda: Waypoints(np.array((0.0, math.nan, 2.0, 3.0)), WAYPOINT_POSES),
            OutOfRangeError,
            r"times\[1\]",
        ),
        (
            lambda: Waypoints(np.arange(2.0), np.stack((POSE, POSE @ make_pose(rpy=(math.pi, 0, 0))))),
            AmbiguousTurnError,
            "orientation 1",
        ),
        (
            lambda: Tabulated(np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 4))),
            OutOfRangeError,
            r"quaternions\[0\]",
        ),
        (lambda: Tabulated(np.arange(2.0), np.zeros((2, 2)), np.ones((2, 4))), ShapeError, "positions"),
        (lambda: check_consistency(Hold(POSE), 0.0), ShapeError, "times"),
    ],
)
def test_bad_arguments_are_refused_by_name(make, error: type[Exception], name: str) -> None:
    with pytest.raises(error, match=name):
        make()


def test_waypoints_whose_orientation_swings_wildly_between_uneven_times_are_refused() -> None:
    poses = np.stack([make_pose(rpy=(0, 0, yaw)) for yaw in (0.0, -2.2, -3.4, -4.6)])
    with pytest.raises(AmbiguousTurnError, match="space the times more evenly") as caught:
        Waypoints(np.array((0.0, 0.2, 2.2, 4.2)), poses)
    assert caught.value.index == 3
    assert_allclose(caught.value.angle, 1.2, atol=1e-12)


# ---------------------------------------------------------------- tables in files

TABLE = "time,x,y,z,roll,pitch,yaw\n0,0,0,1,0,0,3.0\n\n1,0.1,0,1,0.1,0.2,-3.0\n2.5,0.2,0.1,1,0,0,-2\n"


def test_a_file_of_angles_and_a_file_of_quaternions_say_the_same(tmp_path) -> None:
    angles = tmp_path / "angles.csv"
    angles.write_text(TABLE)
    path = Tabulated.from_csv(angles)
    quaternions = tmp_path / "quaternions.csv"
    rows = [
        ",".join(map(repr, (*map(float, q), t, *map(float, p))))
        for t, p, q in zip(*_columns(path), strict=True)
    ]
    quaternions.write_text("qx, qy, qz, qw, time, x, y, z\n" + "\n".join(rows), encoding="utf-8-sig")
    again = Tabulated.from_csv(str(quaternions))
    for time in np.linspace(-0.1, 2.6, 19):
        for first, second in zip(path.at(time), again.at(time), strict=True):
            assert_allclose(first, second, atol=1e-12)
    assert_allclose(path.at(1.0).X_WP_d, make_pose((0.1, 0, 1), (0.1, 0.2, -3.0)), atol=1e-14)
    check_consistency(path, np.linspace(0.1, 2.4, 9))


def _columns(path: Tabulated) -> tuple[list[float], np.ndarray, np.ndarray]:
    return path.times.tolist(), path.positions, path.quaternions


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "columns missing: time"),
        (TABLE.replace("roll,", ""), 1, "columns missing: roll"),
        (TABLE.replace("roll,pitch,yaw", "qx,qy,qz"), 1, "columns missing: qw"),
        (TABLE.replace("yaw", "yaw,force"), 1, "unknown column 'force'"),
        (TABLE.replace("yaw", "yaw,x"), 1, "'x' stands there twice"),
        (TABLE.replace("1,0.1,0,1,", "1,0.1,0,nan,"), 4, "z is nan"),
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
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises(FileReadError, match=words) as caught:
        Tabulated.from_csv(file)
    assert caught.value.line == line
    assert caught.value.path == str(file)


def test_a_missing_file_and_a_binary_file_are_refused(tmp_path) -> None:
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    for file in (tmp_path / "nowhere.csv", binary):
        with pytest.raises(FileReadError, match="cannot be read"):
            Tabulated.from_csv(file)


# ---------------------------------------------------------------- squeeze

NONE = np.zeros((2, 6))
BAR = np.array(((-10.0, 0, 0, 0, 0, 0), (10.0, 0, 0, 0, 0, 0)))


def test_constant_squeeze_returns_one_read_only_array() -> None:
    squeeze = ConstantSqueeze(BAR)
    assert squeeze.at(0.0) is squeeze.at(5.0)
    assert not squeeze.at(0.0).flags.writeable
    assert_array_equal(squeeze.at(0.0), BAR)


def test_ramped_squeeze_goes_smoothly_from_start_to_goal() -> None:
    start = -0.4 * BAR[:, ::-1]
    squeeze = RampedSqueeze(start, BAR, duration=2.0, start_time=1.0)
    for time in (0.0, 1.0):
        assert_array_equal(squeeze.at(time), start)
    assert_allclose(squeeze.at(2.0), (start + BAR) / 2, atol=1e-14)
    for time in (3.0, 9.0):
        assert_array_equal(squeeze.at(time), BAR)
    assert not squeeze.at(2.0).flags.writeable
    for time in (1.0, 3.0):
        assert_allclose((squeeze.at(time + 1e-6) - squeeze.at(time - 1e-6)) / 2e-6, NONE, atol=1e-7)


def test_ramped_squeeze_sums_to_zero_on_the_way_when_its_ends_do() -> None:
    squeeze = RampedSqueeze(NONE, BAR, duration=2.0)
    for time in np.linspace(0, 2, 11):
        assert_allclose(squeeze.at(time).sum(axis=0), np.zeros(6), atol=1e-14)


def test_squeeze_from_a_function_is_checked() -> None:
    squeeze = SqueezeFromFunction(lambda time: time * BAR)
    assert_array_equal(squeeze.at(0.5), 0.5 * BAR)
    assert not squeeze.at(0.5).flags.writeable
    with pytest.raises(ShapeError, match=r"function\(1.0\)"):
        SqueezeFromFunction(lambda _: np.zeros(6)).at(1.0)
    with pytest.raises(OutOfRangeError):
        SqueezeFromFunction(lambda _: BAR * math.nan).at(0.0)


@pytest.mark.parametrize(
    ("make", "error", "name"),
    [
        (lambda: ConstantSqueeze(np.zeros(6)), ShapeError, "wrenches"),
        (lambda: ConstantSqueeze(np.full((2, 6), np.inf)), OutOfRangeError, "wrenches"),
        (lambda: RampedSqueeze(NONE, np.zeros((3, 6)), 1.0), ShapeError, "goal"),
        (lambda: RampedSqueeze(NONE, BAR, 0.0), OutOfRangeError, "duration"),
    ],
)
def test_bad_squeezes_are_refused_by_name(make, error: type[Exception], name: str) -> None:
    with pytest.raises(error, match=name):
        make()


def test_inverse_of_a_moving_pose_turns_with_minus_the_twist() -> None:
    """The twist is about P's origin in world axes: seen from P, the world moves by the opposite motion."""
    reference = KINDS["waypoints"][0]
    time, step = 1.3, 1e-5
    X, V = reference.at(time).X_WP_d, reference.at(time).V_WP_d
    moved = reference.at(time + step).X_WP_d @ inverse_pose(reference.at(time - step).X_WP_d)
    point = X[:3, 3] + np.array((0.2, -0.1, 0.4))
    displaced = moved[:3, :3] @ point + moved[:3, 3] - point
    assert_allclose(displaced / (2 * step), V[:3] + np.cross(V[3:], point - X[:3, 3]), atol=1e-4)
