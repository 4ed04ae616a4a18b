"""New cells from the names of arms: places, files that read back, runs, and refusals with numbers."""

import functools
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from lifts import spatial_robot
from numpy.testing import assert_allclose
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import (
    FieldError,
    InfeasibleMotionError,
    NameNotFoundError,
    OutOfRangeError,
    ScenarioError,
    UrdfError,
)
from coop_pin.cli import main
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.design.named_arms import RobotFiles, arms_of_robot
from coop_pin.design.new_cell import _below_ground
from coop_pin.design.placing.contacts import contacts
from coop_pin.feasibility import distances, maximum_reach
from coop_pin.feasibility.motion_feasibility import joint_heights
from coop_pin.running.plausibility import implausible_numbers

CELLS = {
    "planar": (["adept_3dof"] * 2, {"payload": "bar", "size": (0.24, 0.03, 0.03), "mass": 5.0}),
    "unlike": (["xarm7", "ur10"], {"mass": 5.0}),
    "three": (["ur5", "panda", "ur10"], {"payload": "plate", "grasp": "above", "mass": 3.0}),
}


LONG = ("unlike", "three")
"""Cells whose proposals take long; a command of the README makes the first."""


@functools.cache
def proposed(name):
    arms, options = CELLS[name]
    return cp.new_cell(arms, name=name, **options)


@pytest.fixture(
    scope="module",
    params=["planar", *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)],
)
def made(request):
    return request.param, proposed(request.param)


def test_a_new_cell_runs_as_written_and_reads_back_from_its_file(made, tmp_path):
    """The file in full, too: comments and left-out defaults change no value."""
    name, suggestion = made
    scenario = suggestion.scenario
    scenario.save(tmp_path / "new.toml", commented=True)
    again = cp.Scenario.load(tmp_path / "new.toml")
    assert again == scenario == cp.Scenario.from_toml(scenario.to_toml())
    result = cp.run(again, {"duration": 2.0}, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept"), (name, result.verdict())
    assert np.abs(result.data.pose_error.values[:, :3]).max() < 1e-3


def test_the_arms_stand_around_the_payload_within_their_reach(made):
    """Bases upright on one ground, tips on the payload and tools towards it; planar arms in its plane."""
    name, suggestion = made
    cell, height = suggestion.scenario.cell, suggestion.scenario.start.xyz[2]
    assert cell.rows == ("planar" if name == "planar" else "full")
    half = np.array(cell.payload.size) / 2.0
    for key, arm in cell.arms.items():
        tip = np.array(cell.grasps[key].xyz)
        assert arm.base.rpy[:2] == (0.0, 0.0)
        assert arm.base.xyz[2] == pytest.approx(0.0, abs=1e-9)
        assert 0.3 < np.linalg.norm(tip[:2] - arm.base.xyz[:2]) / maximum_reach(arm) < 0.9
        assert (np.abs(tip) <= half + 1e-3).all()
        tool = cell.grasps[key].matrix[:3, 2]
        towards = {"three": (0.0, 0.0, -1.0), "unlike": -tip / np.linalg.norm(tip)}.get(name)
        if towards is not None:  # a grasp may be turned about its tool
            np.testing.assert_allclose(tool, towards, atol=1e-6)
        model = cp.model.ArmModel(arm)
        assert name == "planar" or min(joint_heights(model, model.posture(arm.posture)).values()) > 0.0
    assert not implausible_numbers(suggestion.scenario)
    assert distances(suggestion.scenario, poses=11).nearest.distance > cell.clearance == 0.01
    assert height >= (0.0 if name == "planar" else half[2] + 0.05 - 0.005)  # rounded to centimetres
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    gaps = np.linalg.norm(bases[:, None] - bases, axis=-1)[np.triu_indices(len(bases), 1)]
    assert gaps.min() > 0.5


def test_arms_side_by_side_stand_on_one_side():
    """Placement only: of two arms, and of three around a round plate."""
    cylinder = cp.Payload.cylinder(2.0, 0.25, 0.04)
    for count, payload in ((2, cp.Payload.box(2.0, (0.8, 0.1, 0.1))), (3, cylinder)):
        found = list(contacts(payload, count, "above", "side-by-side"))
        assert all(np.sin(contact.around) < -0.49 for contact in found)
        assert all(contact.point[2] == payload.size[2] / 2.0 for contact in found)
        facing = list(contacts(payload, count, "sides", "facing"))
        outward = np.array([[np.cos(contact.around), np.sin(contact.around), 0.0] for contact in facing])
        np.testing.assert_allclose(outward.sum(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose([contact.approach for contact in facing], -outward, atol=1e-12)


@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("size", [(0.8, 0.05, 0.05), (0.05, 0.8, 0.05)])
def test_arms_around_a_bar_hold_it_apart(count, size):
    """Evenly around it two would meet across its 50 mm, and did by 28 mm."""
    payload = cp.Payload.box(2.0, size)
    for side in ("sides", "above"):
        around = list(contacts(payload, count, side, "facing"))
        points = np.array([contact.point for contact in around])
        gaps = np.linalg.norm(points[:, None] - points, axis=-1)[np.triu_indices(count, 1)]
        assert gaps.min() > 0.13
        assert (np.abs(points) <= np.array(size) / 2.0 + 1e-12).all()


def test_a_joint_below_the_ground_is_told():
    """Three UR5 and their plate, all of them half a metre lower."""
    scenario = cp.Scenario.load("three-ur5-plate")
    assert not list(_below_ground(scenario))
    arms, at = scenario.cell.arms, (0.0, 0.0, -0.2)
    sunk = {f"cell.arms.{name}.base.xyz": (*arm.base.xyz[:2], -0.5) for name, arm in arms.items()}
    low = scenario.override({**sunk, "start.xyz": at, "motion.start.xyz": at, "motion.goal.xyz": at})
    told = list(_below_ground(low))
    assert [line.partition(":")[0] for line in told] == list(arms)
    assert all("m below the ground" in line for line in told)


REFUSED = {
    "unknown": (["xarm", "ur10"], {}, UrdfError, "arms.left"),
    "two arms in a robot": (["baxter"] * 2, {}, UrdfError, "arms.left"),
    "one arm": (["ur5"], {}, UrdfError, "arms.0"),
    "no arm": ([], {}, FieldError, "arms"),
    "mobile base": ([cp.Arm(urdf="ur5", tip="tool0", mobile_base={})] * 2, {}, FieldError, "arms"),
    "arm, not robot": ([cp.Arm(urdf="ur5", tip="tool0")], {}, FieldError, "arms"),
    "a joint in place of a tip": (["baxter"], {"tips": ["left_s0", "right_s0"]}, NameNotFoundError, None),
    "tips": (["ur5"] * 2, {"tips": ["tool0"]}, FieldError, "tips"),
    "payload": (["ur5"] * 2, {"payload": "boxx"}, FieldError, "payload"),
    "grasp": (["ur5"] * 2, {"grasp": "below"}, FieldError, "grasp"),
    "layout": (["ur5"] * 2, {"layout": "around"}, FieldError, "layout"),
    "mass": (["ur5"] * 2, {"mass": -1.0}, FieldError, "mass"),
    "four joints": (["so100"] * 2, {"locked": {"wrist_roll": 0.0}}, InfeasibleMotionError, "rank"),
    "joint of no robot": (["ur5"] * 2, {"locked": {"lift": 0.0}}, NameNotFoundError, None),
    "inertia": (["ur5"] * 2, {"impossible_inertia": "mend"}, ScenarioError, None),
    "bases too far": (["adept_3dof"] * 2, {"distance": 3.0}, InfeasibleMotionError, "reach"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_a_cell_is_refused_by_name(case):
    arms, options, error, place = REFUSED[case]
    with pytest.raises(error) as caught:
        cp.new_cell(arms, **options)
    assert getattr(caught.value, "cause", None) or place in (None, getattr(caught.value, "path", ""))
    if isinstance(caught.value, InfeasibleMotionError):
        assert caught.value.cause == place
        assert case != "four joints" or "five joints or more" in str(caught.value)
    if case in ("unknown", "two arms in a robot"):
        assert {"unknown": "xarm7", "two arms in a robot": "left_gripper"}[case] in str(caught.value)


@pytest.mark.gate
def test_bases_are_refused_from_the_reach_on_and_a_payload_from_the_mass_that_is_named():
    """Both numbers are checked: just within them the cell is made, and the distance is kept."""
    options = {"payload": "bar", "size": (0.24, 0.03, 0.03)}
    with pytest.raises(InfeasibleMotionError) as far:
        cp.new_cell(["adept_3dof"] * 2, distance=3.0, **options)
    (allowed,) = re.findall(r"less than ([\d.]+) m", str(far.value))
    assert float(allowed) == pytest.approx(maximum_reach(cp.Arm(urdf="adept_3dof")) + 0.12, abs=0.006)
    with pytest.raises(InfeasibleMotionError) as tight:  # the stroke has no room at the reach itself
        cp.new_cell(["adept_3dof"] * 2, distance=float(allowed) - 0.005, **options)
    assert tight.value.cause == "reach"
    near = cp.new_cell(["adept_3dof"] * 2, distance=0.6, **options).scenario.cell
    assert [arm.base.xyz[0] for arm in near.arms.values()] == [-0.6, 0.6]


@pytest.mark.slow
def test_a_payload_beyond_the_drives_is_refused_with_a_mass_that_they_hold():
    arms = ["ur5"] * 2
    with pytest.raises(InfeasibleMotionError) as heavy:
        cp.new_cell(arms, mass=50.0)
    assert heavy.value.cause == "torque"
    (held,) = re.findall(r"from 50 to ([\d.]+) kg", str(heavy.value))
    lighter = cp.new_cell(arms, mass=0.95 * float(held)).scenario
    assert cp.feasibility.static_torques(lighter, poses=11).ok


def test_the_command_writes_the_scenario_and_overwrites_none(tmp_path, capsys):
    words = ["new", str(tmp_path / "planar"), "--arms", "adept_3dof", "adept_3dof", "--payload", "bar"]
    words += ["--size", "0.24", "0.03", "0.03", "--mass", "5"]
    assert main(words) == 0
    said, file = capsys.readouterr().out, tmp_path / "planar.toml"
    assert str(file) in said
    scenario = cp.Scenario.load(file)
    assert scenario == proposed("planar").scenario
    text = file.read_text(encoding="utf-8")
    tables = re.findall(r"^(.*)\n\[.*\]$", text, re.MULTILINE)
    assert len(tables) >= 12
    assert all(line.startswith("# ") for line in tables)
    assert 'kind = "box"' in text
    assert main(words) == 2
    assert file.read_text(encoding="utf-8") == text


def test_help_lists_the_options(capsys):
    with pytest.raises(SystemExit):
        main(["new", "--help"])
    told = capsys.readouterr().out
    options = ("arms", "payload", "mass", "size", "grasp", "layout", "tips", "distance")
    options += ("motion", "squeeze", "clearance", "xacro-args", "package-dirs")
    assert [option for option in options if f"--{option}" not in told] == []


@pytest.mark.parametrize("name", cp.scenario_names())
def test_scenarios_of_the_catalogue_read_back_from_commented_files(name):
    scenario = cp.Scenario.load(name)
    text = scenario.to_toml(commented=True)
    assert cp.Scenario.from_toml(text) == scenario
    assert len(text) < len(scenario.to_toml()) + 4000


def test_every_robot_that_is_an_arm_tells_its_tip_and_the_gripper_is_locked():
    """Frames of tools by name; of a gripper the link before its first joint."""
    tips = {
        "panda": ("panda_hand_tcp", ["panda_finger_joint1"]),
        "ur5": ("tool0", []),
        "kinova": ("j2s6s200_end_effector", []),
        "xarm7": ("link_eef", []),
        "adept_3dof": ("tip", []),
        "z1": ("link06", ["jointGripper"]),
        "talos_arm": ("wrist_left_ft_tool_link", ["gripper_left_joint"]),  # with mimic joints that are fixed
    }
    for name, (tip, locked) in tips.items():
        robot = Robot(load_checked(find_urdf(name)))
        assert robot.tools() == (tip,)
        assert list(robot.idle(tip)) == locked
        arm = cp.Arm.from_urdf(name, tip, locked=robot.idle(tip))
        assert cp.model.ArmModel(arm).nv == len(robot.unlocked(arm.locked))
    with pytest.raises(NameNotFoundError):
        robot.idle("nowhere")


@pytest.mark.parametrize("motion", by_default(["circle", "hold"], "circle"))
def test_motion_and_squeeze_are_those_asked_for(motion):
    edges = (0.24, 0.03, 0.03)
    new = cp.new_cell(["adept_3dof"] * 2, "bar", size=edges, motion=motion, squeeze=7.5)
    scenario = new.scenario
    assert (scenario.motion.kind, scenario.squeeze.force) == (motion, 7.5)
    at = np.array([scenario.motion.at(t).X_WP_d[:3, 3] for t in np.linspace(0.0, 8.0, 81)])
    assert_allclose(at[0], scenario.start.xyz, atol=1e-12)
    assert (np.ptp(at, axis=0)[:2].min() > 0.01) == (motion == "circle")
    result = cp.run(scenario.replace(duration=1.0), warn=False)
    assert result.simulation_sound
    assert result.data["internal_axial"].values[-1, 0] == pytest.approx(-7.5, abs=0.5)


def test_a_pull_is_refused():
    with pytest.raises(OutOfRangeError):
        cp.new_cell(["adept_3dof"] * 2, squeeze=-1.0)


def test_a_written_cell_is_read_wherever_its_folder_goes(tmp_path, monkeypatch):
    """Files are named from the scenario's folder, robots by their names."""
    (tmp_path / "here" / "robots").mkdir(parents=True)
    file = tmp_path / "here" / "robots" / "mine.urdf"
    shutil.copy(find_urdf("adept_3dof").path, file)
    monkeypatch.chdir(tmp_path / "here")
    words = ["new", "pair", "--arms", "robots/mine.urdf", "adept_3dof", "--payload", "bar"]
    words += ["--size", "0.24", "0.03", "0.03", "--squeeze", "5", "--motion", "hold"]
    assert main(words) == 0
    arms = tomllib.loads(Path("pair.toml").read_text())["cell"]["arms"]
    assert [arm["urdf"] for arm in arms.values()] == ["robots/mine.urdf", "adept_3dof"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").rename(tmp_path / "there")
    scenario = cp.Scenario.load("there/pair.toml")
    assert scenario.cell.arms["left"].file.path == (tmp_path / "there" / "robots" / "mine.urdf").resolve()
    assert (scenario.motion.kind, scenario.squeeze.force) == ("hold", 5.0)


@pytest.mark.gate
def test_xacro_arguments_reach_the_arms(tmp_path, monkeypatch):
    pytest.importorskip("xacrodoc")
    text = find_urdf("adept_3dof").path.read_text()
    name = re.search(r'<robot[^>]*name="([^"]+)"', text)[1]
    head = f'<robot name="{name}" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    head += '<xacro:arg name="reach" default="0"/>'
    (tmp_path / "arm.xacro").write_text(re.sub(r"<robot[^>]*>", head, text, count=1))
    monkeypatch.chdir(tmp_path)
    words = ["new", "pair", "--arms", "arm.xacro", "arm.xacro", "--payload", "bar"]
    words += ["--size", "0.24", "0.03", "0.03"]
    assert main([*words, "--xacro-args", "reach"]) == 2
    assert main([*words, "--xacro-args", "reach:=2"]) == 0
    scenario = cp.Scenario.load("pair.toml")
    assert [arm.xacro_args for arm in scenario.cell.arms.values()] == [{"reach": "2"}] * 2


@pytest.mark.gate
def test_switches_and_properties_of_a_xacro_are_told_with_remedies_that_work(tmp_path):
    """As of MOVO: arms behind optenv, which is an argument, and a <property> without prefix in an include."""
    pytest.importorskip("xacrodoc")
    body = spatial_robot().replace('xyz="0.05 0 0.3"', 'xyz="${above}"')
    body = body.replace('<robot name="spatial">', "").replace("</robot>", "")
    head, tail = '<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">', "</robot>"
    include, file = tmp_path / "arms.xacro", tmp_path / "two.xacro"
    switch = '<xacro:if value="$(optenv HAS_ARMS false)"><xacro:include filename="arms.xacro"/></xacro:if>'
    other = '<xacro:unless value="$(optenv HAS_ARMS false)"><link name="foot"/></xacro:unless>'
    file.write_text(f"{head}{switch}{other}{tail}")
    include.write_text(f'{head}<property name="above" value="0.05 0 0.3"/>{body}{tail}')
    switched = RobotFiles((), {"HAS_ARMS": "true"})
    with pytest.raises(UrdfError, match="xacro_args"):
        arms_of_robot(file, (), RobotFiles((), {}))
    with pytest.raises(UrdfError, match=f"<xacro:property> in {re.escape(str(include))}"):
        arms_of_robot(file, (), switched)
    include.write_text(include.read_text().replace("<property", "<xacro:property"))
    arms, _ = arms_of_robot(file, (), switched)
    assert {arm.tip for arm in arms.values()} == {"ltip", "rtip"}


@pytest.mark.slow
def test_a_motion_that_asks_for_most_of_what_the_task_allows_is_slowed():
    """At the whole speed 0.067 N m were to be expected, and the run has 0.11 of the 0.1 that are allowed."""
    suggested = cp.new_cell(["b1-z1", "b1-z1"], mass=1.79, squeeze=11.9, grasp="sides")
    assert suggested.scenario.motion.duration == 6.0
    assert suggested.changes[0].startswith("motion SLOWED")
    result = cp.run(suggested.scenario, warn=False, engine="compiled")
    assert (result.simulation_sound, result.task.kept) == (True, True)
    assert result.metrics()["internal_moment_error_max_Nm"] < 0.075


@pytest.mark.slow
def test_a_motion_is_slowed_until_it_asks_for_half_of_what_the_task_allows():
    """At the whole speed 0.023 rad were to be expected, at half of it 0.015, and 0.01 are allowed."""
    suggested = cp.new_cell(["ur3", "kinova"], "bar", mass=1.58, squeeze=19.9)
    assert suggested.scenario.motion.duration in (12.0, 24.0)
    assert suggested.forecast.moving.angle < 0.005
    assert not suggested.findings().of("error", "warning")
    result = cp.run(suggested.scenario, warn=False, engine="compiled")
    assert (result.simulation_sound, result.task.kept) == (True, True)
