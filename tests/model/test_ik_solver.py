"""Steps of the inverse-kinematics solver against their definitions: gap, damped step, null space, path."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from close import assert_close
from test_branches import ARMS

from coop_pin.description.cell.arm import Arm
from coop_pin.model import ArmModel
from coop_pin.model.ik_solver import CLOSED, IKSolution, IKSolver

SPARE = {"adept": False, "ur5": False, "kinova": False, "panda": True, "xarm7": True}
FAR = pin.SE3(pin.exp3(np.array((0.7, -0.4, 0.9))), np.array((2.0, 0.5, 0.8)))
"""Out of reach of every arm."""
NEARBY = pin.SE3(FAR.rotation, np.array((1.0, 0.5, 0.4)))
"""Just out of reach of the UR5, so that distance and angle compete."""
ABOVE = pin.SE3(FAR.rotation, np.array((0.6, 0.6, 0.5)))
"""Half a metre off the plane of the planar arm, and tilted."""


class Recorded(IKSolver):
    """A solver that keeps the arguments of its steps, and may refuse to solve."""

    def __init__(self, arm):
        self.starts, self.targets, self.options, self.halvings, self.drawn = [], [], [], [], 0
        self.refuse = ()
        super().__init__(arm)

    def solve(self, target, q, **options):
        self.starts.append(q)
        self.targets.append(target)
        self.options.append(options)
        if len(self.starts) in self.refuse:
            return IKSolution(q, np.ones(6))
        return super().solve(target, q, **options)

    def follow_step(self, last, target, q, halvings=6):
        self.halvings.append(halvings)
        return super().follow_step(last, target, q, halvings)

    def null_space_descent(self, *arguments, **options):
        self.drawn += 1
        return super().null_space_descent(*arguments, **options)


@pytest.fixture
def looks(monkeypatch):
    """Configurations at which the poses and the Jacobian of an arm are computed."""
    seen, compute = [], pin.computeJointJacobians
    monkeypatch.setattr(
        pin, "computeJointJacobians", lambda model, data, q: seen.append(q) or compute(model, data, q)
    )
    return seen


@pytest.fixture(scope="module")
def arms():
    return {name: ArmModel(*parts, name=name) for name, parts in ARMS.items()}


def configuration(arm):
    """One within the limits, at no limit and not singular."""
    limits = arm.limits
    lower, upper = np.maximum(limits.lower, -2.0), np.minimum(limits.upper, 2.0)
    return limits.joints.configuration(
        lower + (upper - lower) * (0.35 + 0.3 * np.sin(np.arange(arm.nv)) ** 2)
    )


def target_at(solver, arm, q):
    return solver.tip_target(arm.payload_pose(q))


def linearised(arm, target, q, angle_weight=1.0):
    """The weighted gap [p, log R] of X_EE_d in tip axes, and A = -d(gap)/dv."""
    J = pin.computeFrameJacobian(
        arm.model, arm.model.createData(), q, arm.model.getFrameId("tip"), pin.ReferenceFrame.LOCAL
    )
    X = pin.SE3(arm.tip_pose(q)).actInv(target)
    weights = np.repeat((1.0, angle_weight), 3)
    gap = np.concatenate((X.translation, pin.log3(X.rotation)))
    A = np.vstack((J[:3] - pin.skew(X.translation) @ J[3:], pin.Jlog3(X.rotation.T) @ J[3:]))
    return weights * gap, weights[:, None] * A


def weighted_slope(arm, target, q, angle_weight):
    """The weighted gap, and the slope of half its square without the joints that their limits stop."""
    gap, A = linearised(arm, target, q, angle_weight)
    slope = A.T @ gap
    return gap, np.where(arm.limits.at_limit(q, slope), 0.0, slope)


def null_space_step(arm, q, pull, limited=True):
    """The first step of a descent from a solution that is pulled so little that the step is whole."""
    solver, small = Recorded(arm), 0.1 / np.linalg.norm(pull)
    near = pin.integrate(arm.model, q, small * pull)
    solver.null_space_descent(target_at(solver, arm, q), q, near, limited=limited, steps=1)
    return pin.difference(arm.model, q, solver.starts[0] if solver.starts else q) / small


def self_motion_of(arm, q):
    """The motion of an arm with one spare joint that keeps its tip, of length one."""
    return np.linalg.svd(linearised(arm, pin.SE3(arm.tip_pose(q)), q)[1])[2][6]


def beyond_a_limit(arm):
    """A configuration with a joint at its limit, and one reached from it by self-motion through the limit."""
    q = configuration(arm)
    self_motion = self_motion_of(arm, q)
    joint = int(np.argmax(np.abs(self_motion)))
    q[joint] = arm.limits.upper[joint]
    self_motion = self_motion_of(arm, q)
    return joint, q, q + 0.2 * self_motion * np.sign(self_motion[joint])


@pytest.mark.parametrize("name", ["adept", "ur5", "kinova", "panda"])
@pytest.mark.parametrize("angle_weight", [1.0, 0.01])
def test_the_gap_is_the_target_seen_from_the_tip_and_its_matrix_its_negative_derivative(
    arms, name, angle_weight
):
    arm = arms[name]
    solver, q = IKSolver(arm), configuration(arm)
    unmoved = {"limited": False, "angle_weight": angle_weight, "steps": 0}
    expected, A = linearised(arm, FAR, q, angle_weight)
    weights = np.repeat((1.0, angle_weight), 3)
    assert_close(weights * solver.solve(FAR, q, **unmoved).gap, expected, atol=1e-14)
    h = 1e-6
    for joint, step in enumerate(h * np.eye(arm.nv)):
        after, before = (
            weights * solver.solve(FAR, pin.integrate(arm.model, q, s), **unmoved).gap for s in (step, -step)
        )
        assert_close(A[:, joint], -(after - before) / (2.0 * h), atol=1e-6)


@pytest.mark.parametrize("name", ["adept", "ur5", "kinova", "panda"])
@pytest.mark.parametrize("angle_weight", [1.0, 0.01])
@pytest.mark.parametrize("away", [0.02, 0.7])
def test_a_damped_step_minimises_the_remaining_gap_and_itself_and_moves_no_joint_far(
    arms, name, angle_weight, away
):
    """The first: (A^T A + lambda I) dq = A^T e with lambda = 1e-3, scaled down to 0.5 rad."""
    arm = arms[name]
    solver, q = IKSolver(arm), configuration(arm)
    target = target_at(solver, arm, pin.integrate(arm.model, q, away * np.cos(np.arange(arm.nv))))
    gap, A = linearised(arm, target, q, angle_weight)
    exact = np.linalg.solve(A.T @ A + 1e-3 * np.eye(arm.nv), A.T @ gap)
    expected = exact / max(1.0, np.abs(exact).max() / 0.5)
    found = solver.solve(target, q, limited=False, angle_weight=angle_weight, steps=1).q
    assert_close(pin.difference(arm.model, q, found), expected, atol=1e-12)


def test_which_arms_have_a_null_space(arms):
    assert {name: IKSolver(arm).is_redundant for name, arm in arms.items()} == SPARE


# ---------------------------------------------------------------- solve


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_a_solution_costs_one_look_and_its_neighbourhood_a_few_steps(arms, name, looks):
    """Convergence near a solution is quadratic: 0.2 rad, 4e-2, 2e-3, 4e-6, 2e-11, rounding."""
    arm = arms[name]
    solver, q = IKSolver(arm), configuration(arm)
    target = target_at(solver, arm, q)
    looks.clear()
    solution = solver.solve(target, q)
    assert len(looks) == 1
    np.testing.assert_array_equal(solution.q, q)
    near = pin.integrate(arm.model, q, 0.2 * np.cos(np.arange(arm.nv)))
    looks.clear()
    assert np.abs(solver.solve(target, near).gap).max() < 1e-13
    assert len(looks) <= 10


@pytest.mark.parametrize("options", [{}, {"angle_weight": 0.1}, {"limited": False}], ids=str)
def test_out_of_reach_no_joint_makes_the_weighted_gap_smaller(arms, options, looks):
    arm = arms["ur5"]
    solver = IKSolver(arm)
    looks.clear()
    solution = solver.solve(NEARBY, configuration(arm), **options)
    assert len(looks) < 200
    gap, slope = weighted_slope(arm, NEARBY, solution.q, options.get("angle_weight", 1.0))
    assert_close(solution.gap * np.repeat((1.0, options.get("angle_weight", 1.0)), 3), gap, atol=1e-14)
    assert np.linalg.norm(gap) > 0.02
    assert np.abs(slope).max() < 1e-4
    looks.clear()
    solver.solve(NEARBY, solution.q, **options)
    assert len(looks) < 40


def test_a_start_beyond_the_limits_is_kept_only_without_limits(arms):
    arm = arms["panda"]
    solver, q = IKSolver(arm), configuration(arm)
    q[3] = arm.limits.upper[3] + 0.02
    target = target_at(solver, arm, q)
    np.testing.assert_array_equal(solver.solve(target, q, limited=False).q, q)
    assert not arm.limits.violation(solver.solve(target, q).q).any()
    assert not arm.limits.violation(solver.solve(target, q, steps=0).q).any()


@pytest.mark.parametrize(("name", "target", "least"), [("adept", ABOVE, 1e-7), ("ur5", FAR, 4e-6)])
def test_the_nearest_configuration_has_the_least_distance_and_then_the_least_angle(arms, name, target, least):
    """The slope of |p|^2 + 1e-6 |log R|^2 vanishes to a share of its smaller term."""
    solver = IKSolver(arms[name])
    solution = solver.nearest(target, configuration(arms[name]))
    assert np.abs(weighted_slope(arms[name], target, solution.q, 1e-3)[1]).max() < least


# ---------------------------------------------------------------- null space


def test_a_null_space_step_is_the_part_of_the_pull_that_does_not_move_the_tip(arms):
    arm = arms["panda"]
    q, pull = configuration(arm), np.cos(1.0 + np.arange(7.0))
    self_motion = self_motion_of(arm, q)
    for limited in (True, False):
        step = null_space_step(arm, q, pull, limited)
        assert_close(step, self_motion * (self_motion @ pull), atol=1e-13)


SNAKE = "".join(
    f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
    f'<origin xyz="{0.3 if i else 0.0} 0 0"/><axis xyz="0 0 1"/>'
    '<limit lower="-2" upper="2" effort="9" velocity="9"/></joint>'
    f'<link name="l{i + 1}"><inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    for i in range(6)
)


@pytest.fixture(scope="module")
def snake(tmp_path_factory):
    """Six hinges in a plane, three of them spare."""
    path = tmp_path_factory.mktemp("snake") / "snake.urdf"
    path.write_text(f'<robot name="snake"><link name="l0"/>{SNAKE}</robot>')
    return ArmModel(Arm(urdf=str(path), tip="l6"))


def test_a_solve_gives_up_where_no_step_comes_nearer(snake, looks):
    """Stretched towards its target: the damping grows from 1e-3 to 1e8 by decades."""
    solver, q = IKSolver(snake), np.zeros(6)
    beyond = pin.SE3(snake.tip_pose(q)) * pin.SE3(np.eye(3), np.array((0.2, 0.0, 0.0)))
    looks.clear()
    np.testing.assert_array_equal(solver.solve(beyond, q).q, q)
    assert 10 <= len(looks) <= 15


def test_joints_at_their_limits_take_no_part_in_a_null_space_step_that_would_exceed_them(snake):
    """The step is the projection of the pull onto the self-motions of the joints that are left."""
    q = np.array((0.3, 2.0, -0.8, -2.0, 0.9, 0.4))
    A = linearised(snake, pin.SE3(snake.tip_pose(q)), q)[1]
    stopped_sets = set()
    for pull in np.random.default_rng(1).normal(size=(20, 6)):
        step = null_space_step(snake, q, pull)
        stopped = np.zeros(6, dtype=bool)
        for _ in range(3):
            free = np.flatnonzero(~stopped)
            basis = np.linalg.svd(A[:, free])[2][np.linalg.matrix_rank(A[:, free], tol=1e-9) :]
            expected = np.zeros(6)
            expected[free] = basis.T @ (basis @ pull[free])
            stopped |= ((q >= 2.0) & (expected > 0.0)) | ((q <= -2.0) & (expected < 0.0))
        assert_close(step, expected, atol=1e-12)
        stopped_sets.add(tuple(stopped))
        whole = np.linalg.svd(A)[2][3:]
        assert_close(null_space_step(snake, q, pull, False), whole.T @ (whole @ pull), atol=1e-12)
    assert len(stopped_sets) == 4  # none, either, both


def test_steps_in_the_null_space_are_whole_or_0_3_rad_long(arms):
    arm = arms["panda"]
    solver, q = Recorded(arm), configuration(arm)
    target = target_at(solver, arm, q)
    self_motion = self_motion_of(arm, q)
    solver.null_space_descent(target, q, q + 0.9 * self_motion, steps=1)
    solver.null_space_descent(target, q, q + 0.1 * self_motion, steps=1)
    assert_close([np.linalg.norm(start - q) for start in solver.starts], [0.3, 0.1], atol=1e-12)


def test_a_refused_step_is_followed_by_a_quarter_and_accepted_ones_double_up_to_the_whole(arms):
    """The first two are refused; each step starts from what the steps before it reached."""
    arm = arms["panda"]
    solver, q = Recorded(arm), configuration(arm)
    target = target_at(solver, arm, q)
    near = q + 0.1 * self_motion_of(arm, q)
    solver.refuse = (1, 2)
    for steps, gain in enumerate((1, 1 / 4, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1, 1)):
        solver.starts.clear()
        before = solver.null_space_descent(target, q, near, steps=steps)
        solver.starts.clear()
        solver.null_space_descent(target, q, near, steps=steps + 1)
        whole = null_space_step(arm, before, near - before)
        assert_close(solver.starts[-1] - before, gain * whole, atol=1e-12)
        assert len(solver.starts) == steps + 1


def test_a_descent_ends_soon_where_every_step_is_refused_and_takes_none_that_leads_away(arms):
    arm = arms["panda"]
    solver, q = Recorded(arm), configuration(arm)
    target = target_at(solver, arm, q)
    near = pin.integrate(arm.model, q, 0.2 * np.cos(np.arange(7.0)))
    solver.refuse = range(100)
    np.testing.assert_array_equal(solver.null_space_descent(target, q, near), q)
    assert 9 <= len(solver.starts) <= 12

    def away(_target, _q, **_options):
        return IKSolution(q - (near - q), np.zeros(6))

    solver.solve = away
    np.testing.assert_array_equal(solver.null_space_descent(target, q, near), q)


def test_a_descent_stays_within_the_limits_unless_told(arms):
    arm = arms["panda"]
    solver, (joint, q, near) = IKSolver(arm), beyond_a_limit(arm)
    target = target_at(solver, arm, q)
    np.testing.assert_array_equal(solver.null_space_descent(target, q, near), q)
    beyond = solver.null_space_descent(target, q, near, limited=False)
    assert arm.limits.violation(beyond)[joint] > 0.01
    assert solver.distance(beyond, near) < 0.2 * solver.distance(q, near)


# ---------------------------------------------------------------- paths


def turned_about(arm, solver, q, joint, angle):
    """Tip pose after a turn of one joint, and the configuration there."""
    moved = q.copy()
    moved[joint] += angle
    return target_at(solver, arm, moved), moved


def test_a_step_of_a_path_that_moves_no_joint_by_0_2_rad_is_solved_once(arms):
    arm = arms["ur5"]
    q = configuration(arm)
    for angle, once in ((0.19, True), (0.21, False)):
        solver = Recorded(arm)
        target, moved = turned_about(arm, solver, q, 4, angle)
        found = solver.follow_step(target_at(solver, arm, q), target, q)
        assert_close(found.q, moved, atol=1e-9)
        assert (len(solver.starts) == 1) is once
        assert solver.options == [{"limited": False, "steps": 40}] * len(solver.starts)


def test_a_long_step_is_halved_until_none_is_long_and_each_half_starts_where_the_last_ended(arms):
    """0.7 rad about one joint: halves of 0.35 are long too, quarters are not."""
    arm = arms["ur5"]
    solver, q = Recorded(arm), configuration(arm)
    target, moved = turned_about(arm, solver, q, 4, 0.7)
    last = target_at(solver, arm, q)
    assert_close(solver.follow_step(last, target, q).q, moved, atol=1e-9)
    assert solver.halvings == [6, 5, 4, 4, 5, 4, 4]
    middle = pin.SE3.Interpolate(last, target, 0.5)
    quarters = [pin.SE3.Interpolate(last, middle, 0.5), middle, pin.SE3.Interpolate(middle, target, 0.5)]
    expected = [target, middle, quarters[0], middle, target, quarters[2], target]
    for found, pose in zip(solver.targets, expected, strict=True):
        assert_close(found.homogeneous, pose.homogeneous, atol=1e-14)
    np.testing.assert_array_equal(solver.starts[:3], [q] * 3)
    assert all(np.abs(b - a).max() < 0.2 for a, b in itertools.pairwise(solver.starts[2:4]))


def test_with_no_halvings_left_a_long_step_that_closes_is_taken_and_one_that_does_not_ends_nearest(arms):
    arm = arms["ur5"]
    solver, q = Recorded(arm), configuration(arm)
    target, moved = turned_about(arm, solver, q, 4, 0.7)
    found = solver.follow_step(target_at(solver, arm, q), target, q, 0)
    assert_close(found.q, moved, atol=1e-9)
    assert len(solver.starts) == 1
    solver.options.clear()
    solver.follow_step(FAR, FAR, q, 0)
    assert solver.options == [
        {"limited": False, "steps": 40},
        {"limited": False, "angle_weight": 1e-3, "steps": 40},
    ]


def test_a_step_whose_half_does_not_close_is_not_tried_from_there(arms):
    arm = arms["ur5"]
    solver, q = Recorded(arm), configuration(arm)
    solver.follow_step(FAR, FAR, q, 1)
    assert solver.halvings == [1, 0]


def test_after_a_pose_out_of_reach_the_next_step_is_not_halved_and_spare_joints_rest(arms):
    arm = arms["panda"]
    solver, q = Recorded(arm), configuration(arm)
    far = (FAR * solver.tip_target(np.eye(4)).inverse()).homogeneous
    solver.follow([far, far], q, q)
    assert solver.halvings == [6, 5, 4, 3, 2, 1, 0, 0]
    assert solver.drawn == 0
    solver.follow([arm.payload_pose(q)] * 2, q, q)
    assert solver.halvings[8:] == [6, 6]
    assert solver.drawn == 2


def test_a_followed_arm_without_spare_joints_is_not_drawn_and_one_with_them_is_beyond_its_limits(arms):
    solver, q = Recorded(arms["ur5"]), configuration(arms["ur5"])
    solver.follow([arms["ur5"].payload_pose(q)] * 2, q, q + 0.3)
    assert solver.drawn == 0
    arm = arms["panda"]
    solver, (joint, q, near) = IKSolver(arm), beyond_a_limit(arm)
    found = solver.follow([arm.payload_pose(q)] * 2, q, near)
    assert arm.limits.violation(found[-1].q)[joint] > 0.01
    assert np.abs(found[-1].gap).max() < CLOSED
