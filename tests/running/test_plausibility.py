"""Implausible numbers and doubtful runs: told by run, check and suggest alike, before a run."""

import collections
import functools
import sys

import numpy as np
import pytest
from close import unwrapped

import coop_pin as cp
from coop_pin.base.errors import ScenarioWarning
from coop_pin.base.spatial import make_pose
from coop_pin.cli import main
from coop_pin.running.check import quick_findings
from coop_pin.running.plausibility import implausible_numbers
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.loop import TickLoop
from coop_pin.simulation.simulation import Simulation


def quick(scenario):
    findings = quick_findings(Simulation(scenario, build_controller(scenario)))
    return [*map(str, findings.of("error", "warning"))]


def implausible(scenario):
    return tuple(map(str, implausible_numbers(scenario)))


def warnings_of(scenario):
    return [*implausible(scenario), *quick(scenario)]


DEGREES = (0.0, 0.0, 0.0, 57.0, 0.0, -30.0, 0.0)
SOUND = {"planar": "adept-anchored", "spatial": "two-pandas-box"}
SHORT = {"duration": 0.02, "events": []}


def rolled(grasp):
    """A grasp whose frame is turned away from the payload's."""
    return cp.Pose.from_matrix(grasp.matrix @ make_pose((0.0, 0.0, 0.0), (0.3, -0.2, 0.5)))


def cell_of(kind):
    """A sound cell; the spatial one with turned grasp frames."""
    scenario = cp.Scenario.load(SOUND[kind])
    if kind == "planar":
        return scenario
    cell = scenario.cell
    grasps = {name: rolled(grasp) for name, grasp in cell.grasps.items()}
    return scenario.replace(cell=cell.replace(grasps=grasps))


@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_scenario_has_no_implausible_number(kind):
    assert implausible(cell_of(kind)) == ()


@pytest.mark.parametrize("kind", SOUND)
@pytest.mark.parametrize(
    ("field", "value", "parts"),
    [
        ("cell.arms.right.base.rpy", [0.0, 0.0, 180.0], ("[0, 0, 180]", "degrees", "[0, 0, 3.142]")),
        ("cell.arms.right.base.xyz", [650.0, 0.0, 0.0], ("[650, 0, 0]", "mm")),
        ("cell.grasps.left.xyz", [-200.0, 0.0, 0.0], ("[-200, 0, 0]", "mm")),
        ("motion", {"kind": "hold", "pose": {"rpy": [0.0, 0.0, 57.3]}}, ("motion.pose.rpy", "degrees")),
    ],
)
def test_a_pose_in_another_unit_is_told_with_its_field(kind, field, value, parts):
    """Those told besides follow from it: a tip far from the payload, a start far from the motion's."""
    path = field if field.startswith("cell") else "motion.pose.rpy"
    (said,) = (line for line in implausible(cell_of(kind).override({field: value})) if path in line)
    assert all(part in said for part in parts)


@pytest.mark.parametrize("kind", SOUND)
def test_a_payload_beyond_ten_metres_is_told(kind):
    large = cell_of(kind).override({"cell.payload.size": [400.0, 300.0, 300.0]})
    (said,) = implausible(large)
    assert "cell.payload.size" in said
    assert "mm" in said
    assert implausible(cell_of(kind).override({"cell.payload.size": [9.0, 0.3, 0.3]})) == ()


@pytest.mark.parametrize("name", ["adept-anchored", "two-pandas-box", "three-ur5-plate"])
def test_a_mass_that_is_changed_without_its_inertia_is_a_note_with_the_inertia(name):
    """Of a bar, a box and a cylinder."""
    scenario = cp.Scenario.load(name)
    heavier = scenario.override({"cell.payload.mass": 1.7 * scenario.cell.payload.mass})
    (note,) = implausible_numbers(heavier)
    assert (note.kind, note.severity, note.limit) == ("inertia", "note", heavier.cell.payload.mass)
    assert note.value == pytest.approx(scenario.cell.payload.mass)
    cured = heavier.override(note.remedy)
    assert implausible_numbers(cured) == ()
    np.testing.assert_allclose(cured.cell.payload.inertia, 1.7 * np.array(scenario.cell.payload.inertia))


@pytest.mark.parametrize("kind", SOUND)
@pytest.mark.parametrize("trouble", ["unit", "start", "pad"])
def test_the_remedy_of_a_number_takes_its_finding_away(kind, trouble):
    """Of a base in mm, a start beside the motion, and pads on rigid grasps in a plane."""
    scenario = cell_of(kind)
    base = np.array(scenario.cell.arms["right"].base.xyz)
    pad = {"press": "z", "mu": 0.5, "radius": 0.02}
    pads = {name: pad for name in scenario.cell.arms if scenario.cell.rows == "planar"}
    changes = {
        "unit": {"cell.arms.right.base.xyz": (1e3 * base).tolist()},
        "start": {"motion": {"kind": "hold", "pose": {"xyz": [0.5, 0.1, 0.0], "rpy": [0.0, 0.0, 0.3]}}},
        "pad": {"cell.pads": pads},
    }[trouble]
    doubtful = scenario.override(changes)
    findings = [finding for finding in implausible_numbers(doubtful) if finding.kind == trouble]
    assert len(findings) == (trouble != "pad" or bool(pads))
    for finding in findings:
        assert finding.remedy
        cured = doubtful.override(finding.remedy)
        assert trouble not in {finding.kind for finding in implausible_numbers(cured)}
        if trouble == "unit":
            np.testing.assert_allclose(cured.cell.arms["right"].base.xyz, base)


def test_a_posture_beyond_the_limits_is_told_with_its_joint():
    pandas = cell_of("spatial")
    (said,) = implausible(pandas.override({"cell.arms.left.posture": DEGREES}))
    assert all(part in said for part in ("cell.arms.left.posture", "panda_joint4", "57", "degrees"))
    beyond = (-0.406, -0.537, 0.32, 0.1, 0.164, 1.739, 1.415)  # in rad: no guess of a unit
    (said,) = implausible(pandas.override({"cell.arms.left.posture": beyond}))
    assert "panda_joint4" in said
    assert "degrees" not in said
    planar = cell_of("planar")
    within = dict.fromkeys(planar.cell.arms, (0.5, 0.5, 0.5))
    arms = {name: planar.cell.arms[name].replace(posture=angles) for name, angles in within.items()}
    assert implausible(planar.replace(cell=planar.cell.replace(arms=arms))) == ()


@pytest.mark.parametrize("kind", SOUND)
def test_a_start_away_from_that_of_a_motion_from_rest_is_told(kind):
    """The motion of the paper moves at t = 0: no start from rest meets it."""
    scenario = cell_of(kind)
    at = scenario.start.matrix
    for shift, turn, told in ((0.05, 0.0, "50 mm"), (0.0, 0.1, "0.1 rad"), (0.01, 0.01, "")):
        goal = cp.Pose.from_matrix(at @ make_pose((shift, 0.0, 0.0), (0.0, 0.0, turn)))
        found = implausible(scenario.replace(motion=cp.motions.HoldMotion(pose=goal), events=()))
        assert len(found) == bool(told)
        assert all(told in said for said in found)


@pytest.mark.parametrize("kind", SOUND)
def test_a_tip_outside_the_payload_is_told_by_how_much(kind):
    """In the frame of the shape, of a box and of a cylinder; what is told is the distance, by hand."""
    scenario = cell_of(kind)
    cell, size = scenario.cell, np.array(scenario.cell.payload.size)
    corner = size / 2.0 + np.array((0.03, 0.04, 0.0))
    shape = cp.Pose(xyz=(0.1, -0.2, 0.3), rpy=(0.3, -0.2, 0.5))
    for place, form, told in (
        (corner, "box", "50 mm"),
        ((0.0, 0.0, size[2] / 2 + 0.02), "box", "20 mm"),
        ((size[0] / 2 * 0.6, size[0] / 2 * 0.8 + 0.0, size[2] / 2 + 0.07), "cylinder", "70 mm"),
        ((0.0, 0.0, 0.0), "cylinder", ""),
    ):
        tip = (shape.matrix @ (*place, 1.0))[:3]
        payload = cell.payload.replace(shape=form, shape_pose=shape)
        grasps = {name: cp.Pose(xyz=tuple(shape.matrix[:3, 3])) for name in cell.grasps}
        grasps["left"] = cp.Pose(xyz=tuple(tip))
        moved = scenario.replace(cell=cell.replace(payload=payload, grasps=grasps), squeeze={})
        found = [line for line in implausible(moved) if "'left'" in line]
        assert len(found) == bool(told)
        assert all(told in said for said in found)


@pytest.mark.parametrize("kind", SOUND)
def test_no_squeeze_is_told_of_several_arms(kind):
    scenario = cell_of(kind)
    (said,) = implausible(scenario.replace(squeeze={}))
    assert "squeeze" in said
    one, *_ = scenario.cell.arms
    alone = {"arms": {one: scenario.cell.arms[one]}, "grasps": {one: scenario.cell.grasps[one]}}
    single = scenario.replace(cell=scenario.cell.replace(**alone, load_shares=None), squeeze={})
    assert implausible(single) == ()


def test_run_check_and_suggest_tell_alike(tmp_path, capsys):
    wrong = cp.Scenario.load("adept-anchored", SHORT | {"squeeze": {}})
    (finding,) = (finding for finding in implausible_numbers(wrong) if finding.kind == "squeeze")
    wrong.save(tmp_path / "wrong.toml")
    main(["check", str(tmp_path / "wrong.toml"), "--poses", "3"])
    assert finding.sentence in unwrapped(capsys.readouterr().out)
    for told in (cp.run, functools.partial(cp.suggest, poses=5)):
        with pytest.warns(ScenarioWarning) as caught:
            told(wrong)
        assert str(finding) in [str(warning.message) for warning in caught]


def test_a_path_that_leaves_the_reach_is_told_before_the_run():
    """A circle of 0.6 m about the start of two Pandas; within the duration only what is run counts."""
    pandas = cp.Scenario.load("two-pandas-box")
    circle = cp.motions.CircleMotion(pose=pandas.motion.start, radius=0.6, angular_rate=0.5)
    far = pandas.replace(motion=circle, duration=8.0)
    assert any("'left'" in said and "cannot follow" in said for said in warnings_of(far))
    assert warnings_of(far.replace(duration=0.2)) == []


@pytest.mark.slow
def test_a_run_tells_the_elbow_that_its_spring_does_not_hold_as_check_does(tmp_path, capsys):
    soft = cp.Scenario.load("two-pandas-box", SHORT | {"controller.posture.stiffness": 3.0})
    (said,) = (said for said in warnings_of(soft) if "the motion" not in said)
    for part in ("elbow", "left", "controller.posture.stiffness"):
        assert part in said
    soft.save(tmp_path / "soft.toml")
    assert main(["check", str(tmp_path / "soft.toml"), "--poses", "3"]) == 1
    assert "controller.posture.stiffness" in capsys.readouterr().out
    with pytest.warns(ScenarioWarning, match="elbow"):
        cp.run(soft)


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_a_run_builds_one_simulation_which_its_warnings_leave_as_it_was(engine):
    """A gain reaches the torque by one way: the warnings look at the simulation that the run then steps."""
    calls = collections.Counter()
    scenario = cp.Scenario.load("adept-paper", {"duration": 0.1, "events": ()})
    quiet = cp.run(scenario, engine=engine, warn=False)
    sys.setprofile(lambda frame, event, _: calls.update([frame.f_code] if event == "call" else []))
    try:
        result = cp.run(scenario, engine=engine)
    finally:
        sys.setprofile(None)
    assert calls[TickLoop.__init__.__code__] == 1
    assert result.data.identical(quiet.data)


@pytest.mark.parametrize(
    "changes",
    [
        {"sensors.wrist.delay": 10, "controller.gains.admittance_damping": [200.0] * 3 + [4.0] * 3},
        pytest.param({"controller.gains.admittance_damping": [50.0] * 3 + [1.0] * 3}, marks=pytest.mark.slow),
    ],
)
def test_an_admittance_that_grows_on_its_servos_is_named_by_run_and_check(changes, tmp_path, capsys):
    """As it swings by hundreds of newtons within seconds."""
    scenario = cp.Scenario.load("two-ur5-admittance", changes)
    with pytest.warns(ScenarioWarning, match="admittance grows"):
        result = cp.run(scenario.replace(duration=2.0))
    desired = result.data.desired_internal_axial.values
    assert np.abs(result.data.internal_axial.values - desired)[-100:].max() > 50.0
    scenario.save(tmp_path / "unstable.toml")
    assert main(["check", str(tmp_path / "unstable.toml")]) != 0
    assert "admittance grows" in capsys.readouterr().out


@pytest.mark.slow
def test_a_table_that_is_pressed_too_hard_fails_the_check(tmp_path):
    """By a sliding gain that is 1.1 times the proposed one; run warns of it, too."""
    scenario = cp.Scenario.load("pick-carry-place")
    gain = np.multiply(1.1, scenario.controller.gains.sliding_gain).tolist()
    scenario = scenario.override({"controller.gains.sliding_gain": gain})
    assert any("table" in text for text in quick(scenario))
    scenario.save(tmp_path / "pressed.toml")
    assert main(["check", str(tmp_path / "pressed.toml")]) != 0


@pytest.mark.parametrize(
    ("span", "words", "remedy"),
    [
        ((0.0, 2.0), "", {}),
        ((0.0, 3.0), "ends at 3 s", {"duration": 3.0}),
        ((5.0, 6.0), "begins at 5 s", {"duration": 6.0}),
        ((0.0, 2e9), "in ns?", {}),
        ((1.7e9, 1.7e9 + 2.0), "since 1970?", {}),
        ((1.7e18, 1.7e18 + 2e9), "in ns?", {}),
    ],
)
@pytest.mark.parametrize("form", ["line", "csv"])
@pytest.mark.parametrize("cell", SOUND)
def test_a_motion_that_is_not_within_the_run_is_named_with_the_likely_unit(
    cell, form, span, words, remedy, tmp_path
):
    scenario = cell_of(cell)
    pose = scenario.start
    motion = {
        "kind": "line",
        "start": pose,
        "goal": pose,
        "start_time": span[0],
        "duration": span[1] - span[0],
    }
    if form == "csv":
        rows = (",".join(map(repr, (time, *pose.xyz, *pose.rpy))) for time in span)
        (tmp_path / "table.csv").write_text("\n".join(("time,x,y,z,roll,pitch,yaw", *rows)) + "\n")
        motion = {"kind": "csv", "path": str(tmp_path / "table.csv")}
    scenario = scenario.replace(duration=2.0, events=()).override({"motion": motion})
    found = [finding for finding in implausible_numbers(scenario) if finding.kind == "motion"]
    assert len(found) == bool(words)
    for finding in found:
        assert words in finding.sentence
        assert finding.remedy == remedy
        if remedy:
            cured = implausible_numbers(scenario.override(remedy))
            assert "motion" not in {other.kind for other in cured}
