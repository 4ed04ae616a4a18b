"""Any arms, any payload: from files to a closed cell with the right joints, masses, grasps and dynamics."""

import sys
import tomllib

import numpy as np
import pinocchio as pin
import pytest
from cells import CATALOGUE_CELLS, catalogue_cell
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import (
    FieldError,
    MimicJointError,
    MissingExtraError,
    NameNotFoundError,
    ScenarioError,
    ShapeError,
    UrdfError,
    WrongTypeError,
)
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose
from coop_pin.control import CellController
from coop_pin.control.controller import CellCommand
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import corners
from coop_pin.description.cell.grasp import grasps_from_configuration
from coop_pin.description.cell.payload import Payload
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario_file import anchor_files
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.feasibility.cell_summary import cell_summary
from coop_pin.figures import error_figure, torque_figure, tracking_figure
from coop_pin.grasps import CellChain
from coop_pin.model import ArmModel
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model.pinocchio_model import load_arm_model
from coop_pin.simulation.pinocchio_plant import PinocchioPlant

FINGERS = {"panda_finger_joint1": 0.02}
BODY = (
    '<inertial><mass value="{m}"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIMIT = '<limit lower="-2" upper="2" effort="10" velocity="3"/>'


def two_links(joint='type="revolute"', extra="", second=""):
    """URDF text: base - j1 - a - j2 - b."""
    return f"""<robot name="two"><link name="base"/>
    <link name="a">{BODY.format(m=1)}</link><link name="b">{BODY.format(m=2)}</link>
    <joint name="j1" {joint}><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>{LIMIT}</joint>
    <joint name="j2" type="revolute"><origin xyz="0.4 0 0"/><parent link="a"/><child link="b"/>
    <axis xyz="0 1 0"/>{LIMIT}{second}</joint>
    {extra}</robot>"""


@pytest.fixture
def urdf(tmp_path):
    def write(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


# ---------------------------------------------------------------- arms out of files


def test_an_arm_comes_from_a_name_a_path_and_a_relative_path(urdf, monkeypatch, tmp_path):
    path = urdf(two_links())
    assert Arm.from_urdf(path).tip == "b"
    monkeypatch.chdir(tmp_path)
    assert Arm.from_urdf("arm.urdf").urdf == str(path)  # does not depend on the working directory any more
    assert Arm.from_urdf("ur5", tip="tool0").urdf == "ur5"
    with pytest.raises(UrdfError):
        Arm.from_urdf("pandaa")


def test_a_base_is_a_pose_a_matrix_or_a_position():
    X = make_pose((1.0, 2.0, 3.0), (0.1, np.pi / 2, -0.3))
    for base in (Pose.from_matrix(X), X, X.tolist()):
        assert_allclose(Arm.from_urdf("ur5", "tool0", base=base).base.matrix, X, rtol=0, atol=1e-15)
    assert Arm.from_urdf("ur5", "tool0", base=(1, 2, 3)).base == Pose(xyz=(1, 2, 3))
    for wrong in ([[1, 2], [3, 4]], 2.0 * np.eye(4), "here"):
        with pytest.raises(FieldError, match="base"):
            Arm.from_urdf("ur5", "tool0", base=wrong)


@pytest.mark.parametrize("n", [(0, 0, -2), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0.3, -0.5, 0.7), (1, 1e-4, 0)])
@pytest.mark.parametrize("roll", [0.0, 0.5, -2.0])
def test_a_pose_by_axis_has_its_z_axis_along_the_approach_and_is_rolled_about_it(n, roll):
    """Against a plane: at roll 0 the x axis lies in the plane of approach and x; beyond, by the angle."""
    pose = Pose(xyz=(1, 2, 3), approach=n, roll=roll)
    R, level = pose.matrix[:3, :3], Pose(approach=n).matrix[:3, :3]
    assert_allclose(R[:, 2], np.array(n) / np.linalg.norm(n), atol=1e-12)
    assert_allclose(level.T @ R, make_pose(rpy=(0.0, 0.0, roll))[:3, :3], atol=1e-12)
    if np.abs(n[1:]).any():
        assert level[0, 0] >= 0.0
        assert abs(level[:, 0] @ np.cross(n, (1.0, 0.0, 0.0))) < 1e-12
    else:
        assert_allclose(level[:, 0], (0.0, 1.0, 0.0), atol=1e-12)
    again = Pose(**pose.by_axis())
    assert again.xyz == pose.xyz
    assert_allclose(again.matrix, pose.matrix, atol=3e-6)


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"approach": (0, 0, 0)}, "approach"),
        ({"approach": (0, 1)}, ""),
        ({"approach": (0, 0, np.nan)}, ""),
        ({"approach": (0, 0, 1), "roll": "x"}, ""),
        ({"roll": 1.0}, ""),
        ({"approach": (0, 0, 1), "rpy": (0, 0, 0)}, ""),
    ],
)
def test_a_pose_by_half_an_axis_or_in_two_ways_is_refused(fields, path):
    with pytest.raises(FieldError) as caught:
        Pose(**fields)
    assert caught.value.path == path


def test_a_tip_left_out_is_the_only_leaf_or_an_error_that_lists_the_leaves(urdf):
    with pytest.raises(UrdfError) as error:
        Arm(urdf="panda")
    assert set(error.value.names) == {"panda_leftfinger", "panda_rightfinger", "panda_hand_tcp"}
    assert Arm(urdf=str(urdf(two_links()))).tip == "b"
    with pytest.raises(NameNotFoundError) as unknown:
        ArmModel(Arm(urdf="ur5", tip="tool00"))
    assert unknown.value.name == "tool00"
    assert "tool0" in unknown.value.known


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "xarm7", "baxter", "talos_arm", "z1"])
def test_the_urdf_reader_knows_pinocchios_joint_order_and_link_poses(name):
    """Pinocchio is the oracle. Baxter and the Panda's fingers branch, Kinova has continuous joints."""
    text = load_checked(find_urdf(name))
    robot, model = Robot(text), pin.buildModelFromXML(text)
    assert list(robot.joints) == list(model.names)[1:]
    angles, data = np.random.default_rng(0).normal(size=model.nv), model.createData()
    pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), angles))
    named = dict(zip(robot.joints, angles, strict=True))
    links = [
        (index, frame.name) for index, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY
    ]
    for index, link in links[1:]:
        assert_allclose(robot.pose(link, named), data.oMf[index].homogeneous, rtol=0, atol=1e-12)


def test_poses_have_unit_axes_and_mimic_joints_of_their_own():
    """yourdfpy would slide by the length of the axis, and move the follower with its leader."""
    joint = '<joint name="{0}" type="prismatic"><parent link="{1}"/><child link="{0}"/><axis xyz="{2}"/>'
    joint += "{3}</joint>"
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
    text = '<robot name="r"><link name="a"/><link name="b"/><link name="c"/>' + joint.format(
        "b", "a", "3 0 0", limit
    )
    text += joint.format("c", "b", "0 0 -2", limit + '<mimic joint="b"/>') + "</robot>"
    robot, model = Robot(text), pin.buildModelFromXML(text)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array((0.5, 0.25)))
    X = robot.pose("c", {"b": 0.5, "c": 0.25})
    assert_allclose(X, data.oMf[model.getFrameId("c", pin.FrameType.BODY)].homogeneous, rtol=0, atol=1e-15)
    assert_allclose(
        robot.pose("c", {}), np.eye(4), rtol=0, atol=0
    )  # of the angles given, not of the last ones
    assert robot.mimics == {"c": ("b", 1.0, 0.0)}


def test_a_link_that_shares_its_name_with_a_joint_is_found():
    """Pinocchio's own look-up raises, and so does appendModel."""
    arm = Arm.from_urdf("z1", tip="gripperStator", locked={"jointGripper": 0.0})
    assert ArmModel(arm).nq == 6
    cell = Cell(arms={"one": arm}, payload=Payload.box(1.0, (0.1, 0.1, 0.1)), grasps={"one": Pose()})
    assert CellChain(cell).mechanism.model.nq == 6


def test_xacro_without_its_extra_says_what_to_install(urdf, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(MissingExtraError) as caught:
        Arm.from_urdf(urdf("<robot/>", "arm.urdf.xacro"))
    assert caught.value.extra == "xacro"


def test_xacro_is_expanded_with_its_arguments_and_its_own_includes(tmp_path):
    pytest.importorskip("xacrodoc")
    head = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "body.xacro").write_text(
        f'{head}<xacro:macro name="body" params="m">{BODY.format(m="${m}")}</xacro:macro></robot>'
    )
    arm = f"""{head}<xacro:arg name="mass" default="1"/><xacro:include filename="body.xacro"/>
    <link name="base"/><link name="end"><xacro:body m="$(arg mass)"/></link>
    <joint name="j" type="continuous"><parent link="base"/><child link="end"/><axis xyz="0 0 1"/></joint>
    </robot>"""
    (tmp_path / "arm.urdf.xacro").write_text(arm)
    models = [
        load_arm_model(Arm.from_urdf(tmp_path / "arm.urdf.xacro", xacro_args=args))
        for args in ({}, {"mass": "3.5"})
    ]
    assert [model.inertias[1].mass for model in models] == [1.0, 3.5]
    for included, reason in (("none.xacro", "cannot be expanded"), ("$(find far)/a.xacro", "package 'far':")):
        (tmp_path / "arm.urdf.xacro").write_text(arm.replace("body.xacro", included))
        with pytest.raises(UrdfError, match=reason):
            Arm.from_urdf(tmp_path / "arm.urdf.xacro")


def test_packages_and_arguments_of_a_xacro_reach_mechanisms_and_payloads(tmp_path):
    """Also from a scenario's file, whose folders are its own."""
    pytest.importorskip("xacrodoc")
    head = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="mass" default="1"/>'
    (tmp_path / "parts" / "bodies").mkdir(parents=True)
    (tmp_path / "parts" / "bodies" / "package.xml").write_text("<package><name>bodies</name></package>")
    (tmp_path / "parts" / "bodies" / "body.xacro").write_text(
        f'{head}<link name="a">{BODY.format(m="$(arg mass)")}</link></robot>'
    )
    path = tmp_path / "far" / "single.xacro"
    path.parent.mkdir()
    path.write_text(f'{head}<xacro:include filename="$(find bodies)/body.xacro"/></robot>')
    search = {"package_dirs": [str(tmp_path / "parts")], "xacro_args": {"mass": "3.5"}}
    bar = (
        '<link name="b">'
        + BODY.format(m="$(arg mass)")
        + """</link><joint name="j" type="continuous">
        <parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>"""
    )
    assert cp.Payload.from_urdf(path, **search).mass == 3.5
    table = {
        "cell": {"payload": {"kind": "urdf", "path": "far/single.xacro", **search, "package_dirs": ["parts"]}}
    }
    anchor_files(table, tmp_path)
    assert cp.Payload(**table["cell"]["payload"]).mass == 3.5
    mechanism = tmp_path / "far" / "two.xacro"
    mechanism.write_text(path.read_text().replace("</robot>", bar))
    assert cp.ClosedChain.from_urdf(mechanism, **search).model.inertias[1].mass == 3.5
    for wrong in ({"package_dirs": 3}, {"package_dirs": [3]}, {"xacro_args": [1]}):
        with pytest.raises(WrongTypeError):
            cp.ClosedChain.from_urdf(mechanism, **wrong)


# ---------------------------------------------------------------- locked and mimicking joints


def test_locked_joints_leave_the_arm_as_it_stands():
    """Poses, mass matrix block and total mass are those of the whole arm with fixed fingers."""
    arm = Arm.from_urdf("panda", "panda_hand_tcp", locked=FINGERS)
    reduced, whole = ArmModel(arm), pin.buildModelFromXML(load_checked(find_urdf("panda")))
    assert reduced.nq == 7
    data = whole.createData()
    for q in np.random.default_rng(1).normal(size=(5, 7)):
        full = np.append(q, (0.02, 0.02))
        pin.framesForwardKinematics(whole, data, full)
        assert_allclose(
            reduced.tip_pose(q), data.oMf[whole.getFrameId("panda_hand_tcp")].homogeneous, rtol=0, atol=1e-14
        )
        M = np.triu(pin.crba(whole, data, full))
        assert_allclose(np.triu(reduced.mass_matrix(q)), M[:7, :7], rtol=0, atol=1e-12)
    assert_allclose(
        sum(body.mass for body in reduced.model.inertias),
        sum(body.mass for body in whole.inertias),
        rtol=1e-14,
    )


def test_a_continuous_joint_locks_at_its_angle():
    arm = Arm.from_urdf("kinova", "j2s6s200_end_effector")
    locked = ArmModel(arm.replace(locked={"j2s6s200_joint_1": 2.5}))
    whole, angles = ArmModel(arm), np.array((2.5, 3.0, 1.5, -0.4, 2.0, 0.3))
    assert (locked.nq, locked.nv) == (7, 5)
    assert_allclose(
        locked.tip_pose(locked.configuration(angles[1:])),
        whole.tip_pose(whole.configuration(angles)),
        rtol=0,
        atol=1e-14,
    )


def test_what_cannot_be_locked_is_refused_by_name():
    panda = Arm.from_urdf("panda", "panda_hand_tcp")
    with pytest.raises(UrdfError, match=r"panda_finger_joint1: is 0\.5"):
        load_arm_model(panda.replace(locked={"panda_finger_joint1": 0.5}))
    with pytest.raises(NameNotFoundError) as unknown:
        load_arm_model(panda.replace(locked={"panda_finger_joint": 0.0}))
    assert "panda_finger_joint1" in unknown.value.known
    ur5 = Arm.from_urdf("ur5", "tool0")
    with pytest.raises(UrdfError, match="every joint"):
        load_arm_model(ur5.replace(locked=dict.fromkeys(list(load_arm_model(ur5).names)[1:], 0.0)))


def test_moving_mimic_joints_are_refused_unless_ignored():
    with pytest.raises(MimicJointError) as error:
        ArmModel(Arm.from_urdf("panda", "panda_hand_tcp"))
    assert error.value.names == ("panda_finger_joint2",)
    assert ArmModel(Arm.from_urdf("panda", "panda_hand_tcp", mimic="ignore")).nq == 9


def test_a_mimic_joint_is_locked_at_multiplier_times_leader_plus_offset(urdf):
    path = urdf(two_links(second='<mimic joint="j1" multiplier="-0.5" offset="0.2"/>', extra=(
        f'<link name="c">{BODY.format(m=1)}</link>'
        '<joint name="j3" type="revolute"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>'
        f'{LIMIT}</joint>'
    )))  # fmt: skip
    coupled = ArmModel(Arm.from_urdf(path, locked={"j1": 1.0}))
    apart = ArmModel(Arm.from_urdf(path, locked={"j1": 1.0, "j2": -0.3}))
    assert_allclose(coupled.tip_pose([0.4]), apart.tip_pose([0.4]), rtol=0, atol=1e-15)


def test_planar_and_floating_joints_are_refused(urdf):
    with pytest.raises(UrdfError, match="planar"):
        load_arm_model(Arm.from_urdf(urdf(two_links('type="planar"'))))


def test_models_are_the_callers_own_and_follow_their_file(urdf):
    path = urdf(two_links())
    arm = Arm.from_urdf(path)
    first = load_arm_model(arm)
    first.inertias[1] = pin.Inertia.Zero()
    assert load_arm_model(arm).inertias[1].mass == 1.0
    path.write_text(two_links().replace('mass value="1"', 'mass value="1.25"'))
    assert load_arm_model(arm).inertias[1].mass == 1.25


# ---------------------------------------------------------------- payloads


def solid(shape, *size, **options):
    """A mesh of trimesh, which takes a second to import."""
    from trimesh import creation

    return getattr(creation, shape)(*size, **options)


def test_a_mesh_of_a_box_is_the_box_wherever_its_file_puts_it(tmp_path):
    mesh = solid("box", (300.0, 200.0, 100.0))
    mesh.apply_translation((50.0, 20.0, -30.0))
    mesh.invert()  # triangles that look inwards do no harm
    mesh.export(tmp_path / "box.stl")
    box = Payload.box(3.0, (0.3, 0.2, 0.1))
    for payload in (
        Payload.mesh(tmp_path / "box.stl", mass=3.0, scale=1e-3),
        Payload.mesh(tmp_path / "box.stl", density=500.0, scale=1e-3),
    ):
        assert payload.mass == pytest.approx(3.0, rel=1e-9)
        assert_allclose(payload.inertia, box.inertia, rtol=1e-6, atol=1e-9)
        assert_allclose(payload.size, box.size, rtol=1e-6)
        assert_allclose(payload.shape_pose.xyz, (-0.05, -0.02, 0.03), atol=1e-8)
        assert_allclose(corners(payload), corners(box), rtol=1e-6)


def test_a_cylinder_has_the_inertia_of_its_mesh(tmp_path):
    solid("cylinder", radius=0.1, height=0.4, sections=2000).export(tmp_path / "rod.stl")
    assert_allclose(
        Payload.cylinder(2.0, 0.1, 0.4).inertia,
        Payload.mesh(tmp_path / "rod.stl", mass=2.0).inertia,
        rtol=1e-4,
        atol=1e-7,
    )


def test_meshes_that_enclose_nothing_are_refused(tmp_path):
    mesh = solid("box", (1.0, 1.0, 1.0))
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "open.stl")
    with pytest.raises(FieldError, match="open"):
        Payload.mesh(tmp_path / "open.stl", mass=1.0)
    with pytest.raises(FieldError, match="no mesh"):
        Payload.mesh(tmp_path / "none.stl", mass=1.0)
    (tmp_path / "text.stl").write_text("not a mesh")
    with pytest.raises(FieldError):
        Payload.mesh(tmp_path / "text.stl", mass=1.0)
    with pytest.raises(FieldError, match="either mass or density"):
        Payload.mesh(tmp_path / "open.stl")


def test_a_urdf_link_becomes_a_payload_about_its_centre_of_mass(urdf):
    """The inertia is given in turned axes; Pinocchio is the oracle."""
    text = """<robot name="p"><link name="part">
    <inertial><origin xyz="0.1 0.2 -0.1" rpy="0.3 -0.5 0.9"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial>
    <visual><origin xyz="0.1 0.2 0.3"/><geometry><cylinder radius="0.05" length="0.3"/></geometry></visual>
    </link></robot>"""
    payload = Payload.from_urdf(urdf(text))
    moved = text.replace(
        "</robot>",
        '<link name="w"/><joint name="j" type="continuous"><parent link="w"/><child link="part"/></joint>'
        "</robot>",
    )
    expected = pin.buildModelFromXML(moved).inertias[1]
    assert payload.mass == expected.mass
    assert_allclose(payload.inertia_matrix, expected.inertia, rtol=0, atol=1e-15)
    assert_allclose(payload.shape_pose.xyz, (0.0, 0.0, 0.4), atol=1e-15)
    assert (payload.shape, payload.size) == ("cylinder", (0.1, 0.1, 0.3))
    with pytest.raises(UrdfError, match="3 links"):
        Payload.from_urdf(urdf(two_links()))
    with pytest.raises(UrdfError, match="mass"):
        Payload.from_urdf(urdf(text.replace('<mass value="2"/>', "")))


SCENARIO = """name = "one"
start = { xyz = [0.5, 0.0, 0.4] }
[cell]
grasps = "as-posed"
payload_pose = { xyz = [0.5, 0.0, 0.4], rpy = [0.1, 0.2, 0.3] }
payload = PAYLOAD
[cell.arms.one]
urdf = "ur5"
tip = "tool0"
posture = [0.1, -1.2, 1.6, -1.0, -1.4, 0.2]
[motion]
kind = "hold"
pose = { xyz = [0.5, 0.0, 0.4] }
[controller]
kind = "user"
target = "nobody:Nothing"
"""


def test_a_file_says_the_same_as_the_calls(tmp_path):
    """A payload by its kind, grasps as posed, a mesh beside the file: resolved, written and read again."""
    solid("box", (0.3, 0.2, 0.1)).export(tmp_path / "box.stl")
    kinds = {
        '{ kind = "box", mass = 3.0, size = [0.3, 0.2, 0.1] }': Payload.box(3.0, (0.3, 0.2, 0.1)),
        '{ kind = "bar", mass = 3.0, length = 0.5 }': Payload.bar(3.0, 0.5),
        '{ kind = "cylinder", mass = 3.0, radius = 0.1, length = 0.5 }': Payload.cylinder(3.0, 0.1, 0.5),
        '{ kind = "mesh", path = "box.stl", mass = 3.0 }': Payload.mesh(tmp_path / "box.stl", mass=3.0),
    }
    for text, payload in kinds.items():
        (tmp_path / "one.toml").write_text(SCENARIO.replace("PAYLOAD", text))
        scenario = cp.Scenario.load(tmp_path / "one.toml")
        assert scenario.cell.payload == payload
        assert cp.Scenario.from_toml(scenario.to_toml()) == scenario
        assert "as-posed" not in scenario.to_toml()
        arm = scenario.cell.arms["one"]
        X_WP = scenario.cell.payload_pose.matrix
        held = ArmModel(arm, scenario.cell.grasps["one"].matrix).payload_pose(arm.posture)
        assert_allclose(held, X_WP, rtol=0, atol=1e-12)


def test_mistakes_in_a_file_are_named_at_their_fields():
    def read(payload, **cell):
        data = tomllib.loads(SCENARIO.replace("PAYLOAD", payload))
        data["cell"] |= cell
        return cp.Scenario(**data)

    with pytest.raises(
        ScenarioError, match=r"(?s)cell\.payload\.mass: is -1.*cell\.payload\.size: has 2 entries"
    ):
        read('{ kind = "box", mass = -1.0, size = [0.3, 0.2] }')
    with pytest.raises(FieldError, match=r"cell\.payload\.kind: is 'ball'"):
        read('{ kind = "ball" }')
    box = '{ kind = "box", mass = 1.0, size = [0.3, 0.2, 0.1] }'
    with pytest.raises(FieldError, match="payload_pose"):
        read(box, payload_pose=None)
    with pytest.raises(FieldError, match="as-posed"):
        read(box, grasps="somehow")


# ---------------------------------------------------------------- grasps


@pytest.mark.parametrize("name", CATALOGUE_CELLS)
def test_grasps_as_they_stand_are_the_grasps_that_closed_the_chain(name):
    cell, X_WP = catalogue_cell(name)
    chain = CellChain(cell)
    q = chain.configuration(X_WP)
    angles = {place.name: place.angles.of(q[place.q_slice]) for place in chain.model.arms}
    for arm, grasp in grasps_from_configuration(cell.arms, angles, X_WP).items():
        assert_allclose(grasp.matrix, cell.grasps[arm].matrix, rtol=0, atol=1e-9)
    first = next(iter(angles))
    with pytest.raises(ShapeError, match=first):
        grasps_from_configuration(cell.arms, angles | {first: angles[first][1:]}, X_WP)


# ---------------------------------------------------------------- cells


def moving_state(chain, X_WP, seed):
    """A configuration, a velocity on the closures and torques, the same for a welded and a free payload."""
    rng, q, model = np.random.default_rng(seed), chain.configuration(X_WP), chain.mechanism.model
    V_WP, v, tau = 0.2 * rng.normal(size=6), np.zeros(model.nv), np.zeros(model.nv)
    for place in chain.model.arms:
        J = ArmModel(chain.cell.arms[place.name], chain.cell.grasps[place.name].matrix).payload_jacobian(
            q[place.q_slice]
        )
        J_plus, drives = np.linalg.pinv(J), len(place.drive)
        v[place.v_slice] = J_plus @ V_WP + (np.eye(drives) - J_plus @ J) @ rng.normal(size=drives)
        tau[place.v_slice] = 5.0 * rng.normal(size=drives)
    if not chain.model.closed_by_tree:
        R = X_WP[:3, :3]
        v[-6:] = np.concatenate((R.T @ V_WP[:3], R.T @ V_WP[3:]))
    return q, v, tau


@pytest.mark.parametrize("name", CATALOGUE_CELLS)
def test_a_cell_closes_on_full_rows_and_both_trees_are_one_mechanism(name):
    cell, X_WP = catalogue_cell(name)
    found = {}
    for payload in ("welded", "free"):
        chain = CellChain(cell, PlantOptions(payload=payload))
        q, v, tau = moving_state(chain, X_WP, seed=4)
        assert max(max(gap) for gap in chain.closure_errors(q)) < 1e-9
        dynamics = chain.mechanism.forward_dynamics(q, v, tau)
        assert dynamics.rank == 6 * (len(cell.arms) - (payload == "welded"))
        arms = np.concatenate([dynamics.acceleration[place.v_slice] for place in chain.model.arms])
        found[payload] = arms, chain.interaction_wrenches(q, v, tau)
    for welded, free in zip(*found.values(), strict=True):
        assert_allclose(welded, free, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", CATALOGUE_CELLS)
@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_cell_that_falls_stays_closed_and_keeps_its_energy(name, payload):
    cell, X_WP = catalogue_cell(name)
    options = PlantOptions(payload=payload)
    chain = CellChain(cell, options)
    plant = PinocchioPlant(chain, options, chain.configuration(X_WP))
    start = chain.mechanism.energy(plant.q, plant.v).total
    for _ in range(100):
        plant.advance(0.0, 2e-3)
    assert np.abs(plant.v).max() > 1.0
    assert max(max(gap) for gap in chain.closure_errors(plant.q)) < 1e-8
    assert chain.mechanism.energy(plant.q, plant.v).total - plant.work.sum() == pytest.approx(
        start, rel=0, abs=1e-6
    )


@pytest.mark.parametrize("name", CATALOGUE_CELLS)
def test_a_cell_has_room_to_move(name):
    """sigma_min > 0.1 and 0.4 rad from every limit at the start, and 10 cm from it in any direction."""
    cell, X_WP = catalogue_cell(name)
    chain = CellChain(cell)
    shifts = np.vstack((np.zeros(3), 0.1 * np.eye(3), -0.1 * np.eye(3)))
    for shift in shifts:
        X = X_WP.copy()
        X[:3, 3] += shift
        q = chain.configuration(X)
        for place in chain.model.arms:
            arm = cell.arms[place.name]
            model, limits = ArmModel(arm, cell.grasps[place.name].matrix), JointLimits(arm)
            angles = place.angles.near(q[place.q_slice], np.array(arm.posture))
            assert np.linalg.svd(model.payload_jacobian(q[place.q_slice]), compute_uv=False)[-1] > 0.1
            assert min((angles - limits.lower).min(), (limits.upper - angles).min()) > 0.4
            assert np.abs(angles - arm.posture).max() < 1.0


class Still(CellController):
    """No torque; keeps what it saw."""

    def __init__(self):
        self.seen = []

    def init(self, measurements, references):
        return None

    def step(self, measurements, references, state):
        self.seen.append(measurements)
        return CellCommand([[0.0] * len(measurement.v) for measurement in measurements], None)


def scenario_of(cell, X_WP, **fields):
    pose = Pose.from_matrix(X_WP)
    return cp.Scenario(
        name="test",
        cell=cell,
        controller={"kind": "user", "target": "nobody:Nothing"},
        motion={"kind": "hold", "pose": pose},
        start=pose,
        **{"duration": 0.2, "clock": {"rate_hz": 500.0, "steps_per_tick": 1}} | fields,
    )


@pytest.mark.parametrize("payload", ["welded", "free"])
def test_a_single_arm_is_an_ordinary_arm_with_a_load(payload):
    """Welded (no closure) or free (one): forward dynamics of the arm with the payload in its last body."""
    two, X_WP = catalogue_cell("panda-ur5-bar")
    cell = Cell(arms={"one": two.arms["right"]}, payload=two.payload, grasps={"one": two.grasps["right"]})
    chain = CellChain(cell, PlantOptions(payload=payload))
    q, v, tau = moving_state(chain, X_WP, seed=2)
    arm, place = ArmModel(cell.arms["one"], cell.grasps["one"].matrix), chain.model.arms[0]
    frame = arm.model.frames[arm.model.getFrameId("payload")]
    load = pin.Inertia(cell.payload.mass, np.zeros(3), cell.payload.inertia_matrix)
    arm.model.inertias[frame.parentJoint] += frame.placement.act(load)
    expected = pin.aba(
        arm.model, arm.model.createData(), q[place.q_slice], v[place.v_slice], tau[place.v_slice]
    )
    assert_allclose(
        chain.mechanism.forward_dynamics(q, v, tau).acceleration[place.v_slice],
        expected,
        rtol=1e-9,
        atol=1e-9,
    )
    result = cp.simulate(scenario_of(cell, X_WP, plant={"payload": payload}), Still())
    assert result.energy_balance_max() < 1e-6
    assert max(result.closure_error_max()) < 1e-8
    assert_allclose(result.data.internal_wrench.values, 0.0, atol=1e-12)
    assert np.isnan(result.internal_force().axial_rms_error)
    for figure in (tracking_figure, torque_figure, error_figure):
        figure(result)


class Constant(Still):
    """The same torques at every tick."""

    def __init__(self, *torques):
        super().__init__()
        self.torques = torques

    def step(self, measurements, references, state):
        self.seen.append(measurements)
        return CellCommand(self.torques, None)


def test_continuous_joints_are_measured_and_recorded_as_angles_that_never_jump():
    """A Kinova swings a load about its continuous joints: their angles integrate the joint rates."""
    pair, X_WP = catalogue_cell("kinova-pair")
    cell = Cell(
        arms={"one": pair.arms["left"]},
        payload=pair.payload,
        grasps={"one": pair.grasps["left"]},
        gravity=(0.0, 0.0, 0.0),
    )
    controller = Constant((3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    result = cp.simulate(scenario_of(cell, X_WP, duration=0.8), controller)
    angles, rates = result.data.joint_position.values, result.data.joint_velocity.values
    trapezes = 0.002 * (rates[1:] + rates[:-1]) / 2.0
    assert_allclose(np.diff(angles, axis=0), trapezes, rtol=0, atol=1e-3)
    seen = np.array([[measurement.q for measurement in measurements] for measurements in controller.seen])
    assert_allclose(seen, angles, rtol=0, atol=1e-12)
    assert_allclose(angles[0, 0], cell.arms["one"].posture, atol=0.01)
    assert np.abs(angles[-1, 0, [0, 3, 5]]).max() > np.pi  # beyond half a turn, where an arc tangent jumps
    assert result.energy_balance_max() < 1e-6


def test_public_methods_take_lists_refuse_wrong_shapes_and_hand_out_no_live_buffer():
    cell, X_WP = catalogue_cell("panda-ur5-bar")
    chain = CellChain(cell)
    q, v, tau = moving_state(chain, X_WP, seed=1)
    arm = ArmModel(cell.arms["left"], cell.grasps["left"].matrix)
    place = chain.model.arms[0]
    calls = {
        chain.configuration: (X_WP,),
        chain.payload_pose: (q,),
        chain.payload_jacobian: (q,),
        chain.payload_twist: (q, v),
        chain.tip_positions: (q,),
        chain.closure_errors: (q,),
        chain.interaction_wrenches: (q, v, tau),
        arm.mass_matrix: (q[place.q_slice],),
        arm.nonlinear_effects: (q[place.q_slice], v[place.v_slice]),
        arm.payload_pose: (q[place.q_slice],),
        arm.payload_jacobian: (q[place.q_slice],),
        arm.forward_dynamics: (q[place.q_slice], v[place.v_slice], tau[place.v_slice]),
        arm.configuration: (q[place.q_slice],),
        arm.joint_angles: (q[place.q_slice],),
    }
    for call, arguments in calls.items():
        kept = call(*(argument.tolist() for argument in arguments))
        before = np.array(kept)
        call(*(argument + 1e-4 for argument in arguments) if call != chain.configuration else arguments)
        assert_allclose(kept, before, rtol=0, atol=0)
        with pytest.raises(ShapeError):
            call(arguments[0][1:], *arguments[1:])
    push = np.zeros((1, 6))
    seen = chain.observe(q[None], v[None], tau[None], push)
    parts = [part for part in seen if part is not None]  # without springs' of rigid grasps
    before = [part.copy() for part in parts]
    chain.observe(q[None] + 1e-3, v[None], tau[None], push)
    for part, kept in zip(parts, before, strict=True):
        assert_allclose(part, kept, rtol=0, atol=0)


@pytest.mark.parametrize("name", CATALOGUE_CELLS)
def test_the_summary_counts_what_the_tree_holds(name):
    cell, X_WP = catalogue_cell(name)
    summary = cell_summary(cell, X_WP)
    joints = sum(len(arm.joints) for arm in summary.arms)
    assert summary.freedom == joints + 6 - summary.rank
    assert summary.closure_rows == summary.rank == 6 * len(cell.arms)
    assert all(arm.smallest_singular_value > 0.1 for arm in summary.arms)
    text = summary.summary()
    assert all(arm in text for arm in cell.arms)
    assert f"{joints} joints" in text


def test_the_summary_of_the_planar_cell_says_which_closure_rows_are_redundant():
    scenario = cp.Scenario.load("adept-paper")
    summary = cell_summary(scenario.cell, scenario.start.matrix)
    assert (summary.closure_rows, summary.rank, summary.freedom) == (12, 9, 3)
    assert summary.arms[0].maximum_reach == pytest.approx(
        np.hypot(0.425 + 0.375, 0.25), rel=1e-6
    )  # stretched, tip 0.25 m below joint 1


def test_vectors_that_do_not_fit_the_arm_are_refused():
    with pytest.raises(FieldError, match="posture"):
        Arm.from_urdf("ur5", "tool0", posture=[0.0] * 5, torque_limits=[1.0] * 6)
    with pytest.raises(FieldError, match=r"arms\.one\.torque_limits"):
        JointLimits(Arm.from_urdf("ur5", "tool0", torque_limits=[1.0] * 5), "one")
    with pytest.raises(ScenarioError, match="payload"):
        Cell(
            arms={"payload": Arm.from_urdf("ur5", "tool0")},
            payload=Payload.bar(1.0, 1.0),
            grasps={"payload": Pose()},
        )
