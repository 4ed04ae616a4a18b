"""Robots as files have them: passive joints, inertias, loops, meshes, prefixes."""

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import InfeasibleMotionError, UrdfError, UrdfWarning
from coop_pin.description.cell.arm import Arm
from coop_pin.description.urdf import check_file, find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.description.urdf.srdf import Srdf
from coop_pin.model.joint_limits import PASSIVE, JointLimits
from coop_pin.model.pinocchio_model import load_arm_model
from coop_pin.model.visuals import CellVisuals

THIN = "0.01 0.01 0.01"
IMPOSSIBLE = "0.001 0.001 0.009"
"""Moments of which the largest exceeds the sum of the others."""
NEAREST = "0.004 0.004 0.008"


def link(name, moments=THIN, mass=1.0, extra=""):
    x, y, z = moments.split()
    return f"""<link name="{name}"><inertial><origin xyz="0.02 0 0.1"/><mass value="{mass}"/>
    <inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial>{extra}</link>"""


def joint(name, parent, child, kind="revolute", effort=20.0, axis="0 0 1", xyz="0.3 0 0", extra=""):
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{xyz}" rpy="0.1 0 0"/><axis xyz="{axis}"/>
    <limit lower="-3" upper="3" effort="{effort}" velocity="2"/>{extra}</joint>"""


def written(folder, *parts, name="robot.urdf"):
    path = folder / name
    path.write_text('<robot name="r">' + "".join(parts) + "</robot>")
    return str(path)


AXES = {"planar": ("0 0 1",) * 3, "spatial": ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")}


def arm_parts(cell, efforts=None, hand=THIN, finger=THIN, dummy=(), finger_mass=0.1):
    """A chain of a planar or a spatial arm, with a hand and a finger of its own joint, effort 0."""
    axes = AXES[cell]
    efforts = (20.0,) * len(axes) if efforts is None else efforts
    parts = [link("base")]
    for k, (axis, effort) in enumerate(zip(axes, efforts, strict=True)):
        parts += [
            link(f"l{k}"),
            joint(f"j{k}", f"l{k - 1}" if k else "base", f"l{k}", axis=axis, effort=effort),
        ]
    last = f"l{len(axes) - 1}"
    parts += [link("hand", hand), joint("wrist", last, "hand", "fixed"), link("finger", finger, finger_mass)]
    return [*parts, joint("grip", "hand", "finger", "prismatic", xyz="0 0.02 0"), *dummy]


def arm(folder, *args, locked="others", tip="hand", **options):
    fields = {name: options.pop(name) for name in ("impossible_inertia", "torque_limits") if name in options}
    return Arm.from_urdf(written(folder, *arm_parts(*args, **options)), tip, locked=locked, **fields)


# ---------------------------------------------------------------- passive joints


@pytest.mark.parametrize("name", AXES)
def test_a_joint_with_effort_zero_beside_others_has_no_drive(name, tmp_path):
    efforts = [20.0] * len(AXES[name])
    efforts[1] = 0.0
    passive = arm(tmp_path, name, efforts)
    with pytest.warns(UrdfWarning, match="passive_joint"):
        limits = JointLimits(passive).torque
    np.testing.assert_array_equal(limits, [20.0 if effort else PASSIVE for effort in efforts])
    report = check_file(find_urdf(passive.urdf))
    assert [(each.code, each.kind, each.element) for each in report.findings] == [
        ("passive_joint", "doubtful", "joint 'j1'")
    ]
    driven = passive.replace(torque_limits=5.0)
    assert JointLimits(driven).torque.tolist() == [5.0] * len(efforts)


@pytest.mark.parametrize("efforts", [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0)], ids=str)
def test_efforts_that_are_all_zero_or_all_stated_are_of_no_passive_joint(efforts, tmp_path):
    """The finger's effort does not count: it is locked."""
    robot = arm(tmp_path, "planar", efforts)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        limits = JointLimits(robot).torque
    np.testing.assert_array_equal(limits, [effort or np.inf for effort in efforts])


def passive_cell(name):
    scenario = cp.Scenario.load({"planar": "adept-paper", "spatial": "two-pandas-box"}[name])
    return scenario.replace(duration=0.1, events=())


@pytest.mark.parametrize("name", by_default(["planar", "spatial"], "planar"))
def test_a_passive_joint_of_a_cell_exerts_nothing(name, tmp_path):
    """The paper's three-joint arms and two Pandas, the second joint of the left one with effort 0."""
    scenario = passive_cell(name)
    left = scenario.cell.arms[first := next(iter(scenario.cell.arms))]
    text = load_checked(left.file)
    joint_name = Robot(text).unlocked(left.locked)[1]
    before, _, after = text.partition(f'<joint name="{joint_name}"')
    start = after.index("effort=")
    end = after.index('"', start + 8) + 1
    path = tmp_path / "passive.urdf"
    path.write_text(before + f'<joint name="{joint_name}"' + after[:start] + 'effort="0"' + after[end:])
    arms = scenario.cell.arms | {first: left.replace(urdf=str(path), torque_limits="urdf", drive=None)}
    changed = scenario.replace(cell=scenario.cell.replace(arms=arms))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = cp.run(changed, warn=False)
    torque = np.abs(result.data.torque.values[:, 0])
    assert torque[:, 1].max() <= PASSIVE
    assert torque[:, 0].max() > 1e-3
    if name == "spatial":  # against gravity
        warnings.simplefilter("ignore")
        with pytest.raises(InfeasibleMotionError) as caught:
            cp.suggest(changed)
        assert caught.value.cause == "torque"
        assert "torque_limits" in caught.value.detail


# ---------------------------------------------------------------- impossible inertias


@pytest.mark.parametrize("name", AXES)
def test_an_impossible_inertia_is_judged_on_the_body_that_moves(name, tmp_path):
    """A light dummy fixed to a heavy link: Pinocchio's merged body is possible, and the file is accepted."""
    dummy = (link("dummy", "1e-8 1e-8 9e-8", 1e-8), joint("weld", "l0", "dummy", "fixed"))
    parts = arm_parts(name, dummy=dummy)
    report = check_file(find_urdf(written(tmp_path, *parts)))
    assert [(each.code, each.kind) for each in report.findings] == [("inertia_triangle", "physical")]
    alone = arm_parts(name, hand="1 1 9")
    report = check_file(find_urdf(written(tmp_path, *alone)))
    assert [(each.code, each.kind) for each in report.findings] == [("inertia_triangle", "impossible")]


@pytest.mark.parametrize("name", AXES)
def test_merged_bodies_are_those_of_pinocchio(name, tmp_path):
    """A finger at any place of its joint: the body is impossible where Pinocchio's moments are."""
    rng, kinds = np.random.default_rng(5), []
    for _ in range(12):
        moments = rng.uniform(0.0005, 0.02, 3)
        moments[2] = moments[:2].sum() * rng.uniform(1.05, 4.0)
        robot = arm(tmp_path, name, finger=" ".join(map(repr, moments.tolist())), locked={"grip": 0.4})
        model = pin.buildModelFromUrdf(robot.urdf)
        locked = pin.buildReducedModel(model, [model.getJointId("grip")], _at(model, "grip", 0.4))
        I1, I2, I3 = np.linalg.eigvalsh(locked.inertias[locked.njoints - 1].inertia)
        with pytest.warns(UrdfWarning) as caught:
            load_checked(robot.file)
        kinds.append("repaired" in str(caught[0].message))
        assert kinds[-1] == (I3 > (I1 + I2) * (1.0 + 1e-6))
    assert {*kinds} == {True, False} or name == "spatial"


def _at(model, joint, value):
    q = pin.neutral(model)
    q[model.idx_qs[model.getJointId(joint)]] = value
    return q


def test_a_locked_part_is_repaired_and_a_moved_one_only_if_stated(tmp_path):
    """The nearest possible moments of (1, 1, 9): of S = (4.5, 4.5, -3.5) the last is zero: (4.5, 4.5, 9)."""
    finger = {"finger": "1 1 9", "finger_mass": 0.1}
    robot = arm(tmp_path, "spatial", **finger)
    with pytest.warns(UrdfWarning, match=r"4\.5, 4\.5, 9"):
        model = load_arm_model(robot)
    for inertia in list(model.inertias)[1:]:
        I1, I2, I3 = np.linalg.eigvalsh(inertia.inertia)
        assert I1 > 0.0
        assert I3 <= (I1 + I2) * (1.0 + 1e-6)
    with pytest.raises(UrdfError, match="impossible_inertia"):
        load_arm_model(robot.replace(locked={}))
    with pytest.warns(UrdfWarning, match="repaired"):
        moved = load_arm_model(robot.replace(locked={}, impossible_inertia="repair"))
    finger_inertia = moved.inertias[moved.getJointId("grip")]
    np.testing.assert_allclose(np.linalg.eigvalsh(finger_inertia.inertia), (4.5, 4.5, 9.0), rtol=1e-12)
    negative = arm(tmp_path, "spatial", finger_mass=-5.0, impossible_inertia="repair", locked={})
    with pytest.raises(UrdfError, match="mass_negative"):
        load_arm_model(negative)


# ---------------------------------------------------------------- loops, prefixes, meshes, masses

LOOPS = {
    "loop_joint": '<loop_joint name="loop" type="{kind}"><link1 link="{a}"/><link2 link="{b}"/></loop_joint>',
    "loop": '<loop name="loop" type="{kind}"><predecessor link="{a}"/><successor link="{b}"/></loop>',
    "gazebo": '<gazebo><joint name="loop" type="{kind}"><parent>{a}</parent><child>{b}</child></joint>'
    "</gazebo>",
    "hinge": '<gazebo><joint:hinge name="loop"><body1>{a}</body1><body2> {b} </body2></joint:hinge></gazebo>',
}


@pytest.mark.parametrize("dialect", LOOPS)
@pytest.mark.parametrize("name", AXES)
def test_loops_of_locked_parts_refuse_no_robot(name, dialect, tmp_path):
    for a, b, kind, is_refused in (("hand", "finger", "screw", False), ("l0", "finger", "fixed", True)):
        robot = arm(tmp_path, name, dummy=(LOOPS[dialect].format(a=a, b=b, kind=kind),))
        if is_refused:
            with pytest.raises(UrdfError, match="loop"):
                load_arm_model(robot)
        else:
            assert load_arm_model(robot).nv == len(AXES[name])
            with pytest.raises(UrdfError, match="loop"):
                load_arm_model(robot.replace(locked={}))


def loop_through_a_link_that_the_file_has_not(first, second):
    form = (
        '<gazebo><joint name="{}" type="revolute"><parent>coupler</parent><child>{}</child></joint></gazebo>'
    )
    return form.format("one", first) + form.format("two", second)


@pytest.mark.parametrize("name", AXES)
def test_loops_through_links_of_gazebo_alone_are_judged_together(name, tmp_path):
    """As in PR2's grippers: the coupler between hand and finger is no link of the URDF."""
    inside = arm(tmp_path, name, dummy=(loop_through_a_link_that_the_file_has_not("hand", "finger"),))
    assert load_arm_model(inside).nv == len(AXES[name])
    across = arm(tmp_path, name, dummy=(loop_through_a_link_that_the_file_has_not("l0", "finger"),))
    with pytest.raises(UrdfError, match="loop"):
        load_arm_model(across)


@pytest.mark.parametrize("version", ["", ' version="0.0"', ' version="1"'])
def test_declarations_of_xml_are_read_as_pinocchio_does(version, tmp_path):
    path = Path(written(tmp_path, *arm_parts("planar")))
    path.write_text(f"<?xml{version} ?>\n{path.read_text()}")
    assert pin.buildModelFromUrdf(str(path)).nv == 4
    assert check_file(find_urdf(path)).errors() == ()


def with_mesh(folder, filename, prefix=""):
    visual = f'<visual {prefix}><geometry><mesh filename="{filename}"/></geometry></visual>'
    parts = arm_parts("spatial")
    parts[1] = link("l0", extra=visual + '<visual><geometry><box size="1 1 1"/></geometry></visual>')
    return written(folder, *parts)


TRIANGLE = """solid s
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid s
"""


@pytest.mark.parametrize(
    ("folder", "filename"),
    [
        ("description/urdf", "../meshes/a.stl"),
        ("clone-of-it/urdf", "package://named_by_xml/meshes/a.stl"),
        ("clone-of-it/urdf", "package://clone-of-it/meshes/a.stl"),
    ],
)
@pytest.mark.parametrize("prefix", ["", 'drake:note="1"'])
def test_meshes_are_the_same_for_the_check_and_for_drawings(folder, filename, prefix, tmp_path, monkeypatch):
    """Also where an undeclared prefix stands in the file, and from another working folder."""
    place = tmp_path / folder
    (place.parent / "meshes").mkdir(parents=True)
    place.mkdir()
    (place.parent / "package.xml").write_text("<package><name>named_by_xml</name></package>")
    (place.parent / "meshes" / "a.stl").write_text(TRIANGLE)
    monkeypatch.chdir(tmp_path)
    robot = Arm.from_urdf(with_mesh(place, filename, prefix), "hand", locked="others")
    assert check_file(robot.file).findings == ()
    payload = cp.Payload.box(1.0, (0.1, 0.1, 0.1))
    cell = cp.Cell(arms={"one": robot}, payload=payload, grasps={"one": cp.Pose()})
    shapes = [visual for body in CellVisuals(cell, "free").bodies for visual in body.visuals]
    assert sorted(type(visual.shape).__name__ for visual in shapes) == ["Box", "Mesh"]
    (place.parent / "meshes" / "a.stl").unlink()
    assert [finding.code for finding in check_file(robot.file).findings] == ["mesh_missing"]
    with pytest.warns(UrdfWarning, match="not drawn"):
        shapes = [visual for body in CellVisuals(cell, "free").bodies for visual in body.visuals]
    assert len(shapes) <= 1


@pytest.mark.parametrize("name", AXES)
def test_the_summary_of_a_robot_has_its_masses(name, tmp_path):
    parts = arm_parts(name, finger_mass=0.25)
    text = Robot(load_checked(find_urdf(written(tmp_path, *parts)))).summary()
    count = len(AXES[name])
    assert f"{count + 3} links, {count + 2.25:g} kg" in text
    assert "finger (0.25 kg)" in text
    assert f"finger: {count + 1} joints from the root" in text


def test_an_srdf_file_has_tips_of_chains_and_states_without_joints_of_several_values(tmp_path):
    (tmp_path / "robot.srdf").write_text(
        '<robot name="r"><group name="left"><chain base_link="base" tip_link="hand"/></group>'
        '<group name="both"><joint name="a"/></group><group_state name="home" group="left">'
        '<joint name="a" value="0.25"/><joint name="float" value="0 0 0 0 0 0 1"/>'
        '<joint name="b" value="-1"/></group_state><group_state name="none" group="left"/></robot>'
    )
    srdf = Srdf.read(tmp_path / "robot.srdf")
    assert srdf == ({"left": "hand"}, ({"a": 0.25, "b": -1.0}, {}))
    assert srdf.posture(["b", "a"]) == (-1.0, 0.25)
    with pytest.raises(UrdfError):
        Srdf.read(tmp_path / "none.srdf")


def test_an_srdf_names_two_arms_and_the_first_posture_that_is_none_of_zeros(tmp_path):
    """Of three chains of the same length, none is one of two; a state of other joints is no posture."""
    sides = ("left", "right", "third")
    parts = [link("base"), *(link(f"{side}{k}") for side in sides for k in range(2))]
    for side in sides:
        parts += [joint(f"{side}_a", "base", f"{side}0"), joint(f"{side}_b", f"{side}0", f"{side}1")]
    robot = Robot(load_checked(find_urdf(written(tmp_path, *parts))))
    tips, joints = {side: f"{side}1" for side in sides}, ("left_a", "left_b")
    two = {side: tips[side] for side in sides[:2]}
    states = ({"left_a": 1.0}, {"left_a": 0.0, "left_b": 0.0}, {"left_a": 0.0, "left_b": 0.5})
    assert Srdf(two, states).arms(robot) == sides[:2]
    assert Srdf({**two, "short": "third0"}, states).arms(robot) == sides[:2]
    assert Srdf(tips, states).arms(robot) == Srdf({"left": "left1"}, states).arms(robot) == ()
    assert Srdf(two, states).posture(joints) == (0.0, 0.5)
    assert Srdf(two, states[:2]).posture(joints) is None


@pytest.mark.parametrize("name", AXES)
def test_poses_of_links_are_those_of_pinocchio(name, tmp_path):
    """Of many configurations at once, prismatic joints and oblique axes among them."""
    parts = arm_parts(name)
    parts[2] = joint("j0", "base", "l0", axis="0.3 -0.4 1.2")
    robot = Robot(load_checked(find_urdf(path := written(tmp_path, *parts))))
    model = pin.buildModelFromUrdf(path)
    rows = np.random.default_rng(2).uniform(-2.0, 2.0, (5, model.nq))
    poses = robot.pose("finger", dict(zip(robot.joints, rows.T, strict=True)))
    data = model.createData()
    for q, X in zip(rows, poses, strict=True):
        pin.framesForwardKinematics(model, data, q)
        expected = data.oMf[model.getFrameId("finger")].homogeneous
        np.testing.assert_allclose(X, expected, rtol=0, atol=1e-14)
