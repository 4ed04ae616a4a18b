"""Inverse kinematics: the solution is on the branch of the posture, or the error has the gap."""

import numpy as np
import pytest
from cells import SCENARIOS, cell_and_start, planar_scenario
from close import assert_close
from malformed_urdf import arm as urdf_text
from numpy.testing import assert_allclose

from coop_pin.base.errors import OutOfRangeError, ShapeError, UnreachablePoseError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, pose_error
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.feasibility import cell_summary
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel, CellArm, ik_branches
from coop_pin.model.ik_solver import IKSolver
from coop_pin.model.inverse_kinematics import solve_ik

LENGTHS = 0.425, 0.375
ELBOW = {"planar": 1, "spatial": 2}


def arm_of(name, key):
    cell, start = cell_and_start(name)
    return CellArm(cell, key), start, np.array(cell.arms[key].posture)


@pytest.mark.parametrize("key", ["left", "right"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_angles_hold_the_payload_at_the_pose(name, key):
    arm, start, posture = arm_of(name, key)
    q = solve_ik(arm, start, posture=posture)
    assert_close(pose_error(arm.payload_pose(q), start), np.zeros(6), atol=1e-9)


@pytest.mark.parametrize("elbow", [1.0, -1.0])
@pytest.mark.parametrize("key", ["left", "right"])
def test_the_posture_chooses_the_elbow_of_the_planar_arm_and_the_angles_are_the_closed_form(key, elbow):
    """Elbow +1 means q2 > q1 in absolute angles (relative angle positive), by the law of cosines."""
    arm, start, _ = arm_of("planar", key)
    scenario = planar_scenario()
    tip = start @ scenario.cell.grasps[key].matrix
    x, y = tip[:2, 3] - np.array(scenario.cell.arms[key].base.xyz[:2])
    l_1, l_2 = LENGTHS
    relative = elbow * np.arccos((x * x + y * y - l_1**2 - l_2**2) / (2.0 * l_1 * l_2))
    first = np.arctan2(y, x) - np.arctan2(l_2 * np.sin(relative), l_1 + l_2 * np.cos(relative))
    base_yaw = scenario.cell.arms[key].base.rpy[2]
    expected = np.array([first - base_yaw, relative, np.arctan2(tip[1, 0], tip[0, 0]) - first - relative])
    near = np.array([first - base_yaw, elbow * 1.0, 0.0])
    q = solve_ik(arm, start, posture=near)
    assert np.sign(q[1]) == elbow
    assert_close(np.exp(1j * q), np.exp(1j * expected), atol=1e-8)


@pytest.mark.parametrize("elbow", [1.0, -1.0])
def test_the_posture_chooses_the_elbow_of_the_spatial_arm(elbow):
    arm, start, posture = arm_of("spatial", "left")
    up = solve_ik(arm, start, posture=posture)
    down = up.copy()
    down[1:4] = (up[1] + up[2], -up[2], up[3] + up[2])
    q = solve_ik(arm, start, posture=up if elbow > 0.0 else down)
    assert np.sign(q[ELBOW["spatial"]]) == elbow * np.sign(up[ELBOW["spatial"]])
    assert_close(pose_error(arm.payload_pose(q), start), np.zeros(6), atol=1e-9)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)], ids=["planar", "spatial"])
def test_an_arm_with_one_joint_has_jacobians_of_one_column(axis, tmp_path):
    """Pinocchio returns them flat. J = [n x p; n], and X(q) = exp(n q) X(0)."""
    joint = f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
    (tmp_path / "arm.urdf").write_text(urdf_text(joint_2='<joint name="two" type="fixed">', axis_1=joint))
    arm = Arm.from_urdf(tmp_path / "arm.urdf", tip="c")
    grasp = Pose(xyz=(-0.4, 0.1, 0.05), rpy=(0.3, -0.2, 0.1))
    cell = Cell(arms={"only": arm}, payload=Payload.box(1.0, (0.1, 0.2, 0.3)), grasps={"only": grasp})
    model, chain = CellArm(cell, "only"), CellChain(cell)
    X = model.payload_pose([0.4])
    n = make_pose((0.0, 0.0, 0.5), (0.0, 0.0, 1.5))[:3, :3] @ axis
    assert_allclose(solve_ik(model, X, posture=[0.0]), [0.4], atol=1e-8)
    assert_allclose(chain.configuration(X), [0.4], atol=1e-8)
    expected = np.concatenate((np.cross(n, X[:3, 3] - (0.0, 0.0, 0.5)), n))[:, None]
    for J in (model.payload_jacobian([0.4]), chain.payload_jacobian([0.4])):
        assert_allclose(J, expected, atol=1e-12)
    assert cell_summary(cell, X).freedom == 1


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_posture_that_already_closes_is_kept(name):
    arm, start, posture = arm_of(name, "left")
    q = solve_ik(arm, start, posture=posture)
    assert_allclose(solve_ik(arm, start, posture=q), q, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_joint_stays_within_half_a_turn_of_the_posture(name):
    arm, start, posture = arm_of(name, "left")
    q = solve_ik(arm, start, posture=posture)
    assert np.abs(q - posture).max() <= np.pi + 1e-12
    assert_close(pose_error(arm.payload_pose(q), start), np.zeros(6), atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_same_question_gets_the_same_bits(name):
    arm, start, posture = arm_of(name, "right")
    first = solve_ik(arm, start, posture=posture)
    assert_allclose(solve_ik(arm_of(name, "right")[0], start, posture=posture), first, rtol=0, atol=0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_poses_that_an_arm_just_held_are_found_again_from_a_poor_posture(name):
    arm, _, posture = arm_of(name, "left")
    rng = np.random.default_rng(12)
    for _ in range(4):
        target = arm.payload_pose(posture + rng.uniform(-0.6, 0.6, arm.nq))
        q = solve_ik(arm, target, posture=np.zeros(arm.nq))
        assert_close(pose_error(arm.payload_pose(q), target), np.zeros(6), atol=1e-9)


@pytest.mark.parametrize("distance", [0.81, 1.2, 3.0])
def test_a_tip_straight_beyond_reach_misses_by_distance_minus_reach(distance):
    """The wrist makes up the angle; the descent leaves a little of it at almost no distance."""
    arm, _, posture = arm_of("planar", "left")
    X_PE = planar_scenario().cell.grasps["left"].matrix
    direction = 0.4
    X_WE = make_pose((distance * np.cos(direction), distance * np.sin(direction), 0.0), (0.0, 0.0, 1.0))
    with pytest.raises(UnreachablePoseError) as error:
        solve_ik(arm, X_WE @ np.linalg.inv(X_PE), posture=posture)
    assert error.value.arm == "left"
    assert error.value.distance >= distance - sum(LENGTHS)
    assert_allclose(error.value.distance, distance - sum(LENGTHS), rtol=0.01)
    assert error.value.angle < 0.3


@pytest.mark.parametrize("height", [0.01, 0.2])
def test_a_planar_arm_misses_a_lifted_payload_by_its_height(height):
    arm, start, posture = arm_of("planar", "left")
    lifted = start.copy()
    lifted[2, 3] = height
    with pytest.raises(UnreachablePoseError) as error:
        solve_ik(arm, lifted, posture=posture)
    assert_allclose(error.value.distance, height, rtol=1e-6)
    assert_close(error.value.angle, 0.0, atol=1e-6)


def test_a_planar_arm_misses_a_tilted_payload_by_its_angle():
    arm, start, posture = arm_of("planar", "left")
    with pytest.raises(UnreachablePoseError) as error:
        solve_ik(arm, start @ make_pose(rpy=(0.3, 0.0, 0.0)), posture=posture)
    assert_allclose(error.value.angle, 0.3, rtol=1e-3)
    assert error.value.distance < 1e-3


def test_no_angles_come_nearer_than_the_gap_that_a_spatial_arm_reports():
    """The gap is bounded from below by the maximum reach and from above by a stretched arm."""
    arm, _, posture = arm_of("spatial", "left")
    cell, _ = cell_and_start("spatial")
    shoulder = np.array(cell.arms["left"].base.xyz)
    rng = np.random.default_rng(0)
    reach = max(
        np.linalg.norm(arm.payload_pose(rng.uniform(-np.pi, np.pi, 6))[:3, 3] - shoulder)
        for _ in range(20000)
    )
    X_WP = make_pose(shoulder + np.array([2.5, 0.0, 0.5]), (0.3, 0.2, 0.1))
    distance = np.linalg.norm(X_WP[:3, 3] - shoulder)
    with pytest.raises(UnreachablePoseError, match="'left'") as error:
        solve_ik(arm, X_WP, posture=posture)
    assert distance - 1.05 * reach < error.value.distance < distance - 0.6 * reach


def test_bad_input_is_named():
    arm, start, posture = arm_of("planar", "left")
    with pytest.raises(ShapeError, match="X_WP"):
        solve_ik(arm, np.eye(3), posture=posture)
    with pytest.raises(ShapeError, match="posture of arm 'left'"):
        solve_ik(arm, start, posture=posture[:-1])
    with pytest.raises(OutOfRangeError, match="X_WP"):
        solve_ik(arm, np.full((4, 4), np.nan), posture=posture)


@pytest.mark.parametrize("name", SCENARIOS)
def test_remembered_solutions_are_copies_and_belong_to_one_grasp(name):
    arm, start, posture = arm_of(name, "right")
    first = solve_ik(arm, start, posture=posture)
    kept = first.copy()
    first += 1.0
    assert_allclose(solve_ik(arm, start, posture=posture), kept, rtol=0, atol=0)
    cell, _ = cell_and_start(name)
    grasp = np.array(cell.grasps["right"].matrix)
    grasp[:2, 3] *= 0.99
    other = ArmModel(cell.arms["right"], grasp, cell.gravity)
    assert np.abs(solve_ik(other, start, posture=posture) - kept).max() > 1e-6


@pytest.fixture
def starts(monkeypatch):
    """The configurations from which a solver starts."""
    found, solve = [], IKSolver.solve
    monkeypatch.setattr(IKSolver, "solve", lambda self, X, q: found.append(q) or solve(self, X, q))
    return found


@pytest.mark.parametrize(("search", "seeds"), [(solve_ik, 16), (ik_branches, 96)])
def test_a_search_starts_from_the_posture_from_twelve_around_it_and_from_seeds(search, seeds, starts):
    arm, start, posture = arm_of("planar", "left")
    search(arm, start, posture=posture + 0.0123)
    assert len(starts) == 1 + 12 + seeds
    np.testing.assert_array_equal(starts[0], posture + 0.0123)


def test_a_solution_is_remembered_for_every_model_of_the_same_arm(starts):
    (arm, start, posture), (same, _, _) = arm_of("planar", "left"), arm_of("planar", "left")
    first = solve_ik(arm, start, posture=posture + 0.0321)
    assert starts
    starts.clear()
    np.testing.assert_array_equal(solve_ik(same, start, posture=posture + 0.0321), first)
    assert starts == []
