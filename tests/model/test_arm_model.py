"""One arm alone: dynamics against themselves, kinematics against finite differences and yourdfpy."""

import malformed_urdf
import numpy as np
import pinocchio as pin
import pytest
from cells import planar_scenario, spatial_cell
from numpy.testing import assert_allclose

from coop_pin.base.errors import NameNotFoundError, OutOfRangeError, ShapeError, UrdfError
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, make_pose, pose_error, task_rows
from coop_pin.description.cell.arm import Arm
from coop_pin.description.urdf import find_urdf
from coop_pin.model import ArmModel, CellArm
from coop_pin.model.arm_model import ArmKinematics

# The planar arm gets a turned base and gravity in its plane, so that nothing vanishes by chance.
ARMS = {
    "planar": (
        planar_scenario().cell.arms["right"].replace(base=Pose(xyz=(1.0, 0.2, 0.0), rpy=(0.0, 0.0, 0.7))),
        make_pose((0.12, 0.03, 0.0)),
    ),
    "spatial": (spatial_cell().arms["right"], spatial_cell().grasps["right"].matrix),
}
GRAVITY = (1.0, -7.0, -6.0)


@pytest.fixture(params=ARMS)
def arm(request):
    description, X_PE = ARMS[request.param]
    return ArmModel(description, X_PE, GRAVITY)


def states(arm, count=20, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield rng.uniform(-np.pi, np.pi, arm.nq), rng.normal(size=arm.nv), rng.normal(size=arm.nv)


def test_mass_matrix_is_symmetric_and_positive_definite(arm):
    for q, _, _ in states(arm):
        M = arm.mass_matrix(q)
        assert_allclose(M, M.T, rtol=0, atol=0)
        assert np.linalg.eigvalsh(M)[0] > 1e-6


def test_aba_undoes_rnea_with_and_without_a_wrench(arm):
    F = np.array([3.0, -2.0, 1.0, 0.5, -0.4, 0.3])
    for q, v, a in states(arm):
        assert_allclose(arm.forward_dynamics(q, v, arm.inverse_dynamics(q, v, a)), a, rtol=1e-9, atol=1e-9)
        assert_allclose(
            arm.forward_dynamics(q, v, arm.inverse_dynamics(q, v, a, F), F), a, rtol=1e-9, atol=1e-9
        )


def test_inverse_dynamics_is_mass_times_acceleration_plus_nonlinear_effects_minus_the_wrench(arm):
    F = np.array([3.0, -2.0, 1.0, 0.5, -0.4, 0.3])
    for q, v, a in states(arm):
        expected = arm.mass_matrix(q) @ a + arm.nonlinear_effects(q, v) - arm.payload_jacobian(q).T @ F
        assert_allclose(arm.inverse_dynamics(q, v, a, F), expected, rtol=1e-12, atol=1e-11)


def test_mass_matrix_is_the_kinetic_energy_of_the_links(arm):
    """T is the sum of the kinetic energies of the links, from their own twists."""
    data = arm.model.createData()
    for q, v, _ in states(arm, 5):
        pin.forwardKinematics(arm.model, data, q, v)
        energy = sum(arm.model.inertias[j].vtiv(data.v[j]) for j in range(1, arm.model.njoints)) / 2.0
        assert_allclose(v @ arm.mass_matrix(q) @ v / 2.0, energy, rtol=1e-12)


def test_power_of_the_joint_forces_is_the_change_of_energy(arm):
    """d/dt (v^T M v / 2 + U) = v^T tau: it fails for a wrong Coriolis or gravity term."""
    data, h = arm.model.createData(), 1e-5

    def energy(q, v):
        return v @ arm.mass_matrix(q) @ v / 2.0 + pin.computePotentialEnergy(arm.model, data, q)

    for q, v, a in states(arm, 5):
        rate = (energy(q + h * v, v + h * a) - energy(q - h * v, v - h * a)) / (2.0 * h)
        assert_allclose(v @ arm.inverse_dynamics(q, v, a), rate, rtol=1e-7, atol=1e-6)


def test_gravity_pulls_as_and_where_it_was_asked_to(arm):
    """h(q, 0) = -m g . d(centre of mass)/dq, with the centre of mass by kinematics alone."""
    data, h = arm.model.createData(), 1e-6
    mass = sum(inertia.mass for inertia in list(arm.model.inertias)[1:])
    for q, _, _ in states(arm, 5):
        slopes = [
            (pin.centerOfMass(arm.model, data, q + d) - pin.centerOfMass(arm.model, data, q - d)) / (2 * h)
            for d in h * np.eye(arm.nv)
        ]
        assert_allclose(
            arm.nonlinear_effects(q, np.zeros(arm.nv)),
            -mass * np.array(slopes) @ GRAVITY,
            rtol=1e-7,
            atol=1e-6,
        )


def test_payload_jacobian_is_the_derivative_of_the_payload_pose(arm):
    h = 1e-6
    for q, _, _ in states(arm):
        columns = [
            pose_error(arm.payload_pose(q + d), arm.payload_pose(q - d)) / (2.0 * h)
            for d in h * np.eye(arm.nv)
        ]
        assert_allclose(arm.payload_jacobian(q), np.array(columns).T, rtol=0, atol=1e-8)


def test_acceleration_bias_is_the_derivative_of_the_twist_at_constant_rates(arm):
    h = 1e-5
    for q, v, _ in states(arm):
        twists = [arm.payload_jacobian(q + sign * h * v) @ v for sign in (1.0, -1.0)]
        assert_allclose(
            arm.payload_acceleration_bias(q, v), (twists[0] - twists[1]) / (2.0 * h), rtol=0, atol=1e-7
        )


def test_payload_sits_at_the_tip_as_the_grasp_says(arm):
    X_PE = next(
        X for description, X in ARMS.values() if description.urdf == ("ur5" if arm.nv == 6 else "adept_3dof")
    )
    for q, _, _ in states(arm, 5):
        assert_allclose(arm.payload_pose(q) @ X_PE, arm.tip_pose(q), rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ARMS)
def test_tip_pose_is_what_yourdfpy_says(name):
    import yourdfpy

    description, X_PE = ARMS[name]
    arm = ArmModel(description, X_PE)
    robot = yourdfpy.URDF.load(str(find_urdf(description.urdf).path), load_meshes=False)
    joints = [f"arm/{joint}" for joint in robot.actuated_joint_names]
    order = [int(arm.model.idx_qs[arm.model.getJointId(joint)]) for joint in joints]
    for q, _, _ in states(arm):
        robot.update_cfg(q[order])
        expected = description.base.matrix @ robot.get_transform(description.tip)
        assert_allclose(arm.tip_pose(q), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_the_base_moves_the_arm_as_one_body(name):
    description, X_PE = ARMS[name]
    at_origin = ArmModel(description.replace(base=Pose()), X_PE)
    for q, _, _ in states(at_origin, 3):
        assert_allclose(
            ArmModel(description, X_PE).payload_pose(q),
            description.base.matrix @ at_origin.payload_pose(q),
            atol=1e-13,
        )


@pytest.mark.parametrize("name", ARMS)
def test_a_controllers_kinematics_are_the_arms_own_without_any_inertia(name):
    description, X_PE = ARMS[name]
    arm = ArmModel(description, X_PE)
    rows = task_rows("planar" if name == "planar" else "full")
    kinematics = ArmKinematics(description, X_PE, rows)
    for q, v, _ in states(arm, 5):
        view = kinematics.view(q)
        assert_allclose(view.pose, arm.payload_pose(q), rtol=0, atol=1e-14)
        assert_allclose(
            view.jacobian @ (arm.drive @ v), rows.select(arm.payload_jacobian(q) @ v), rtol=0, atol=1e-13
        )
    assert all(inertia.mass == 0.0 and not inertia.inertia.any() for inertia in kinematics.model.inertias)
    assert not kinematics.model.gravity.vector.any()


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_believes_in_its_calibration_error(name):
    """It takes its tip to be at X_WE C; the payload it computes hangs from there by the true grasp."""
    description, X_PE = ARMS[name]
    wrong = Pose(xyz=(1e-3, -2e-3, 0.0), rpy=(0.0, 0.0, 0.01))
    truth, rows = ArmModel(description, X_PE), task_rows("full")
    view = ArmKinematics(description.override({"calibration_error.tip": wrong}), X_PE, rows)
    for q, _, _ in states(truth, 3):
        expected = truth.tip_pose(q) @ wrong.matrix @ inverse_pose(X_PE)
        assert_allclose(view.view(q).pose, expected, rtol=0, atol=1e-14)


def test_answers_do_not_change_when_the_model_is_asked_again(arm):
    (q, v, a), (q_2, v_2, a_2) = states(arm, 2)
    questions = [
        lambda q, _v, _a: arm.mass_matrix(q),
        lambda q, v, _a: arm.nonlinear_effects(q, v),
        lambda q, v, a: arm.forward_dynamics(q, v, a),
        lambda q, v, a: arm.inverse_dynamics(q, v, a),
        lambda q, _v, _a: arm.tip_pose(q),
        lambda q, _v, _a: arm.payload_pose(q),
        lambda q, _v, _a: arm.payload_jacobian(q),
        lambda q, v, _a: arm.payload_acceleration_bias(q, v),
    ]
    first = [ask(q, v, a) for ask in questions]
    kept = [answer.copy() for answer in first]
    for ask in questions:
        ask(q_2, v_2, a_2)
    for answer, copy, ask in zip(first, kept, questions, strict=True):
        assert_allclose(answer, copy, rtol=0, atol=0)
        assert_allclose(ask(q, v, a), copy, rtol=0, atol=0)


@pytest.mark.parametrize("name", ARMS)
def test_a_wrong_tip_is_named_with_a_suggestion(name):
    description, _ = ARMS[name]
    wrong = description.tip[:-1] + "x"
    with pytest.raises(NameNotFoundError, match=wrong) as error:
        ArmModel(description.replace(tip=wrong))
    assert description.tip in str(error.value)
    assert description.tip in error.value.known


def test_a_tip_that_is_like_no_frame_is_told_the_links_from_the_end_of_the_arm():
    with pytest.raises(NameNotFoundError, match="known: 'tip', "):
        ArmModel(Arm.from_urdf("adept_3dof", tip="xyzzy"))


def test_a_missing_urdf_has_its_own_error():
    with pytest.raises(UrdfError, match="no_such_arm"):
        ArmModel(Arm(urdf="no_such_arm", tip="tip"))


def test_a_locked_joint_may_have_the_name_of_a_link():
    """As the gripper of an SO-100, whose link and joint are both named gripper."""
    whole = ArmModel(Arm(urdf="so100", tip="gripper"))
    reduced = ArmModel(Arm(urdf="so100", tip="gripper", locked={"gripper": 0.3}))
    q = np.array([0.1, 0.2, -0.3, 0.4, 0.5])
    assert_allclose(reduced.tip_pose(q), whole.tip_pose(np.append(q, 0.3)), rtol=0, atol=1e-15)
    angles = {"shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"}
    assert set(reduced.limits.joints.names) == angles


def test_an_unknown_tip_names_the_arm_and_its_urdf():
    with pytest.raises(NameNotFoundError, match=r"'tool0'.*'xarm7'.*arm 'left'"):
        ArmModel(Arm(urdf="xarm7", tip="tool0"), name="left")


INERTIAS = {
    "nothing": "",
    "a point mass on the axis": '<inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0"'
    ' izz="0"/></inertial>',
}


@pytest.mark.filterwarnings("ignore::coop_pin.base.errors.UrdfWarning")
@pytest.mark.parametrize("inertial", INERTIAS.values(), ids=INERTIAS)
def test_a_joint_that_moves_no_inertia_is_refused_unless_it_is_locked(inertial, tmp_path):
    """Its mass matrix is singular, whatever the configuration."""
    file = tmp_path / "arm.urdf"
    file.write_text(
        malformed_urdf.arm(
            link_c=f'<link name="c">{inertial}</link>',
            joint_2=malformed_urdf.PARTS["joint_2"].replace("prismatic", "revolute"),
        )
    )
    with pytest.raises(UrdfError, match="'two'") as caught:
        ArmModel(Arm(urdf=str(file), tip="c"))
    assert caught.value.names == ("two",)
    locked = ArmModel(Arm(urdf=str(file), tip="c", locked={"two": 0.0}))
    assert locked.nv == 1
    assert locked.mass_matrix(np.zeros(1))[0, 0] > 0.0


@pytest.mark.parametrize("argument", ["q", "v", "tau", "F_EP_W"])
def test_a_wrong_shape_or_a_nan_is_named(arm, argument):
    sizes = {"q": arm.nq, "v": arm.nv, "tau": arm.nv, "F_EP_W": 6}
    good = {name: np.zeros(size) for name, size in sizes.items()}
    with pytest.raises(ShapeError, match=f"^{argument} has shape") as shape:
        arm.forward_dynamics(**good | {argument: np.zeros(sizes[argument] + 1)})
    assert shape.value.expected == (sizes[argument],)
    for bad in (np.nan, np.inf):
        value = np.zeros(sizes[argument])
        value[-1] = bad
        with pytest.raises(OutOfRangeError) as finite:
            arm.forward_dynamics(**good | {argument: value})
        assert (finite.value.name, finite.value.index) == (argument, (sizes[argument] - 1,))


def test_every_question_checks_its_arguments(arm):
    short, q = np.zeros(arm.nv - 1), np.zeros(arm.nq)
    for ask, name in (
        (lambda: arm.mass_matrix(short), "q"),
        (lambda: arm.nonlinear_effects(q, short), "v"),
        (lambda: arm.inverse_dynamics(q, q, short), "a"),
        (lambda: arm.payload_pose(short), "q"),
        (lambda: arm.tip_pose(short), "q"),
        (lambda: arm.payload_jacobian(short), "q"),
        (lambda: arm.payload_acceleration_bias(q, short), "v"),
    ):
        with pytest.raises(ShapeError) as error:
            ask()
        assert error.value.name == name
    with pytest.raises(ShapeError, match="gravity"):
        ArmModel(ARMS["planar"][0], gravity=(0.0, -9.81))
    with pytest.raises(ShapeError, match="X_PE"):
        ArmModel(ARMS["planar"][0], np.eye(3))


def chain_positions(arm, q):
    """Origins of the moving joints, then of the tip, in world axes."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return np.array([X.translation for X in (*data.oMi[1:], data.oMf[arm.model.getFrameId("tip")])])


@pytest.mark.parametrize("name", ARMS)
def test_kinematic_errors_of_base_joints_and_links_move_the_payload_that_an_arm_sees(name):
    """Base: X_WP' = X_WB C X_WB^-1 X_WP. Joints: the pose at q + offset. Links: p_E grows by sum e_j d_j."""
    description, X_PE = ARMS[name]
    truth, rows, rng = ArmModel(description, X_PE), task_rows("full"), np.random.default_rng(5)
    C, X_WB = Pose(xyz=(1e-3, 2e-3, -1e-3), rpy=(0.01, 0.0, 0.02)), description.base.matrix
    offset, stretch = 1e-2 * rng.normal(size=(2, truth.nv))
    errors = {"base": C, "joint_offset": tuple(offset), "link_length": tuple(stretch)}
    base, joints, links = (
        ArmKinematics(description.override({f"calibration_error.{field}": value}), X_PE, rows)
        for field, value in errors.items()
    )
    for q, v, _ in states(truth, 3):
        X_WP, J = truth.payload_pose(q), truth.payload_jacobian(q)
        moved = X_WB @ C.matrix @ inverse_pose(X_WB)
        assert_allclose(base.view(q).pose, moved @ X_WP, rtol=0, atol=1e-14)
        shifted = pin.integrate(truth.model, q, offset)
        assert_allclose(joints.view(q).pose, truth.payload_pose(shifted), rtol=0, atol=1e-13)
        assert_allclose(
            joints.view(q).jacobian @ truth.drive, truth.payload_jacobian(shifted), rtol=0, atol=1e-12
        )
        grown = X_WP.copy()
        grown[:3, 3] += stretch @ np.diff(chain_positions(truth, q), axis=0)
        assert_allclose(links.view(q).pose, grown, rtol=0, atol=1e-13)
        h = 1e-6
        before, after = (links.view(pin.integrate(truth.model, q, s * v)).pose for s in (-h, h))
        numeric = (after[:3, 3] - before[:3, 3]) / (2 * h)
        assert_allclose((links.view(q).jacobian @ truth.drive @ v)[:3], numeric, rtol=0, atol=1e-7)
        assert np.abs(links.view(q).jacobian @ truth.drive - J).max() > 1e-4


@pytest.mark.parametrize("cell", [planar_scenario().cell, spatial_cell()], ids=["planar", "spatial"])
def test_the_task_jacobian_of_a_cell_arm_maps_drive_velocities_to_the_rows_of_the_payload_twist(cell):
    T = np.tril(np.ones((len(cell.arms["right"].posture),) * 2))
    cell = cell.replace(arms=cell.arms | {"right": cell.arms["right"].replace(drive=T, torque_limits="none")})
    arm = CellArm(cell, "right")
    assert_allclose(arm.from_drive @ T, np.eye(arm.nv), rtol=0, atol=1e-12)
    for _, v, _ in states(arm, count=3):
        q = arm.configuration(v)
        twist = cell.task_rows.select(arm.payload_jacobian(q) @ v)
        assert_allclose(arm.task_jacobian(q) @ T @ v, twist, rtol=0, atol=1e-9)
        assert_allclose(arm.task_jacobian(q) @ arm.null_space(q), 0.0, rtol=0, atol=1e-9)


def test_a_cell_arm_has_the_share_the_posture_and_the_payload_frame_that_its_cell_gives_it():
    cell = planar_scenario().cell.replace(load_shares={"left": 0.75, "right": 0.25})
    left, right = (CellArm(cell, name) for name in cell.arms)
    assert (left.share, right.share) == (0.75, 0.25) == tuple(cell.shares)
    assert_allclose(
        left.joint_angles(left.posture_configuration), cell.arms["left"].posture, rtol=0, atol=1e-15
    )
    q = right.posture_configuration
    grasp = inverse_pose(cell.grasps["right"].matrix)
    assert_allclose(right.payload_pose(q), right.tip_pose(q) @ grasp, rtol=0, atol=1e-12)
    with pytest.raises(NameNotFoundError):
        CellArm(cell, "middle")
