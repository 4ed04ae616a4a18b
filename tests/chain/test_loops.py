"""Loops that a URDF states in its file: the closed chain is that of the same closure in Python."""

import re

import numpy as np
import pytest
from linkages import ALPHA, A, B, bar, bennett, bennett_parts, bennett_start, four_bar, link, robot
from malformed_urdf import HERE, arm
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.errors import UrdfError
from coop_pin.base.spatial import make_pose, rpy_from_rotation
from coop_pin.description.urdf import check_urdf


def text(values):
    return " ".join(repr(float(value)) for value in np.ravel(values))


def origin(X):
    return f'xyz="{text(X[:3, 3])}" rpy="{text(rpy_from_rotation(X[:3, :3]))}"'


def loop_joint(a, b, kind, X_AC, X_BC, axis):
    return (
        f'<loop_joint name="shut" type="{kind}"><link1 link="{a}" {origin(X_AC)}/>'
        f'<link2 link="{b}" {origin(X_BC)}/><axis xyz="{text(axis)}"/></loop_joint>'
    )


def urdf_plus(a, b, kind, X_AC, X_BC, axis):
    return (
        f'<loop name="shut" type="{kind}"><predecessor link="{a}"><origin {origin(X_AC)}/></predecessor>'
        f'<successor link="{b}"><origin {origin(X_BC)}/></successor><axis xyz="{text(axis)}"/></loop>'
    )


def constraint(a, b, kind, X_AC, X_BC, axis):
    return (
        f'<constraint name="shut" type="{kind}"><parent link="{a}"/><parent_origin {origin(X_AC)}/>'
        f'<parent_axis xyz="{text(axis)}"/><child link="{b}"/><child_origin {origin(X_BC)}/></constraint>'
    )


def sdformat(a, b, kind, _X_AC, X_BC, axis):
    """A pose in the child alone: that in the parent follows from the zero configuration."""
    pose = text((*X_BC[:3, 3], *rpy_from_rotation(X_BC[:3, :3])))
    kind = "ball" if kind == "spherical" else kind
    return (
        f'<gazebo>\n<joint name="shut" type="{kind}"><parent> {a}\n</parent><child>{b}</child>'
        f"<pose>\n{pose}\n</pose><axis><xyz>{text(axis)}</xyz></axis></joint></gazebo>"
    )


def drake_ball(a, b, _kind, X_AC, X_BC, _axis):
    prefix = "drake:ball_constraint"
    return (
        f'<{prefix} name="shut"><{prefix}_body_A name="{a}"/><{prefix}_body_B name="{b}"/>'
        f'<{prefix}_p_AP value="{text(X_AC[:3, 3])}"/><{prefix}_p_BQ value="{text(X_BC[:3, 3])}"/></{prefix}>'
    )


FORMS = (loop_joint, urdf_plus, constraint, sdformat, drake_ball)
NAMED = {"point": "spherical", "axis": "revolute"}
TURN = Rotation.from_rotvec((0.4, -1.1, 0.7)).as_matrix()


def read(parts, loop, **options):
    return cp.ClosedChain.from_urdf(robot(*parts, loop), **options)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("rows", ["point", "axis"])
def test_a_planar_four_bar_is_the_same_bits_with_the_loop_in_its_file(form, rows):
    if (form, rows) == (drake_ball, "axis"):
        form = loop_joint
    end, gravity = make_pose((1.0, 0.0, 0.0)), (0.0, -9.81, 0.0)
    bars = [four_bar.rod(*where) for where in (("upright0", "ground", 0), ("upright1", "ground", 1))]
    bars.append(four_bar.rod("level0", "upright0", 1.0))
    stated = cp.ClosedChain.from_urdf(
        robot(*bars), [cp.Closure("level0", "upright1", rows, end, end)], gravity=gravity
    )
    chain = read(bars, form("level0", "upright1", NAMED[rows], end, end, (0, 0, 1)), gravity=gravity)
    (closure,) = chain.closures.closures
    assert (closure.name, closure.frame_a, closure.frame_b, closure.rows) == (
        "shut",
        "level0",
        "upright1",
        rows,
    )
    start = four_bar.start(chain, 1)
    motion, other = (each.integrate(*start, duration=0.3, step=5e-3) for each in (chain, stated))
    assert np.ptp(motion.q[:, 0]) > 0.2
    assert_array_equal(motion.q, other.q)
    assert_array_equal(motion.v, other.v)


@pytest.mark.parametrize("form", [loop_joint, urdf_plus, constraint])
def test_a_bennett_linkage_moves_the_same_with_its_hinge_in_the_file(form):
    """The hinge is along an axis of turned frames, not along z."""
    bars, closure = bennett_parts("axis")
    turned = [X @ make_pose(rpy=rpy_from_rotation(TURN.T)) for X in (closure.X_AC, closure.X_BC)]
    chain = read(bars, form("three", "world", "revolute", *turned, 3.0 * TURN[:, 2]))
    stated, start = bennett("axis")
    motion, other = (each.integrate(*start, duration=0.6, step=1e-2) for each in (chain, stated))
    assert np.ptp(motion.q[:, 0]) > 0.2
    assert_allclose(motion.q, other.q, rtol=0, atol=1e-12)
    assert_allclose(motion.v, other.v, rtol=0, atol=1e-12)
    assert_allclose(bennett_start(chain).q, start.q, rtol=0, atol=1e-10)


def test_an_sdformat_hinge_is_on_the_parent_where_it_is_in_the_zero_configuration():
    """A Bennett linkage whose zero configuration is closed: joint origins are turned by the start angles."""
    stated, start = bennett("axis")
    origins = [((0, 0, 0), 0.0), ((A, 0, 0), ALPHA), ((B, 0, 0), 1.1)]
    turned = [
        rpy_from_rotation((Rotation.from_euler("x", twist) * Rotation.from_euler("z", angle)).as_matrix())
        for (_, twist), angle in zip(origins, start.q, strict=True)
    ]
    links = (("one", "ground", A), ("two", "one", B), ("three", "two", A))
    bars = [
        bar(name, parent, xyz, rpy, length=length)
        for (name, parent, length), (xyz, _), rpy in zip(links, origins, turned, strict=True)
    ]
    hinge = make_pose((A, 0, 0), (ALPHA, 0, 0)) @ make_pose(rpy=rpy_from_rotation(TURN.T))
    for parent in ("world", "ground"):
        chain = read(bars, sdformat(parent, "three", "revolute", None, hinge, TURN[:, 2]))
        motion = chain.integrate(0.0 * start.q, start.v, duration=0.2, step=5e-3)
        other = stated.integrate(*start, duration=0.2, step=5e-3)
        assert_allclose(motion.q + start.q, other.q, rtol=0, atol=1e-11)


def test_a_prismatic_loop_slides_along_its_axis_and_a_fixed_one_does_not():
    slides = [
        f'{link(name)}<joint name="{name}" type="prismatic"><parent link="{parent}"/><child link="{name}"/>'
        f'<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="0" velocity="0"/></joint>'
        for name, parent, axis in (("x", "ground", "1 0 0"), ("y", "x", "0 1 0"), ("z", "y", "0 0 1"))
    ]
    along, across = np.array((1.0, 2.0, 2.0)) / 3.0, np.array((2.0, 1.0, -2.0)) / 3.0
    slide = read(slides, constraint("ground", "z", "prismatic", np.eye(4), np.eye(4), along))
    weld = read(slides, constraint("ground", "z", "link", np.eye(4), np.eye(4), along))
    for q, distance in ((0.3 * along, 0.0), (0.2 * across, 0.2), (0.3 * along - 0.2 * across, 0.2)):
        assert slide.closure_errors(q)[0].distance == pytest.approx(distance, abs=1e-15)
        assert weld.closure_errors(q)[0].distance == pytest.approx(np.linalg.norm(q), abs=1e-15)
    assert (slide.closures.rows, weld.closures.rows) == (5, 6)


def test_closures_in_python_follow_those_of_the_file():
    bars, closure = bennett_parts("point")
    loop = loop_joint("three", "world", "spherical", closure.X_AC, closure.X_BC, (0, 0, 1))
    more = cp.Closure("one", "two", (False, False, True, False, False, False), name="mine")
    chain = cp.ClosedChain.from_urdf(robot(*bars, loop), [more])
    assert [each.name for each in chain.closures.closures] == ["shut", "mine"]
    unnamed = cp.ClosedChain.from_urdf(robot(*bars, loop.replace('name="shut" ', "")))
    assert [each.name for each in unnamed.closures.closures] == ["three - world"]


# ---------------------------------------------------------------- refused

ENDS = '<link1 link="b"/><link2 link="c"/>'
_BUSHING = "drake:linear_bushing_rpy"
UNREAD = {
    "type": f'<loop_joint name="l" type="universal">{ENDS}</loop_joint>',
    "no type": f'<loop_joint name="l">{ENDS}</loop_joint>',
    "no axis": f'<loop_joint name="l" type="revolute">{ENDS}</loop_joint>',
    "zero axis": f'<loop_joint name="l" type="revolute">{ENDS}<axis xyz="0 0 0"/></loop_joint>',
    "axis": f'<loop_joint name="l" type="revolute">{ENDS}<axis xyz="0 1"/></loop_joint>',
    "one side": '<loop_joint name="l" type="fixed"><link1 link="b"/><link1 link="c"/></loop_joint>',
    "other form": '<loop_joint name="l" type="fixed"><parent link="b"/><child link="c"/></loop_joint>',
    "number": '<loop_joint name="l" type="fixed"><link1 link="b" xyz="0 0 ${x}"/><link2 link="c"/>'
    "</loop_joint>",
    "no link": '<loop_joint name="l" type="fixed"><link1/><link2 link="c"/></loop_joint>',
    "unknown link": '<loop_joint name="l" type="fixed"><link1 link="b"/><link2 link="d"/></loop_joint>',
    "itself": '<loop_joint name="l" type="fixed"><link1 link="b"/><link2 link="b"/></loop_joint>',
    "two axes": '<constraint name="l" type="universal"><parent link="b"/><child link="c"/>'
    '<parent_axis xyz="1 0 0"/><child_axis xyz="0 1 0"/></constraint>',
    "gear": '<constraint name="l" type="rolling"><predecessor link="b"/><successor link="c"/></constraint>',
    "coupling": '<coupling name="l"><predecessor link="b"/><successor link="c"/></coupling>',
    "bushing": f"<{_BUSHING}/>",
    "closed_loop": '<closed_loop name="l"/>',
    "old Gazebo": '<gazebo><joint:hinge name="l"><body1>b</body1><body2>c</body2></joint:hinge></gazebo>',
    "of a link": '<gazebo reference="b"><joint name="l" type="ball"><parent>b</parent><child>c</child>'
    "</joint></gazebo>",
    "relative_to": '<gazebo><joint name="l" type="ball"><parent>b</parent><child>c</child>'
    '<pose relative_to="b">0 0 0 0 0 0</pose></joint></gazebo>',
    "model frame": '<gazebo><joint name="l" type="revolute"><parent>b</parent><child>c</child><axis>'
    "<xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame></axis></joint></gazebo>",
    "long text": f'<gazebo><joint name="l" type="ball"><parent>{"b" * 9999}</parent><child>c</child>'
    "</joint></gazebo>",
}


@pytest.mark.parametrize("name", UNREAD)
def test_a_loop_that_cannot_be_read_is_refused_by_its_line(name):
    document = arm(more="\n\n" + UNREAD[name] + HERE)
    (finding,) = check_urdf(document).errors()
    line = document[: document.index(HERE)].count("\n") + 1
    assert (finding.code, finding.line) == ("loop_unread", line)
    assert len(finding.message) < 400
    with pytest.raises(UrdfError, match=rf"line {line}: .*\[loop_unread\]"):
        cp.ClosedChain.from_urdf(document)


def test_two_loops_must_not_have_one_name():
    loop = f'<loop_joint name="l" type="fixed">{ENDS}</loop_joint>'
    report = check_urdf(arm(more=loop + "\n" + loop))
    assert [finding.code for finding in report.errors()] == ["loop", "loop_unread"]


def test_the_gripper_loops_of_pr2_are_refused_as_a_mechanism():
    with pytest.raises(UrdfError, match=r"joint:hinge 'r_gripper_r_parallel_tip_joint'.*\[loop_unread\]"):
        cp.ClosedChain.from_urdf("pr2", mimic="ignore")


@pytest.mark.parametrize("form", FORMS)
def test_an_arm_with_a_loop_is_refused_by_its_line(form, tmp_path):
    loop = form("b", "c", "spherical", np.eye(4), np.eye(4), (0, 0, 1))
    (tmp_path / "arm.urdf").write_text(arm(more=loop))
    with pytest.raises(UrdfError) as caught:
        cp.model.ArmModel(cp.Arm.from_urdf(tmp_path / "arm.urdf", tip="c"))
    assert re.search(r"line \d+: \S+ 'shut': .* an arm is a tree.*\[loop\]", str(caught.value))
