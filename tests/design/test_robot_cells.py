"""New cells of one robot: shoulders anywhere, SRDF groups, calmer motions; continuous joints."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from lifts import spatial_robot
from numpy.testing import assert_allclose
from page_texts import page_text

import coop_pin as cp
from coop_pin.base.errors import FieldError, InfeasibleMotionError, UrdfError
from coop_pin.cli import main
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.design.named_arms import RobotFiles, arms_of_robot
from coop_pin.design.new_cell import feasible
from coop_pin.design.placing.contacts import Shoulders, contacts
from coop_pin.design.placing.drafts import calmer_motions, placed_drafts
from coop_pin.design.placing.placement import ArmPlacement
from coop_pin.feasibility import distances

SRDF = """<robot name="spatial">
  <group name="left_arm"><chain base_link="torso" tip_link="ltip"/></group>
  <group name="right_arm"><chain base_link="torso" tip_link="rtip"/></group>
  <group name="head"><joint name="neck"/></group>
  <group_state name="zero" group="left_arm">LZERO</group_state>
  <group_state name="ready" group="left_arm">LREADY</group_state>
  <group_state name="ready" group="right_arm">RREADY</group_state>
</robot>"""
READY = {"l": (0.3, 0.3, 1.2, -0.7, 0.3, 0.2), "r": (-0.2, 0.3, 1.2, -0.6, 0.2, 0.3)}


def joints_of(side, angles):
    return "".join(f'<joint name="{side}j{k}" value="{x}"/>' for k, x in enumerate(angles, start=1))


def two_armed(tmp_path, left, right, height):
    """A robot of two upright six-joint arms; left and right are (x, y) of its shoulders in the root."""
    parts = ['<link name="root"/>']
    inertial = (
        '<inertial><origin xyz="0 0 0.1"/><mass value="1.5"/>'
        '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    for side, (x, y) in (("L", left), ("R", right)):
        above = "root"
        for k, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")):
            origin = f"0 0 {0.25}" if k else f"{x} {y} {height}"
            parts.append(f'<link name="{side}{k}">{inertial}</link>')
            parts.append(
                f'<joint name="{side}j{k}" type="revolute"><parent link="{above}"/><child link="{side}{k}"/>'
                f'<origin xyz="{origin}"/><axis xyz="{axis}"/>'
                '<limit lower="-6.2" upper="6.2" effort="200" velocity="3"/></joint>'
            )
            above = f"{side}{k}"
        parts.append(f'<link name="{side}tip"/><joint name="{side}f" type="fixed"><parent link="{above}"/>')
        parts.append(f'<child link="{side}tip"/><origin xyz="0 0 0.1"/></joint>')
    file = tmp_path / "two.urdf"
    file.write_text(f'<robot name="two">{"".join(parts)}</robot>')
    return file


@pytest.mark.parametrize(
    ("left", "right", "forward"),
    [((0.0, 0.3), (0.0, -0.3), (1, 0)), ((0.2, 1.6), (0.2, 1.0), (1, 0)), ((0.3, 0.1), (-0.3, 0.1), (0, -1))],
)
def test_the_payload_stands_before_the_middle_of_the_shoulders(left, right, forward, tmp_path):
    """Wherever the root is: at one distance, the left arm to the payload's -x."""
    arms, _ = arms_of_robot(two_armed(tmp_path, left, right, 1.2), ("Ltip", "Rtip"), RobotFiles((), {}))
    by_side = {arm.tip: arm for arm in arms.values()}
    pair = [by_side["Ltip"], by_side["Rtip"]]
    shoulders = Shoulders.of(pair)
    assert_allclose(shoulders.forward[:2], forward, rtol=0, atol=1e-12)
    assert_allclose(shoulders.middle, (*np.mean((left, right), axis=0), 1.2), rtol=0, atol=1e-12)
    held = cp.Payload.box(1.0, (0.4, 0.3, 0.2))
    contact = next(iter(contacts(held, 2, "sides", "one-base")))
    base = ArmPlacement("left", pair[0], contact, 0.5, shoulders).base(0.5, 1.1, shoulders).matrix
    places = [base @ arm.robot.pose(arm.moving_joints()[0], {}) for arm in pair]
    middle = (places[0] + places[1])[:3, 3] / 2
    assert_allclose(middle[:2], (0.0, -0.5), rtol=0, atol=2e-3)  # places are rounded to millimetres
    assert places[0][0, 3] < -0.1 < 0.1 < places[1][0, 3]


def deep_torso(tmp_path):
    """The robot of ``two_armed`` with balls on its links and a torso that reaches 0.25 m ahead."""
    file = two_armed(tmp_path, (0.0, 0.3), (0.0, -0.3), 0.5)
    shape = "<collision>{}<geometry>{}</geometry></collision>"
    torso = shape.format('<origin xyz="0 0 0.3"/>', '<box size="0.5 0.4 1.2"/>')
    text = file.read_text().replace('<link name="root"/>', f'<link name="root">{torso}</link>')
    ball = shape.format("", '<sphere radius="0.03"/>')
    file.write_text(text.replace("</inertial>", f"</inertial>{ball}"))
    return str(file)


@pytest.mark.gate
def test_a_new_cell_keeps_the_clearance_where_its_largest_margins_do_not(tmp_path):
    """The best place for the joints is 5 mm before the torso; nothing else is stated."""
    robot = deep_torso(tmp_path)
    arms, _ = arms_of_robot(robot, (), RobotFiles((), {}))
    held, grasps = cp.Payload.box(1.0, (0.4, 0.3, 0.2)), dict.fromkeys(arms, cp.Pose())
    options = {"name": "deep", "motion": "line", "squeeze": 10.0}

    def first(clearance):
        cell = cp.Cell(arms=arms, payload=held, grasps=grasps, clearance=clearance)
        return next(placed_drafts(cell, "one-base", ("sides",), None, **options))

    near, clear = first(0.0), first(0.01)
    assert near.gap == pytest.approx(0.405 - 0.25 - 0.15, abs=1e-6)
    assert clear.gap > 0.01
    assert clear.scenario.cell.arms["left"].base.xyz[1] < near.scenario.cell.arms["left"].base.xyz[1]
    suggested = cp.new_cell([robot], mass=1.0)
    assert suggested.scenario.cell.clearance == 0.01
    found = distances(suggested.scenario)
    assert found.ok
    assert found.nearest.distance > 0.01
    assert not [line for line in suggested.changes if line.startswith("distance")]


@pytest.mark.gate
def test_a_new_cell_tells_that_no_place_keeps_the_clearance_and_both_remedies_work(tmp_path):
    robot = deep_torso(tmp_path)
    into, moved, smaller = (
        cp.new_cell([robot], mass=1.0, **options)
        for options in ({"distance": 0.35}, {"distance": 0.55}, {"distance": 0.35, "size": (0.4, 0.1, 0.2)})
    )
    (line,) = [line for line in into.changes if line.startswith("distance")]
    assert "clearance of 10 mm" in line
    assert "left/root and payload -50.0 mm apart" in line
    assert "move a base" in line
    assert "smaller payload" in line
    (finding,) = [each for each in into.findings() if each.kind == "distance"]
    assert (finding.severity, finding.value) == ("warning", pytest.approx(-0.05, abs=1e-6))
    for remedied in (moved, smaller):
        assert not [line for line in remedied.changes if line.startswith("distance")]
        assert distances(remedied.scenario, poses=21).ok


@pytest.mark.slow
@pytest.mark.parametrize(("y", "height"), [(0.0, 1.2), (1.3, 0.0)])
def test_shoulders_that_are_high_or_beside_the_root_get_a_cell_that_keeps_its_task(y, height, tmp_path):
    file = two_armed(tmp_path, (0.0, y + 0.3), (0.0, y - 0.3), height)
    scenario = cp.new_cell([str(file)], mass=1.0).scenario
    result = cp.run(scenario, {"duration": 4.0}, warn=False)
    assert (result.simulation_sound, result.task.state) == (True, "kept")


def test_groups_of_an_srdf_name_tips_and_postures(tmp_path):
    file, srdf = tmp_path / "spatial.urdf", tmp_path / "spatial.srdf"
    file.write_text(spatial_robot())
    text = SRDF.replace("LZERO", joints_of("l", np.zeros(6)))
    for side, angles in READY.items():
        text = text.replace(f"{side.upper()}READY", joints_of(side, angles))
    srdf.write_text(text)
    files = RobotFiles((), {})
    for tips in ((), ("left_arm", "right_arm"), ("ltip", "rtip")):
        arms, remark = arms_of_robot(file, tips, files, srdf)
        assert {arm.tip: arm.posture for arm in arms.values()} == {f"{s}tip": READY[s] for s in "lr"}
        assert "cell.shared_joints.lift" in remark
    with pytest.raises(UrdfError) as error:
        arms_of_robot(file, (), files, tmp_path / "missing.srdf")
    assert "srdf" in str(error.value)
    with pytest.raises(FieldError, match="srdf"):
        cp.new_cell(["ur5", "ur5"], srdf=srdf)


def test_a_motion_that_is_refused_is_replaced_by_a_calmer_one():
    """The rate is doubled against an unstable loop; a payload that is too heavy stays refused."""
    draft = cp.Scenario.load("baxter-box")
    motions = calmer_motions("line", draft.start, 0.1, 0.06)
    asked = []

    def suggest(causes, scenario):
        asked.append((scenario.motion.kind, scenario.clock.rate_hz / draft.clock.rate_hz))
        if cause := causes(scenario):
            raise InfeasibleMotionError(cause, "no")
        return scenario

    def turns(scenario):
        return "reach" if scenario.motion.kind == "line" and any(scenario.motion.goal.rpy) else ""

    propose = partial(suggest, turns)
    scenario, remark = feasible(draft, motions, propose)
    assert scenario.motion.goal.rpy == (0.0, 0.0, 0.0)
    assert remark.startswith("motion: without a turn")
    assert asked == [("line", 1.0), ("line", 1.0)]
    slow = draft.clock.rate_hz
    rate = lambda s: "stability" if s.clock.rate_hz == slow else ""  # noqa: E731
    propose = partial(suggest, rate)
    scenario, remark = feasible(draft, motions, propose)
    assert scenario.clock.rate_hz == 2 * slow
    assert "Hz" in remark
    asked.clear()
    propose = partial(suggest, lambda _: "torque")
    with pytest.raises(InfeasibleMotionError, match="torque"):
        feasible(draft, motions, propose)
    assert len(asked) == 1


def test_continuous_joints_have_a_posture_and_return_by_the_nearest_turn(tmp_path):
    """Two Pandas whose wrists are continuous do as Pandas do; with a posture a turn off, too."""
    text = load_checked(find_urdf("panda"))
    wide = tmp_path / "panda.urdf"
    for joint in ("panda_joint5", "panda_joint7"):
        before, _, after = text.partition(f'<joint name="{joint}" type="revolute"')
        assert after
        text = f'{before}<joint name="{joint}" type="continuous"{after}'
    wide.write_text(text)
    panda = cp.Scenario.load("two-pandas-box").replace(duration=0.3)
    ends = []
    for turn in (None, 0.0, 2.0 * np.pi):
        arms = dict(panda.cell.arms)
        for name, arm in arms.items() if turn is not None else ():
            posture = np.array(arm.posture) + turn * np.eye(7)[6]
            arms[name] = arm.replace(urdf=str(wide), posture=tuple(posture))
        result = cp.run(panda.replace(cell=panda.cell.replace(arms=arms)), warn=False)
        ends.append((result.data.payload_position.values[-1], result.data.joint_position.values[-1]))
    assert_allclose(ends[1][0], ends[0][0], rtol=0, atol=1e-9)
    assert_allclose(ends[1][1], ends[0][1], rtol=0, atol=1e-7)
    assert_allclose(ends[2][1][:, 6], ends[0][1][:, 6] + 2.0 * np.pi, rtol=0, atol=1e-7)


@pytest.mark.gate
def test_an_own_robot_with_a_lift_keeps_its_task_by_the_page(tmp_path, monkeypatch, capsys):
    """``new``, the page's block under its lift, ``check``, ``run``; nothing else is edited."""
    monkeypatch.chdir(tmp_path)
    text = two_armed(tmp_path, (0.0, 0.3), (0.0, -0.3), 0.7).read_text()
    mass = '<inertial><mass value="20"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    lift = '<joint name="lift" type="prismatic"><parent link="foot"/><child link="root"/><axis xyz="0 0 1"/>'
    lift += '<limit lower="0" upper="0.5" effort="2000" velocity="0.5"/></joint>'
    below = f'<link name="foot">{mass}</link><link name="root">{mass}</link>{lift}'
    Path("mine.urdf").write_text(text.replace('<link name="root"/>', below))
    assert main(["new", "mine", "--arms", "mine.urdf"]) == 0
    assert "cell.shared_joints.lift" in capsys.readouterr().out
    (follow,) = re.findall(r"follow = \{distance[^}]*\}", page_text("shared-joints"))
    made = Path("mine.toml")
    made.write_text(f"{made.read_text()}\n[cell.shared_joints.lift]\n{follow}\n")
    assert main(["check", "mine.toml"]) == 0
    assert main(["run", "mine.toml", "--duration", "4.5", "--no-replay", "--no-figures", "--out", "run"]) == 0
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (metrics["task"], metrics["simulation_sound"]) == ("kept", 1.0)
    assert metrics["position_error_max_m"] < 1e-3
