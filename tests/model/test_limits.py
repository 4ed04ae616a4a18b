"""What URDF says and Pinocchio ignores: friction, torque limits, and the limits that a run is judged by."""

import numpy as np
import pytest
from cells import catalogue_cell, planar_scenario
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import CommandError, DivergedError, FieldError, ShapeError
from coop_pin.base.schema.pose import Pose
from coop_pin.control import CellController
from coop_pin.control.controller import CellCommand
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.description.cell.payload import Payload
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.pinocchio_model import load_arm_model
from coop_pin.model.transmission import Transmission, friction
from coop_pin.simulation.simulation import Simulation

XARM = Arm.from_urdf("xarm7", "link_eef")
XARM_DAMPING, XARM_COULOMB = np.array((10.0, 10.0, 5.0, 5.0, 5.0, 2.0, 2.0)), np.ones(7)
SHEAR = tuple(tuple(float(i == j or i == j + 1) for j in range(7)) for i in range(7))


class Given(CellController):
    """Torques as a function of time; keeps what it saw."""

    def __init__(self, torques):
        self.torques, self.seen = torques, []

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        self.seen.append(measurements)
        return CellCommand(self.torques(measurements), None)


def nothing(measurements):
    return [np.zeros(len(measurement.v)) for measurement in measurements]


def run(cell, X_WP, torques, duration=0.1):
    pose = Pose.from_matrix(X_WP)
    controller = Given(torques)
    scenario = cp.Scenario(
        name="test",
        cell=cell,
        controller={"kind": "user", "target": "nobody:Nothing"},
        motion={"kind": "hold", "pose": pose},
        start=pose,
        duration=duration,
        clock={"rate_hz": 500.0, "steps_per_tick": 1},
    )
    return cp.simulate(scenario, controller), controller.seen


# ---------------------------------------------------------------- friction


@pytest.mark.parametrize("drive", [None, SHEAR], ids=["own", "sheared"])
def test_friction_of_the_urdf_acts_at_the_joints_whatever_the_drives(drive):
    cell = Cell(
        arms={"one": XARM.replace(drive=drive)}, payload=Payload.bar(1.0, 0.2), grasps={"one": Pose()}
    )
    chain = CellChain(cell)
    v = np.random.default_rng(0).normal(size=chain.mechanism.model.nv)
    speed = JointFriction().coulomb_velocity
    expected = -(XARM_DAMPING * v + XARM_COULOMB * np.tanh(v / speed))
    assert_allclose(
        Transmission(cell, chain.model.arms, chain.mechanism.model.nv).friction(v),
        expected,
        rtol=0,
        atol=1e-12,
    )


def test_stated_friction_acts_at_the_drives_and_wins_over_the_urdf():
    T, v = np.array(SHEAR), np.random.default_rng(1).normal(size=7)
    arm = XARM.replace(
        drive=SHEAR,
        friction=JointFriction(
            viscous=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0), coulomb=0.5, coulomb_velocity=0.2
        ),
    )
    cell = Cell(arms={"one": arm}, payload=Payload.bar(1.0, 0.2), grasps={"one": Pose()})
    w = T @ v
    expected = -T.T @ (np.arange(1.0, 8.0) * w + 0.5 * np.tanh(w / 0.2))
    assert_allclose(
        Transmission(cell, CellChain(cell).model.arms, 7).friction(v), expected, rtol=0, atol=1e-12
    )


def test_no_friction_is_none():
    found = friction(XARM.replace(friction="none"))
    assert not found.viscous.any()
    assert not found.coulomb.any()
    with pytest.raises(FieldError, match="friction"):
        XARM.replace(friction="some")
    with pytest.raises(FieldError, match=r"cell\.arms\.one\.friction\.viscous"):
        friction(XARM.replace(friction=JointFriction(viscous=(1.0, 2.0))), "one")


def test_the_work_of_the_urdfs_friction_closes_the_energy_balance():
    cell, X_WP = catalogue_cell("two-pandas-box")  # 0.003 N m s/rad at every joint
    rough = cell.replace(
        arms={name: arm.replace(friction=JointFriction(viscous=0.5)) for name, arm in cell.arms.items()}
    )
    for each in (cell, rough):
        result, _ = run(each, X_WP, nothing)
        assert float(result.data.work_friction[-1]) < 0.0
        assert result.energy_balance_max() < 1e-6


# ---------------------------------------------------------------- limits of the URDF


def test_limits_are_those_of_the_urdf():
    panda = JointLimits(Arm.from_urdf("panda", "panda_hand_tcp", locked={"panda_finger_joint1": 0.0}))
    assert_allclose(panda.torque, (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0))
    assert_allclose(panda.velocity, (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61))
    assert_allclose((panda.lower[3], panda.upper[3]), (-3.0718, -0.0698))
    kinova = JointLimits(Arm.from_urdf("kinova", "j2s6s200_end_effector"))
    assert (
        list(np.isinf(kinova.lower))
        == list(np.isinf(kinova.upper))
        == [True, False, False, True, False, True]
    )
    assert_allclose(kinova.lower[1], 47.0 * np.pi / 180.0, rtol=1e-6)


def test_torque_limits_are_stated_for_drives():
    assert_allclose(JointLimits(XARM.replace(torque_limits=7.0)).torque, np.full(7, 7.0))
    assert_allclose(JointLimits(XARM.replace(torque_limits=list(range(1, 8)))).torque, np.arange(1.0, 8.0))
    assert np.isinf(JointLimits(XARM.replace(torque_limits="none")).torque).all()
    assert np.isinf(JointLimits(XARM.replace(drive=SHEAR)).torque).all()  # joint efforts are no drive torques
    assert_allclose(JointLimits(XARM.replace(drive=SHEAR, torque_limits=3.0)).torque, np.full(7, 3.0))
    for wrong in ("some", 0.0, (1.0, -2.0), [[1.0]], float("nan")):
        with pytest.raises(FieldError, match="torque_limits"):
            XARM.replace(torque_limits=wrong)


def test_an_effort_or_velocity_of_zero_is_not_stated(tmp_path):
    text = """<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="0" velocity="0"/></joint></robot>"""
    (tmp_path / "arm.urdf").write_text(text)
    limits = JointLimits(Arm.from_urdf(tmp_path / "arm.urdf"))
    assert np.isinf(limits.torque).all()
    assert np.isinf(limits.velocity).all()


# ---------------------------------------------------------------- saturation


def test_saturation_cuts_at_the_limit_says_where_and_happens_once():
    scenario = cp.Scenario.load("panda-ur5-bar", {"cell.arms.right.torque_limits": "none"})
    simulation = Simulation(scenario, Given(nothing))
    motors, none = simulation.actuation, (0.0, 0.0)
    limits, rng = [JointLimits(arm) for arm in scenario.cell.arms.values()], np.random.default_rng(0)
    applied = motors.apply(
        0.0, CellCommand([rng.normal(size=7) * 100.0, (rng.normal(size=6) * 1e4).tolist()], None), none
    )
    commands = applied.commanded
    assert_allclose(
        applied.torques[0], np.clip(commands[0], -limits[0].torque, limits[0].torque), rtol=0, atol=0
    )
    assert list(applied.saturated[0]) == list(np.abs(commands[0]) > limits[0].torque)
    assert applied.saturated[0].any()
    assert_allclose(applied.torques[1], commands[1], rtol=0, atol=0)
    again = motors.apply(0.0, CellCommand(applied.torques, None), none)
    assert not again.saturated[0].any()
    assert_allclose(again.torques[0], applied.torques[0], rtol=0, atol=0)
    with pytest.raises(DivergedError, match="left") as caught:
        motors.apply(2.5, CellCommand([np.full(7, np.nan), np.zeros(6)], None), none)
    assert caught.value.time == 2.5


def test_saturation_is_applied_recorded_and_told_at_the_next_tick():
    cell, X_WP = catalogue_cell("panda-ur5-bar")

    def swing(measurements):
        wave = np.sin(400.0 * measurements[0].time + np.arange(7.0))
        return [100.0 * wave, 5.0 * wave[:6]]

    result, seen = run(cell, X_WP, swing)
    data = result.data
    limit = JointLimits(cell.arms["left"]).torque
    commanded, applied, saturated = data.commanded_torque.values, data.torque.values, data.saturated.values
    assert_allclose(commanded[:, 0], [swing(measurements)[0] for measurements in seen], rtol=0, atol=0)
    assert_allclose(applied[:, 0], np.clip(commanded[:, 0], -limit, limit), rtol=0, atol=0)
    assert (saturated[:, 0] == (np.abs(commanded[:, 0]) > limit)).all()
    assert saturated[:, 0].any()
    assert not saturated[:, 0].all()
    assert not saturated[:, 1].any()
    told = np.array([measurements[0].saturated for measurements in seen])
    assert not told[0].any()
    assert (told[1:] == saturated[:-1, 0]).all()
    assert result.energy_balance_max() < 1e-5  # the work is that of the torques applied
    with pytest.raises(ValueError, match="read-only"):
        seen[1][0].saturated[0] = True


def test_the_papers_torques_pass_untouched():
    result = cp.run("adept-paper", {"duration": 0.5, "events": []}, warn=False)
    assert_allclose(result.data.torque.values, result.data.commanded_torque.values, rtol=0, atol=0)
    assert not result.data.saturated.values.any()
    assert np.isnan(result.data.torque_limit.values).all()
    assert result.limit_violations() == ()


def test_torques_that_do_not_fit_are_refused_with_the_arms_name():
    cell, X_WP = catalogue_cell("panda-ur5-bar")
    with pytest.raises(CommandError, match="torque of arm 'right'"):
        run(cell, X_WP, lambda _: [np.zeros(7), np.zeros(7)])
    with pytest.raises(ShapeError, match="list of torque commands"):
        run(cell, X_WP, lambda _: [np.zeros(7)])


# ---------------------------------------------------------------- violations


def test_every_limit_that_a_falling_cell_breaks_is_reported_and_still_is_after_loading(tmp_path):
    """The oracle goes through the recorded arrays joint by joint."""
    cell, X_WP = catalogue_cell("two-pandas-box")
    result, _ = run(cell, X_WP, lambda _: [np.full(7, 200.0), np.zeros(7)], duration=0.3)
    data, names = result.data, list(load_arm_model(cell.arms["left"]).names)[1:]
    expected = set()
    for index, (arm, description) in enumerate(cell.arms.items()):
        limits = JointLimits(description)
        for joint in range(7):
            position, velocity = (
                data.joint_position.values[:, index, joint],
                data.joint_velocity.values[:, index, joint],
            )
            torque = data.commanded_torque.values[:, index, joint]
            if position.max() > limits.upper[joint] or position.min() < limits.lower[joint]:
                expected.add((arm, names[joint], "position"))
            if np.abs(velocity).max() > limits.velocity[joint]:
                expected.add((arm, names[joint], "velocity"))
            if np.abs(torque).max() > limits.torque[joint]:
                expected.add((arm, names[joint], "torque"))
    found = result.limit_violations()
    assert {violation[:3] for violation in found} == expected
    assert {violation.kind for violation in found} == {"position", "velocity", "torque"}
    torque = next(
        violation for violation in found if violation.kind == "torque" and violation.joint == names[6]
    )
    assert (torque.worst, torque.limit, torque.first_time) == (200.0, 12.0, 0.0)
    speed = next(violation for violation in found if violation.kind == "velocity")
    values = np.abs(data.joint_velocity.sel(arm=speed.arm).values[:, names.index(speed.joint)])
    assert abs(speed.worst) == values.max()
    assert speed.first_time == data.time.values[np.flatnonzero(values > abs(speed.limit))[0]]
    result.save(tmp_path / "run.nc")
    assert cp.RunResult.load(tmp_path / "run.nc").limit_violations() == found


def test_joints_that_an_arm_does_not_have_are_empty():
    cell, X_WP = catalogue_cell("panda-ur5-bar")
    result, _ = run(cell, X_WP, nothing, duration=0.02)
    data = result.data
    assert list(data.joint_name.values[1]) == [*list(load_arm_model(cell.arms["right"]).names)[1:], ""]
    for variable in ("torque", "commanded_torque", "joint_position", "joint_velocity", "drive_velocity"):
        assert np.isnan(data[variable].values[:, 1, 6]).all()
        assert np.isfinite(data[variable].values[:, 0]).all()
    for variable in ("position_lower", "position_upper", "velocity_limit", "torque_limit"):
        assert np.isnan(data[variable].values[1, 6])


def test_joint_positions_are_joint_angles_whatever_the_drives():
    """The paper's second motor turns an absolute angle; limits are those of the joints."""
    scenario = planar_scenario().replace(duration=0.05, events=())
    data = cp.run(scenario, warn=False).data
    for index, name in enumerate(scenario.cell.arms):
        arm = ArmModel(scenario.cell.arms[name], scenario.cell.grasps[name].matrix)
        pose = arm.payload_pose(data.joint_position.values[-1, index])
        assert_allclose(pose[:3, 3], data.payload_position.values[-1], rtol=0, atol=1e-9)
        assert_allclose(
            arm.drive @ data.joint_velocity.values[-1, index],
            data.drive_velocity.values[-1, index],
            rtol=0,
            atol=1e-14,
        )
