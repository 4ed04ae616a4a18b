"""Laws of poses, six-vectors, task rows and the internal-wrench split."""

import numpy as np
import pytest
from close import assert_close
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from coop_pin.base.errors import OutOfRangeError, ShapeError
from coop_pin.base.spatial import (
    internal_wrenches,
    inverse_pose,
    load_wrenches,
    make_pose,
    pose_error,
    rotate_vector6,
    rotation_from_rpy,
    rpy_from_rotation,
    shift_wrench,
    task_rows,
)
from coop_pin.base.spatial.generic_numbers import atan2, exp, inverse, require_less, sqrt, where
from coop_pin.base.spatial.pose import exp3, log3, quaternions, weight_wrench
from coop_pin.base.spatial.task_rows import joint_shortage

law = settings(max_examples=60, deadline=None, derandomize=True)

number = st.floats(-5.0, 5.0, allow_nan=False)
vector3 = st.tuples(number, number, number).map(np.array)
vector6 = st.tuples(*[number] * 6).map(np.array)
angle = st.floats(-3.1, 3.1)
pose = st.builds(make_pose, vector3, st.tuples(angle, st.floats(-1.5, 1.5), angle))
planar_pose = st.builds(lambda x, y, psi: make_pose((x, y, 0.0), (0.0, 0.0, psi)), number, number, angle)
wrenches = st.integers(2, 5).flatmap(lambda m: st.lists(vector6, min_size=m, max_size=m).map(np.array))


def shares_of(m: int) -> np.ndarray:
    shares = np.arange(1.0, m + 1.0)
    return shares / shares.sum()


def test_a_pose_of_nothing_is_the_identity():
    assert make_pose().tolist() == np.eye(4).tolist()


@law
@given(pose)
def test_the_inverse_of_a_pose_undoes_it_from_both_sides(X):
    assert_close(X @ inverse_pose(X), np.eye(4), atol=1e-13)
    assert_close(inverse_pose(X) @ X, np.eye(4), atol=1e-13)


@law
@given(st.tuples(angle, st.floats(-1.5, 1.5), angle))
def test_roll_pitch_yaw_is_read_back_and_follows_the_urdf_order(rpy):
    roll, pitch, yaw = rpy
    R = rotation_from_rpy(rpy)
    about = {
        axis: Rotation.from_euler(axis, value).as_matrix()
        for axis, value in (("x", roll), ("y", pitch), ("z", yaw))
    }
    assert_close(R, about["z"] @ about["y"] @ about["x"], atol=1e-14)
    assert_close(rotation_from_rpy(rpy_from_rotation(R)), R, atol=1e-13)


@law
@given(pose, pose)
def test_pose_error_is_antisymmetric_and_zero_only_for_equal_poses(X, X_d):
    assert_close(pose_error(X, X), np.zeros(6), atol=1e-13)
    forth, back = pose_error(X, X_d), pose_error(X_d, X)
    if np.linalg.norm(forth[3:]) < np.pi - 1e-3:  # the log has two signs at half a turn
        assert_close(forth, -back, atol=1e-9)
    rebuilt = np.eye(4)
    rebuilt[:3, :3] = Rotation.from_rotvec(forth[3:]).as_matrix() @ X_d[:3, :3]
    rebuilt[:3, 3] = X_d[:3, 3] + forth[:3]
    assert_close(rebuilt, X, atol=1e-9)


@law
@given(pose, pose, pose)
def test_pose_error_turns_with_the_world_and_ignores_its_origin(X, X_d, X_AW):
    """Seen from another world the error is the same arrow: R_AW e."""
    error = pose_error(X, X_d)
    if np.linalg.norm(error[3:]) < np.pi - 1e-3:
        assert_close(pose_error(X_AW @ X, X_AW @ X_d), rotate_vector6(X_AW[:3, :3], error), atol=1e-8)


@law
@given(planar_pose, planar_pose)
def test_planar_rows_are_the_rows_of_the_full_log_on_planar_poses(X, X_d):
    planar, full = task_rows("planar"), task_rows("full")
    if abs(abs(pose_error(X, X_d)[5]) - np.pi) < 1e-6:
        return
    assert_close(planar.pose_error(X, X_d), planar.select(full.pose_error(X, X_d)), atol=1e-12)
    assert_close(full.pose_error(X, X_d)[[2, 3, 4]], np.zeros(3), atol=1e-12)


@law
@given(planar_pose, st.tuples(number, number, number).map(np.array))
def test_planar_turn_is_the_full_turn_on_planar_poses(X, rows_P):
    planar, full = task_rows("planar"), task_rows("full")
    assert_close(planar.expand(planar.turn(X, rows_P)), full.turn(X, planar.expand(rows_P)), atol=1e-12)


@law
@given(pose, vector6)
def test_turn_is_the_rotation_of_both_halves(X, vector):
    turned = task_rows("full").turn(X, vector)
    assert_close(turned, np.concatenate((X[:3, :3] @ vector[:3], X[:3, :3] @ vector[3:])), atol=1e-12)
    assert_close(rotate_vector6(X[:3, :3].T, turned), vector, atol=1e-12)


@law
@given(pose, pose, st.tuples(number, number, number).map(np.array))
def test_positional_rows_are_the_linear_rows_of_the_full_ones(X, X_d, rows_P):
    positional, full = task_rows("positional"), task_rows("full")
    assert_close(positional.pose_error(X, X_d), full.pose_error(X, X_d)[:3], atol=1e-13)
    assert_close(
        positional.expand(positional.turn(X, rows_P)), full.turn(X, positional.expand(rows_P)), atol=1e-12
    )


@pytest.mark.parametrize(("name", "size"), [("planar", 3), ("positional", 3), ("full", 6)])
def test_expand_and_select_undo_each_other_and_name_their_axes(name, size):
    rows = task_rows(name)
    values = np.arange(1.0, size + 1.0)
    assert rows.size == len(rows.axes) == size
    assert_allclose(rows.select(rows.expand(values)), values)
    assert_allclose(rows.expand(np.tile(values, (4, 1))), np.tile(rows.expand(values), (4, 1)))
    assert_allclose(rows.select(np.eye(6)), np.eye(6)[list(rows.indices)])


@law
@given(vector6, vector6, vector3)
def test_a_shifted_wrench_does_the_same_power_on_the_shifted_twist(F_A, V_A, p_BA):
    """V_B is the twist of the same body at B: v_B = v_A + omega x (p_B - p_A)."""
    V_B = np.concatenate((V_A[:3] - np.cross(V_A[3:], p_BA), V_A[3:]))
    assert_close(shift_wrench(F_A, p_BA) @ V_B, F_A @ V_A, atol=1e-9)


@law
@given(vector6, vector3, vector3)
def test_shifting_twice_is_shifting_by_the_sum_and_back_is_nothing(F, p, r):
    assert_close(shift_wrench(shift_wrench(F, p), r), shift_wrench(F, p + r), atol=1e-10)
    assert_close(shift_wrench(shift_wrench(F, p), -p), F, atol=1e-10)


def test_shift_and_rotation_work_on_stacks():
    rng = np.random.default_rng(0)
    F, p = rng.normal(size=(4, 3, 6)), rng.normal(size=(4, 3, 3))
    R = Rotation.random(4, random_state=1).as_matrix()[:, None]
    shifted, turned = shift_wrench(F, p), rotate_vector6(R, F)
    for i in range(4):
        for j in range(3):
            assert_close(shifted[i, j], shift_wrench(F[i, j], p[i, j]), atol=1e-14)
            assert_close(turned[i, j], rotate_vector6(R[i, 0], F[i, j]), atol=1e-14)


@law
@given(wrenches)
def test_internal_wrenches_sum_to_zero_and_with_the_load_parts_give_back_the_whole(F):
    shares = shares_of(len(F))
    internal, load = internal_wrenches(F, shares), load_wrenches(F, shares)
    assert_close(internal.sum(axis=0), np.zeros(6), atol=1e-12)
    assert_close(internal + load, F, atol=1e-12)
    assert_close(load.sum(axis=0), F.sum(axis=0), atol=1e-12)
    assert_close(load, shares[:, None] * F.sum(axis=0), atol=1e-12)


@law
@given(wrenches, vector6)
def test_the_split_is_a_projection_and_a_shared_load_is_not_internal(F, load):
    shares = shares_of(len(F))
    internal = internal_wrenches(F, shares)
    assert_close(internal_wrenches(internal, shares), internal, atol=1e-12)
    assert_close(internal_wrenches(F + shares[:, None] * load, shares), internal, atol=1e-12)
    assert_close(internal_wrenches(shares[:, None] * load, shares), np.zeros_like(F), atol=1e-12)


def test_the_split_works_on_histories():
    F = np.random.default_rng(3).normal(size=(7, 3, 6))
    shares = np.array([0.2, 0.3, 0.5])
    assert_close(
        internal_wrenches(F, shares), [internal_wrenches(sample, shares) for sample in F], atol=1e-15
    )


def test_bad_values_are_refused_by_argument_name():
    with pytest.raises(ShapeError, match="translation") as shape:
        make_pose((1.0, 2.0))
    assert (shape.value.name, shape.value.shape) == ("translation", (2,))
    with pytest.raises(OutOfRangeError, match="rpy") as finite:
        make_pose(rpy=(0.0, np.nan, 0.0))
    assert (finite.value.name, finite.value.index) == ("rpy", (1,))


@pytest.mark.parametrize(
    ("function", "of_numpy", "arguments"),
    [(exp, np.exp, (0.7,)), (sqrt, np.sqrt, (0.7,)), (atan2, np.arctan2, (0.3, -0.7))],
    ids=["exp", "sqrt", "atan2"],
)
def test_functions_of_scalars_keep_floats_and_take_arrays(function, of_numpy, arguments):
    """A float of Python costs a tenth of numpy's."""
    assert type(function(*arguments)) is float
    assert_allclose(function(*arguments), of_numpy(*arguments), rtol=1e-15)
    arrays = [np.array((value, 2.0 * value)) for value in arguments]
    assert_array_equal(function(*arrays), of_numpy(*arrays))
    assert_array_equal(function(arrays[0], *arguments[1:]), of_numpy(arrays[0], *arguments[1:]))
    assert_array_equal(function(*arguments[:-1], arrays[-1]), of_numpy(*arguments[:-1], arrays[-1]))


def test_where_chooses_numbers_and_tuples_and_rows():
    assert (where(True, 1.0, 2.0), where(False, 1.0, 2.0), where(False, (1, 2), (3, 4))) == (1.0, 2.0, (3, 4))
    assert_array_equal(where(np.array((True, False)), 1.0, np.array((2.0, 3.0))), (1.0, 3.0))


def test_an_inverse_comes_with_its_condition_number():
    A = np.array([[2.0, 1.0], [0.5, 3.0]])
    found, condition = inverse(A)
    assert_allclose(found @ A, np.eye(2), atol=1e-15)
    assert_allclose(condition, np.linalg.norm(A) * np.linalg.norm(np.linalg.inv(A)), rtol=1e-14)
    found, condition = inverse(np.ones((2, 2)))
    assert (found.tolist(), condition) == ([[np.inf] * 2] * 2, np.inf)


@pytest.mark.parametrize(("value", "is_refused"), [(1.0, False), (3.0, True), (np.nan, True)])
def test_what_is_not_less_than_its_limit_is_refused_with_the_value(value, is_refused):
    if not is_refused:
        require_less(value, 2.0, ValueError)
        return
    with pytest.raises(ValueError, match="3" if value == 3.0 else "nan") as caught:
        require_less(value, 2.0, ValueError)
    assert type(caught.value.args[0]) is float


def test_a_weight_is_mass_times_gravity_without_a_moment():
    assert weight_wrench(2.0, (1, -3, -9.5)).tolist() == [2.0, -6.0, -19.0, 0.0, 0.0, 0.0]


def test_a_pose_without_an_orientation_is_a_translation():
    X = make_pose((1.0, 2.0, 3.0))
    assert np.array_equal(X[:3, :3], np.eye(3))
    assert X[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("name", ["full", "planar", "positional"])
def test_twists_and_wrenches_move_to_another_point_of_the_body(name):
    """V_Q = v + w x r, A^-T is the shift of the wrench, and power stays; positional rows see no rotation."""
    rows, rng = task_rows(name), np.random.default_rng(5)
    V, F, r = (
        rows.expand(rng.normal(size=rows.size)),
        rows.expand(rng.normal(size=rows.size)),
        rng.normal(size=3),
    )
    if name == "planar":
        r[2] = 0.0
    A, back = rows.twist_shift(r), rows.twist_shift(-r)
    there = V + np.concatenate((np.cross(V[3:], r), np.zeros(3)))
    assert_allclose(A @ rows.select(V), rows.select(there), atol=1e-14)
    assert_allclose(A @ back, np.eye(rows.size), atol=1e-14)
    assert_allclose(back.T @ rows.select(F), rows.select(shift_wrench(F, -r)), atol=1e-14)
    assert_allclose((back.T @ rows.select(F)) @ (A @ rows.select(V)), F @ V, atol=1e-13)


@pytest.mark.parametrize(("joints", "has_fewer_rows"), [(2, False), (3, True), (5, True)])
def test_an_arm_with_too_few_joints_is_told_of_fewer_rows_if_three_would_do(joints, has_fewer_rows):
    text = joint_shortage(joints, 6)
    assert text.startswith(f"{joints} joints, 6 task rows")
    assert ("positional" in text) is has_fewer_rows


@pytest.mark.parametrize(("joints", "rows", "kind"), [(5, 6, "hinge"), (4, 6, "cylinder"), (3, 6, "ball")])
def test_an_arm_with_too_few_joints_is_told_of_a_grasp_that_holds_as_many_rows(joints, rows, kind):
    assert f"joint of kind '{kind}' ({joints} rows)" in joint_shortage(joints, rows)
    assert "grasp" not in joint_shortage(2, 6)
    assert "grasp" not in joint_shortage(2, 3)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-6, np.pi - 1e-12])
def test_log3_and_exp3_are_rotation_vector_and_matrix_at_all_angles(angle):
    """Against scipy's, which goes through a normalised quaternion."""
    rng = np.random.default_rng(5)
    diagonals = 1.0 - np.eye(3)
    for direction in [*rng.normal(size=(20, 3)), *np.eye(3), *-np.eye(3), *diagonals, *-diagonals]:
        vector = angle * direction / np.linalg.norm(direction)
        R = Rotation.from_rotvec(vector).as_matrix()
        assert_allclose(log3(R), vector, rtol=0, atol=1e-15 * (1 + angle))
        assert_allclose(exp3(vector), R, rtol=0, atol=1e-15)


def test_rotations_have_the_bits_of_scipys_and_many_logs_those_of_each():
    rng = np.random.default_rng(6)
    angles = np.concatenate((rng.uniform(-4.0, 4.0, (200, 3)), 0.5 * np.pi * rng.integers(-2, 3, (50, 3))))
    R = np.stack([rotation_from_rpy(each) for each in angles])
    assert_array_equal(R, Rotation.from_euler("xyz", angles).as_matrix())
    q = Rotation.from_matrix(R[:200]).as_quat()
    assert_array_equal(quaternions(R[:200]), q)
    assert_array_equal(quaternions(R[:200].reshape(5, 40, 3, 3)), q.reshape(5, 40, 4))
    assert_array_equal(quaternions(R[7]), q[7])
    assert_allclose(log3(R[:200].reshape(5, 40, 3, 3)), log3(R[:200]).reshape(5, 40, 3), rtol=0, atol=0)
    assert_allclose(log3(R), [log3(each) for each in R], rtol=0, atol=2e-15)


def test_log3_at_half_a_turn_is_one_of_the_two_rotation_vectors():
    for R in (np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])):
        assert_allclose(np.abs(log3(R)), np.pi * (np.diag(R) > 0.0), rtol=0, atol=1e-15)
