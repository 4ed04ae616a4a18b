"""Check of URDF files: every defect is reported, Pinocchio reads all that passes, real robots pass."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from malformed_urdf import BODIES, CORPUS, PARTS, arm, chain

from coop_pin.base.errors import UrdfError, UrdfWarning
from coop_pin.description import urdf
from coop_pin.description.urdf import UrdfFile, check_file, check_urdf, find_urdf, load_checked, text_checked
from coop_pin.description.urdf.find import example_folder
from coop_pin.description.urdf.inertia import impossible_bodies
from coop_pin.description.urdf.tree import MAX_DEPTH, read_tree
from coop_pin.description.urdf.xml import MAX_BYTES, read_document

ARMS = ("panda", "ur3", "ur5", "ur10", "ur5_gripper", "kinova", "xarm7", "z1", "baxter", "so100", "so101")

# One process for each document: a crash of one must not hide the others. They are forked after the slow
# import.
JUDGE = """
import json, os, signal, sys, warnings
sys.path.insert(0, sys.argv[1])
import pinocchio
from coop_pin.description.urdf import check_urdf
from malformed_urdf import CORPUS

def judge(text):
    report = check_urdf(text)
    if any(finding.kind == "structural" for finding in report.findings):
        return 10
    try:
        pinocchio.buildModelFromXML(text)
    except Exception:
        return 11
    return 12

endings = {}
for name, malformed in CORPUS.items():
    child = os.fork()
    if child == 0:
        signal.alarm(60)
        os._exit(judge(malformed.text))
    endings[name] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(json.dumps(endings))
"""
REFUSED, BUILT = 10, 12


@pytest.fixture(scope="module")
def endings() -> dict[str, int]:
    """How the process of each document ended: an exit code, or minus a signal."""
    command = [sys.executable, "-c", JUDGE, str(Path(__file__).parents[1])]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True, timeout=300).stdout)


@pytest.mark.parametrize("name", CORPUS)
def test_a_defect_is_found_with_its_code_element_and_line_and_nothing_else_is(name):
    malformed = CORPUS[name]
    findings = check_urdf(malformed.text).findings
    expected = (malformed.code, malformed.element, malformed.line)
    kinds = {finding.kind for finding in findings if finding[1:4] == expected}
    assert kinds <= ({"physical", "impossible"} if malformed.physical else {"structural"})
    assert kinds
    assert {finding.code for finding in findings} == {malformed.code} | malformed.besides


@pytest.mark.parametrize("name", CORPUS)
def test_no_document_ends_its_process_and_pinocchio_builds_what_the_check_lets_pass(name, endings):
    assert endings[name] == (BUILT if CORPUS[name].physical else REFUSED)


def test_every_code_of_the_docstring_is_in_the_corpus_and_conversely():
    listed = inspect.getdoc(urdf).split("**Structural**")[1]
    codes = set(re.findall(r"``(\w+)``", listed))
    assert len(CORPUS) >= 40
    assert codes == {malformed.code for malformed in CORPUS.values()} | {
        *DOUBTFUL,
        "mesh_missing",
        "mesh_unreadable",
        "loop",
        "loop_unread",
    }


DOUBTFUL = {
    "limit_degrees": {"limit_1": '<limit lower="-170" upper="170" effort="1" velocity="1"/>'},
    "origin_far": {"origin_1": '<origin xyz="0 0 220"/>'},
    "passive_joint": {"limit_1": '<limit lower="-1" upper="1" effort="0" velocity="1"/>'},
}


@pytest.mark.parametrize("code", DOUBTFUL)
def test_doubtful_numbers_are_warned_of_even_when_strict(code):
    report = check_urdf(arm(**DOUBTFUL[code]))
    assert [(finding.code, finding.element) for finding in report.warnings(strict=True)] == [
        (code, "joint 'one'")
    ]
    assert report.errors(strict=True) == ()


def _stl(triangles: int, *, claimed: int) -> bytes:
    return bytes(80) + claimed.to_bytes(4, "little") + bytes(50 * triangles)


STL = {
    "empty": b"",
    "cut": _stl(1, claimed=1)[:-1],
    "claims 2^31": _stl(1, claimed=2**31),
    "none": _stl(0, claimed=0),
    "noise": b"\x07" * 90,
}


@pytest.mark.parametrize("content", STL.values(), ids=STL)
def test_a_corrupt_mesh_is_an_error_of_the_check(content, tmp_path):
    mesh = '<visual><geometry><mesh filename="package://here/part.stl"/></geometry></visual>'
    file = _file(tmp_path, arm(link_c=f'<link name="c">{mesh}</link>'))
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "part.stl").write_bytes(content)
    assert [finding.code for finding in check_file(file).errors()] == ["mesh_unreadable"]
    with pytest.raises(UrdfError, match="mesh_unreadable"):
        load_checked(file)
    (tmp_path / "here" / "part.stl").write_bytes(b"solid a\nfacet normal 0 0 1\nendfacet\nendsolid")
    assert check_file(file).errors() == ()


@pytest.mark.parametrize(
    "shape",
    ['<sphere radius="-1"/>', '<box size="1 -1 1"/>', '<cylinder radius="1" length="-1"/>'],
)
def test_a_negative_size_is_an_error(shape):
    visual = f'<link name="c"><visual><geometry>{shape}</geometry></visual></link>'
    assert "negative" in [finding.code for finding in check_urdf(arm(link_c=visual)).errors()]


LOOPS = {
    "loop_joint": '<loop_joint name="l" type="spherical"><link1 link="b"/><link2 link="c"/></loop_joint>',
    "constraint": '<constraint name="l" type="fixed"><parent link="b"/><child link="c"/></constraint>',
    "joint": '<gazebo><joint name="l" type="ball"><parent>b</parent><child>c</child></joint></gazebo>',
}


@pytest.mark.parametrize("tag", LOOPS)
def test_a_loop_is_never_dropped(tag):
    (finding,) = check_urdf(arm(more=LOOPS[tag])).errors()
    assert (finding.code, finding.element) == ("loop", f"{tag} 'l'")
    assert LOOPS[tag].startswith(arm(more=LOOPS[tag]).splitlines()[finding.line - 1].strip()[:6])
    with pytest.raises(UrdfError, match="loop"):
        text_checked(arm(more=LOOPS[tag]))


def test_gazebo_elements_that_close_no_loop_are_none():
    for more in (
        '<gazebo reference="one"><plugin name="p"><joint>one</joint></plugin></gazebo>',
        '<transmission name="t"><joint name="one"/></transmission>',
        '<ros2_control name="r"><joint name="one"/></ros2_control>',
    ):
        assert check_urdf(arm(more=more)).findings == ()
    codes = {finding.code for finding in check_file(find_urdf("pr2")).warnings()}
    assert "loop_unread" in codes


SIZES = {
    3: "origin xyz, origin rpy, axis xyz, box size, mesh scale",
    1: "mass value, inertia ixx, inertia ixy, inertia ixz, inertia iyy, inertia iyz, inertia izz,"
    " limit lower, limit upper, limit effort, limit velocity, mimic multiplier, mimic offset,"
    " dynamics damping, dynamics friction, calibration rising, calibration falling,"
    " safety_controller soft_lower_limit, safety_controller soft_upper_limit,"
    " safety_controller k_position, safety_controller k_velocity, sphere radius, cylinder radius,"
    " cylinder length, capsule radius, capsule length",
}
"""Attributes by the number of their values in the XML specification of URDF."""


@pytest.mark.parametrize(("size", "attributes"), SIZES.items())
def test_an_attribute_has_the_number_of_values_of_the_specification(size, attributes):
    for words in attributes.split(", "):
        tag, attribute = words.split()
        wrong = {}
        for values in (size - 1, size, size + 1):
            piece = f'<link name="d"><{tag} {attribute}="{" ".join(["1"] * values)}"/></link>'
            codes = {each.code for each in check_urdf(arm(more=piece)).findings}
            wrong[values] = bool(codes & {"count", "number"})
        assert wrong == {size - 1: True, size: False, size + 1: True}, words


def test_a_mesh_that_is_not_there_is_warned_of_with_its_link(tmp_path):
    mesh = '<mesh filename="package://{}/part.stl"/>'
    visuals = "".join(
        f"<visual><geometry>{mesh.format(name)}</geometry></visual>" for name in ("here", "gone")
    )
    heavy = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    file = _file(tmp_path, arm(link_c=f'<link name="c">{heavy}{visuals}</link>'))
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "part.stl").write_bytes(_stl(1, claimed=1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_checked(file)
    missing = [finding for finding in check_file(file).findings if finding.kind == "doubtful"]
    assert [(finding.code, finding.element) for finding in missing] == [("mesh_missing", "link 'c'")]
    assert "'package://gone/part.stl'" in missing[0].message


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "adept_3dof"])
def test_the_meshes_of_known_robots_are_there(name):
    assert "mesh_missing" not in {finding.code for finding in check_file(find_urdf(name)).findings}


def test_the_sound_arm_has_no_findings():
    assert check_urdf(arm()).findings == ()
    assert check_urdf(arm().encode()).findings == ()
    assert check_urdf("\ufeff" + arm()).findings == ()


@pytest.mark.parametrize(
    "parts",
    [
        {"axis_1": ""},
        {"mass": '<mass value=" +2.5e+0"/>'},
        {"origin_1": '<origin xyz=" 0  -.5 1. "/>'},
        {"joint_1": '<joint name="one" type="continuous">', "limit_1": ""},
        {"more": '<link name="tool"/><joint name="t" type="fixed"><parent link="c"/><child link="tool"/>'
         '<axis xyz="0 0 0"/></joint>'},
        {"link_c": '<link name="c"/>', "more": arm().splitlines()[10].replace('"c"', '"d"')
         + '<joint name="t" type="fixed"><parent link="c"/><child link="d"/></joint>'},
        {"more": '<gazebo><xacro_like value="nan"/></gazebo><!-- <xacro:x v="${m}"/> -->'},
        {"robot": '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'},
    ],
)  # fmt: skip
def test_what_is_legal_and_common_is_no_finding_and_pinocchio_builds_it(parts):
    text = arm(**parts)
    assert check_urdf(text).findings == ()
    pin.buildModelFromXML(text)


def test_prefixes_are_part_of_names_whether_declared_or_not_as_for_pinocchio():
    for head in ('<robot name="arm" xmlns="u:r" xmlns:o="u:o">', '<robot name="arm">'):
        text = arm(robot=head, more='<o:link name="c"/><link name="d" o:at="1"><o:inertial/></link>')
        codes = [finding.code for finding in check_urdf(text).findings]
        assert codes == ["two_roots"]
        assert pin.buildModelFromXML(
            text.replace('<link name="d"', '<o:link name="d"', 1)
            .replace("</o:inertial>", "")
            .replace("<o:inertial/></link>", "</o:link>")
        )
    cut = arm(more="<o:x/>" * 200)[:-4]
    assert [finding.code for finding in check_urdf(cut).errors()] == ["not_xml"]


def test_the_line_of_an_element_is_that_of_its_start_also_below_tags_of_several_lines():
    text = arm(
        axis_1='<axis\n\n xyz="0 0 0"\n/>', limit_1='<limit\nlower="1" upper="-1" effort="1" velocity="1"/>'
    )
    findings = check_urdf(text).findings
    assert [(finding.code, finding.line) for finding in findings] == [
        ("axis_zero", 15),
        ("limit_inverted", 19),
    ]


@pytest.mark.parametrize(
    "piece", ['<link name="{0}"/>', "<material/>", '<link name="l{0}"><visual/><visual/></link>']
)
def test_the_time_of_a_check_grows_with_the_elements_not_their_square(piece):
    text = '<robot name="r">' + "".join(piece.format(number) for number in range(10_000)) + "</robot>"
    started = time.process_time()
    assert check_urdf(text).errors()
    assert time.process_time() - started < 5.0


def test_a_tree_of_the_greatest_depth_passes_and_pinocchio_builds_it():
    text = chain(MAX_DEPTH, "revolute")
    assert check_urdf(text).errors() == ()
    assert pin.buildModelFromXML(text).njoints == MAX_DEPTH + 1


def test_strict_turns_warnings_into_errors():
    report = check_urdf(BODIES["inertia missing"].text)
    assert [finding.code for finding in report.warnings()] == ["inertia_missing"]
    assert report.errors() == report.warnings(strict=True) == ()
    assert report.errors(strict=True) == report.warnings()


def test_a_report_reads_as_one_line_for_each_finding_and_a_count():
    report = check_urdf(arm(inertia='<inertia ixx="1"/>', axis_1='<axis xyz="0 0 0"/>'))
    error, warning, count = report.summary().splitlines()
    assert re.match(r"error: line 15: joint 'one': .*\[axis_zero\]$", error)
    assert re.match(r"warning: line 7: link 'b': .*\[inertia_missing\]$", warning)
    assert count == "the text: 1 error, 1 warning"
    assert report.summary(strict=True).endswith("the text: 2 errors, 0 warnings")


def test_a_report_of_a_hostile_file_stays_short():
    report = check_urdf('<robot name="r">' + f'<link name="{"x" * 500}"/>' * 5000 + "</robot>")
    assert len(report.findings) == 4999
    assert len(report.summary()) < 30_000


@given(st.binary() | st.text())
@settings(deadline=None, max_examples=30)
def test_any_bytes_and_any_text_end_in_a_report(data):
    assert check_urdf(data).errors()


@given(st.data())
@settings(deadline=None, max_examples=150)
def test_an_arm_with_a_piece_cut_out_or_doubled_is_refused_or_built(data):
    text = arm()
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 40)))
    mutilated = text[:start] + text[start:end] * data.draw(st.sampled_from([0, 2])) + text[end:]
    if not check_urdf(mutilated).errors():
        pin.buildModelFromXML(mutilated)


@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=1, max_size=6),
    st.sampled_from([1e-9, 1.0, 1e9]),
)
@settings(deadline=None)
def test_the_inertia_of_any_set_of_points_is_possible(points, scale):
    """I = sum_i |r_i|^2 1 - r_i r_i^T, the oracle of both inequalities."""
    r = np.array(points)
    inertia = scale * (np.sum(r * r) * np.eye(3) - r.T @ r)
    assert check_urdf(_with_inertia(inertia)).findings == ()


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(1e-3, 1.0), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_an_inertia_beyond_the_triangle_inequality_is_found_in_any_axes(I1, I2, excess, seed):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    inertia = turn @ np.diag([I1, I2, I1 + I2 + excess]) @ turn.T
    assert [finding.code for finding in check_urdf(_with_inertia(inertia)).findings] == ["inertia_triangle"]


def _with_inertia(inertia: np.ndarray) -> str:
    entries = " ".join(f'i{"xyz"[i]}{"xyz"[j]}="{inertia[i, j]!r}"' for i in range(3) for j in range(i, 3))
    return arm(inertia=f"<inertia {entries}/>".replace("np.float64(", "").replace(")", ""))


# ---------------------------------------------------------------- real robots


@pytest.mark.parametrize("name", ARMS)
def test_the_arms_of_example_robot_data_have_no_structural_findings_and_load(name):
    file = find_urdf(name)
    assert check_file(file).errors() == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = load_checked(file)
    assert pin.buildModelFromXML(text).njoints > 5


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_pinocchio_builds_every_example_that_passes_and_few_do_not(every):
    stubs = {"ur3", "alex_psyonic_hands"}
    files = sorted(example_folder().glob("*/*/*.urdf"))
    files = [path for at, path in enumerate(files) if at % every == 0 or path.stem in stubs]
    passed = [path for path in files if not check_file(find_urdf(path)).errors()]
    for path in passed:
        pin.buildModelFromXML(path.read_text(encoding="utf-8"))
    # ur3.urdf is an empty stub, alex_psyonic_hands.urdf mimics joints that it does not have.
    assert {path.stem for path in files} - {path.stem for path in passed} == stubs


# ---------------------------------------------------------------- loading


def _file(folder: Path, text: str) -> UrdfFile:
    (folder / "arm.urdf").write_text(text, encoding="utf-8")
    return find_urdf(folder / "arm.urdf")


def test_a_sound_file_is_loaded_as_it_is(tmp_path):
    assert load_checked(_file(tmp_path, arm()), strict=True) == arm()


def test_an_error_names_every_finding(tmp_path):
    file = _file(
        tmp_path, arm(mass='<mass value="abc"/>', axis_1='<axis xyz="0 0 0"/>', inertia='<inertia ixx="1"/>')
    )
    with pytest.raises(UrdfError) as caught:
        load_checked(file)
    for words in (
        "line 6: link 'b'",
        "'abc'",
        "line 15: joint 'one'",
        "inertia_missing",
        "2 errors, 1 warning",
        str(file.path),
    ):
        assert words in caught.value.detail


IMPOSSIBLE = (
    "mass negative",
    "mass zero",
    "inertia negative",
    "inertia of no body",
    "inertia of no body, turned",
)


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_impossible_bodies_that_move_are_errors_in_a_users_file(name, tmp_path):
    file = _file(tmp_path, BODIES[name].text)
    with pytest.raises(UrdfError, match=BODIES[name].code):
        load_checked(file)
    with pytest.raises(UrdfError, match=BODIES[name].code):
        text_checked(BODIES[name].text)


def test_those_that_do_not_move_and_rounding_noise_are_warned_of(tmp_path):
    fixed = arm(
        mass='<mass value="-2.5"/>',
        **{
            part: text.replace("revolute", "fixed")
            for part, text in PARTS.items()
            if part.startswith("joint_")
        },
    )
    noise = '<inertia ixx="-2e-35" iyy="0" izz="2e-35" ixy="0" ixz="0" iyz="0"/>'
    for text, code in ((fixed, "mass_negative"), (arm(inertia=noise), "inertia_not_psd")):
        with pytest.warns(UrdfWarning, match=code):
            load_checked(_file(tmp_path, text))
        with pytest.raises(UrdfError, match=code):
            load_checked(_file(tmp_path, text), strict=True)


@pytest.mark.parametrize("travel", [0.0, 0.03])
def test_a_body_of_three_links_is_possible_where_their_sum_by_pinocchio_is(travel):
    """An impossible link and two sound ones beyond fixed joints, or beyond a slide that is locked at 3 cm."""
    rng, verdicts = np.random.default_rng(4), []
    for _ in range(40):
        X, more = pin.SE3.Identity(), ""
        whole = pin.Inertia(2.5, np.array((0.1, 0.0, 0.0)), np.diag((0.02, 0.03, 0.056)))
        for parent, child, kind in (("b", "d", "prismatic" if travel else "fixed"), ("d", "e", "fixed")):
            m, p, rpy = rng.uniform(0.05, 1.0), 0.03 * rng.normal(size=3), rng.uniform(-1.0, 1.0, 3)
            ixx, iyy, izz = 0.001 * rng.uniform(1.0, 1.4, 3)
            more += (
                f'<link name="{child}"><inertial><mass value="{m}"/><origin xyz="0 0.02 0"/>'
                f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="to_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
                '<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/>'
                f'<origin xyz="{p[0]} {p[1]} {p[2]}"'
                f' rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/></joint>'
            )
            X = X * pin.SE3(pin.rpy.rpyToMatrix(rpy), p)
            X = X * pin.SE3(np.eye(3), np.array((0.0, 0.0, travel * (child == "d"))))
            whole += X.act(pin.Inertia(m, np.array((0.0, 0.02, 0.0)), np.diag((ixx, iyy, izz))))
        inertia = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.056"/>'
        tree = read_tree(read_document(arm(inertia=inertia, more=more).encode()))
        I1, I2, I3 = np.linalg.eigvalsh(whole.inertia)
        verdicts.append(bool(impossible_bodies(tree, {"to_d": travel} if travel else {})))
        assert verdicts[-1] == (I3 > I1 + I2)
    assert 5 < sum(verdicts) < 35


def test_impossible_bodies_of_known_robots_are_not_warned_of_but_errors_when_strict():
    file = find_urdf("icub")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_checked(file)
    with pytest.raises(UrdfError, match="inertia_not_psd"):
        load_checked(file, strict=True)


def test_a_file_that_is_gone_a_folder_and_a_huge_file_are_typed_errors(tmp_path):
    for path in (tmp_path / "gone.urdf", tmp_path):
        with pytest.raises(UrdfError):
            check_file(UrdfFile(path, ()))
    huge = tmp_path / "huge.urdf"
    with huge.open("wb") as file:
        file.truncate(100 * MAX_BYTES)
    with pytest.raises(UrdfError, match=str(100 * MAX_BYTES)):
        check_file(find_urdf(huge))
