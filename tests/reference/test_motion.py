"""Motions and squeezes of a scenario: what they do, the TOML round trip, and the paths of mistakes."""

import math

import numpy as np
import pytest
from cells import SPATIAL_START, planar_scenario, spatial_scenario
from close import assert_close
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, pose_error
from coop_pin.description.scenario import Scenario
from coop_pin.reference.csv_motion import CsvMotion
from coop_pin.reference.lines import LineMotion
from coop_pin.reference.motions import CircleMotion, ExponentialMotion, HoldMotion, SwingMotion, TurnMotion
from coop_pin.reference.pose_reference import FunctionMotion, PoseReference, check_consistency
from coop_pin.reference.splines import Waypoint, WaypointsMotion
from coop_pin.reference.squeeze import ConstantSqueeze, FunctionSqueeze, RampSqueeze

START = SPATIAL_START
GOAL = Pose(xyz=(0.5, 0.0, 0.45), rpy=(0.1, -0.2, 0.9))
TIMES = np.linspace(0.05, 4.0, 23)
LEFT, RIGHT = (-8.0, 1.0, 0.0, 0.0, 0.2, 0.0), (8.0, -1.0, 0.0, 0.0, -0.2, 0.0)


def users_pose(time, reach=0.1):
    return make_pose((0.45 + reach * math.sin(time), 0.05, 0.4), (0.0, 0.2 * math.sin(time), 0.3))


def users_twist(time, reach=0.1):
    """Of users_pose: pitch turns about the y axis that the yaw of 0.3 has turned."""
    pitch = 0.2 * math.cos(time)
    return np.array((reach * math.cos(time), 0.0, 0.0, -math.sin(0.3) * pitch, math.cos(0.3) * pitch, 0.0))


def wrong_twist(time, reach=0.1):
    return -users_twist(time, reach)


def users_squeeze(time, force=5.0):
    return {"right": [force * time, 0, 0, 0, 0, 0], "left": [-force * time, 0, 0, 0, 0, 0]}


def users_squeeze_rows(time, force=5.0):
    return np.array([[-force * time, 0, 0, 0, 0, 0], [force * time, 0, 0, 0, 0, 0]])


def leaking_squeeze(time):
    return {"left": [-1.0, 0, 0, 0, 0, 0], "right": [1.0 + time, 0, 0, 0, 0, 0]}


def lopsided_squeeze(_):
    return {"left": [0.0] * 6}


class Namespace:
    @staticmethod
    def pose(time):
        return users_pose(time)


MOTIONS = {
    "hold": HoldMotion(pose=START),
    "exponentials": ExponentialMotion(
        constant=(0.4, 0, 0.4), amplitudes=[(0.1, 0, 0), (0, 0.1, 0)], time_constants=(2.0, 3.0)
    ),
    "line": LineMotion(start=START, goal=GOAL, duration=3.0, start_time=0.5),
    "circle": CircleMotion(
        pose=START, radius=0.1, angular_rate=1.5, normal=(0.2, 0.1, 1.0), start_angle=0.7, ramp=0.8
    ),
    "turn": TurnMotion(pose=START, axis=(0.0, 1.0, 1.0), angle=1.2, duration=3.0),
    "swing": SwingMotion(pose=START, axis=(1.0, 0.0, 0.0), amplitude=0.4, period=2.0),
    "waypoints": WaypointsMotion(
        points=[
            Waypoint(time=0.0, xyz=START.xyz, rpy=START.rpy),
            Waypoint(time=1.5, xyz=(0.5, 0.1, 0.45), rpy=(0.3, 0.1, 0.5)),
            Waypoint(time=4.0, xyz=GOAL.xyz, rpy=GOAL.rpy),
        ]
    ),
    "function": FunctionMotion(target=users_pose, options={"reach": 0.05}),
    "function with twist": FunctionMotion(target=users_pose, twist=users_twist),
    "function in a class": FunctionMotion(target=Namespace.pose),
}


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "motion.csv"
    rows = "\n".join(f"{t},{0.45 + 0.02 * t},0.05,0.4,0.3,-0.2,{0.5 + 0.1 * t}" for t in (0.0, 1.0, 2.5, 4.0))
    path.write_text("time,x,y,z,roll,pitch,yaw\n" + rows + "\n")
    return path


# ---------------------------------------------------------------- motions


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_twist_and_acceleration_are_the_derivatives_of_the_pose(motion):
    check_consistency(motion, TIMES, allowed=2e-3)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_motion_survives_the_scenario_file_unchanged(motion):
    scenario = spatial_scenario().replace(motion=motion)
    again = Scenario.from_toml(scenario.to_toml())
    assert again == scenario
    assert isinstance(again.motion, PoseReference)
    for time in (0.0, 1.3, 5.0):
        assert_allclose(again.motion.at(time).X_WP_d, motion.at(time).X_WP_d, rtol=0, atol=0)


@pytest.mark.parametrize("kind", ["line", "circle", "turn", "swing", "waypoints"])
def test_a_motion_that_starts_at_a_pose_starts_there_and_at_rest(kind):
    target = MOTIONS[kind].at(0.0)
    assert_close(pose_error(np.array(target.X_WP_d), START.matrix), np.zeros(6), atol=1e-14)
    assert_close(target.V_WP_d, np.zeros(6), atol=1e-14)


@pytest.mark.parametrize("kind", ["line", "waypoints"])
def test_a_motion_that_ends_at_a_pose_ends_there(kind):
    assert_close(pose_error(np.array(MOTIONS[kind].at(9.0).X_WP_d), GOAL.matrix), np.zeros(6), atol=1e-14)


@pytest.mark.parametrize("kind", ["line", "circle", "turn", "swing"])
def test_a_slowed_motion_is_the_same_path_in_a_multiple_of_the_time(kind):
    motion = MOTIONS[kind]
    slower = motion.replace(**motion.slowed(4.0))
    for time in TIMES.tolist():
        at = motion.at(motion.start_time + time)
        later = slower.at(motion.start_time + 4.0 * time)
        assert_allclose(later.X_WP_d, at.X_WP_d, atol=1e-12)
        assert_allclose(4.0 * later.V_WP_d, at.V_WP_d, atol=1e-12)
        assert_allclose(16.0 * later.A_WP_d, at.A_WP_d, atol=1e-12)


def test_a_circle_keeps_its_radius_about_one_centre_in_its_plane():
    motion = MOTIONS["circle"]
    positions = np.array([motion.at(time).X_WP_d[:3, 3] for time in np.linspace(0, 8, 200)])
    normal = np.array(motion.normal) / np.linalg.norm(motion.normal)
    e_1 = np.array((1.0, 0, 0)) - normal[0] * normal
    e_1 /= np.linalg.norm(e_1)
    e_2 = np.cross(normal, e_1)
    centre = np.array(START.xyz) - motion.radius * (math.cos(0.7) * e_1 + math.sin(0.7) * e_2)
    assert_allclose(np.linalg.norm(positions - centre, axis=1), motion.radius, rtol=1e-12)
    assert_close((positions - centre) @ normal, 0.0, atol=1e-14)


def test_a_turn_turns_by_its_angle_about_its_axis_and_goes_nowhere():
    reference = MOTIONS["turn"]
    before, after = (np.array(reference.at(time).X_WP_d) for time in (0.0, 9.0))
    axis = np.array((0.0, 1.0, 1.0)) / math.sqrt(2.0)
    assert_close(pose_error(after, before), np.concatenate((np.zeros(3), 1.2 * axis)), atol=1e-14)


def test_a_csv_motion_passes_through_its_rows(table):
    reference = CsvMotion(path=str(table))
    for time in (0.0, 1.0, 2.5, 4.0):
        expected = make_pose((0.45 + 0.02 * time, 0.05, 0.4), (0.3, -0.2, 0.5 + 0.1 * time))
        assert_close(reference.at(time).X_WP_d, expected, atol=1e-12)
    check_consistency(reference, TIMES[:-1])


def test_a_csv_path_is_relative_to_the_scenario_file(table, monkeypatch, tmp_path):
    scenario = spatial_scenario().replace(motion=CsvMotion(path=table.name))
    (table.parent / "study.toml").write_text(scenario.to_toml())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    read = Scenario.load(table.parent / "study.toml")
    assert read.motion.path == str(table.resolve())
    assert_allclose(read.motion.at(0.0).X_WP_d[:3, 3], (0.45, 0.05, 0.4))


def test_a_missing_or_bad_csv_names_itself_and_the_line(table):
    with pytest.raises(errors.FileReadError, match=r"nowhere\.csv"):
        CsvMotion(path="nowhere.csv").at(0.0)
    table.write_text(table.read_text().replace("1.0,", "one,", 1))
    with pytest.raises(errors.FileReadError) as caught:
        CsvMotion(path=str(table)).at(0.0)
    assert caught.value.line == 3


def test_a_users_twist_is_used_and_its_mistakes_are_seen():
    motion = FunctionMotion(target=users_pose, twist=users_twist, options={"reach": 0.2})
    assert motion.target == f"{__name__}:users_pose"
    assert_allclose(motion.at(0.4).V_WP_d, users_twist(0.4, 0.2))
    with pytest.raises(errors.OutOfRangeError, match="V_WP_d"):
        check_consistency(FunctionMotion(target=users_pose, twist=wrong_twist), TIMES)


def test_a_users_function_that_does_not_exist_is_named():
    with pytest.raises(errors.NameNotFoundError, match="no_such_module"):
        FunctionMotion(target="no_such_module:f").at(0.0)
    with pytest.raises(errors.NameNotFoundError, match="did you mean 'users_pose'"):
        FunctionMotion(target=f"{__name__}:user_pose").at(0.0)
    with pytest.raises(errors.NameNotFoundError, match="not a function"):
        FunctionMotion(target=f"{__name__}:START").at(0.0)


def test_fields_of_a_motion_can_be_overridden_and_its_kind_changed():
    scenario = spatial_scenario().replace(motion=MOTIONS["line"])
    assert scenario.override({"motion.goal.xyz": (0.4, 0, 0.4)}).motion.goal.xyz == (0.4, 0.0, 0.4)
    assert (
        scenario.override({"motion": {"kind": "hold", "pose": {"xyz": [0.4, 0, 0.4]}}}).motion.kind == "hold"
    )


LINE = {"kind": "line", "start": {}, "goal": {"xyz": [0.1, 0, 0]}, "duration": 1.0}
CIRCLE = {"kind": "circle", "pose": {}, "radius": 0.1, "angular_rate": 1.0}
TURN = {"kind": "turn", "pose": {}, "axis": [0, 0, 1], "angle": 1.0, "duration": 1.0}
POINTS = {"kind": "waypoints", "points": [{"time": 0.0}, {"time": 1.0, "xyz": [0.1, 0, 0]}]}
MISTAKES = {
    "unknown kind": ({"kind": "lime"}, errors.FieldError, "motion.kind", "'line'"),
    "no kind": ({"pose": {}}, errors.FieldError, "motion.kind", "must be given"),
    "unknown field": (LINE | {"sped": 1.0}, errors.UnknownFieldError, "motion.sped", "no such field"),
    "missing field": (
        {"kind": "line", "start": {}, "duration": 1.0},
        errors.FieldError,
        "motion.goal",
        "must be given",
    ),
    "no time": (LINE | {"duration": 0.0}, errors.FieldError, "motion.duration", "must be positive"),
    "NaN": (LINE | {"start_time": math.nan}, errors.FieldError, "motion.start_time", "nan"),
    "half a turn": (
        LINE | {"goal": {"rpy": [0, 0, math.pi]}},
        errors.FieldError,
        "motion.goal.rpy",
        "ambiguous",
    ),
    "no radius": (CIRCLE | {"radius": -1.0}, errors.FieldError, "motion.radius", "-1"),
    "no direction": (CIRCLE | {"normal": [0, 0, 0]}, errors.FieldError, "motion.normal", "direction"),
    "axis too short": (TURN | {"axis": [0, 1]}, errors.FieldError, "motion.axis", "must have 3"),
    "no axis": (TURN | {"axis": [0, 0, 0]}, errors.FieldError, "motion.axis", "direction"),
    "one waypoint": (
        POINTS | {"points": [{"time": 0.0}]},
        errors.FieldError,
        "motion.points",
        "at least 2",
    ),
    "waypoint without time": (
        POINTS | {"points": [{"time": 0.0}, {}]},
        errors.FieldError,
        "motion.points.1.time",
        "given",
    ),
    "times backwards": (
        POINTS | {"points": [{"time": 0.0}, {"time": 0.0}]},
        errors.FieldError,
        "motion.points.1.time",
        "increase",
    ),
    "waypoints half a turn apart": (
        POINTS | {"points": [{"time": 0.0}, {"time": 1.0, "rpy": [math.pi, 0, 0]}]},
        errors.FieldError,
        "motion.points.1.rpy",
        "ambiguous",
    ),
    "no function": (
        {"kind": "function", "target": "just_a_name"},
        errors.FieldError,
        "motion.target",
        "module:function",
    ),
    "a lambda": (
        {"kind": "function", "target": lambda _: np.eye(4)},
        errors.FieldError,
        "motion.target",
        "def",
    ),
    "terms of unequal number": (
        {
            "kind": "exponentials",
            "constant": [0, 0, 0],
            "amplitudes": [[1, 0, 0]],
            "time_constants": [1.0, 2.0],
        },
        errors.FieldError,
        "motion.time_constants",
        "2 entries for 1",
    ),
}


def refused(**fields):
    """The one mistake in a scenario with these fields."""
    given = {
        name: getattr(spatial_scenario(), name)
        for name in ("name", "cell", "controller", "start", "motion", "clock")
    }
    with pytest.raises(errors.FieldError) as caught:
        Scenario(**(given | fields))
    return caught.value


@pytest.mark.parametrize(("motion", "kind", "path", "said"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_in_a_motion_has_its_type_its_path_and_what_to_do(motion, kind, path, said):
    error = refused(motion=motion)
    assert type(error) is kind
    assert error.path == path
    assert said in error.detail


# ---------------------------------------------------------------- squeeze


def squeeze_at(squeeze, time):
    return spatial_scenario().replace(squeeze=squeeze).squeeze.at(time, ["left", "right"])


def test_a_plain_table_is_a_constant_squeeze_in_the_order_of_the_arms():
    assert_allclose(squeeze_at({"right": RIGHT, "left": LEFT}, 3.0), [LEFT, RIGHT])
    assert spatial_scenario().squeeze == ConstantSqueeze(wrenches={"left": LEFT, "right": RIGHT})
    assert_allclose(spatial_scenario().squeeze_wrenches, [LEFT, RIGHT])
    assert_allclose(squeeze_at({}, 1.0), np.zeros((2, 6)))


def test_a_ramp_goes_from_its_start_to_its_goal_and_sums_to_zero_all_the_way():
    ramp = RampSqueeze(goal={"left": LEFT, "right": RIGHT}, duration=2.0, start_time=1.0)
    assert_allclose(squeeze_at(ramp, 1.0), np.zeros((2, 6)))
    assert_allclose(squeeze_at(ramp, 2.0), np.array([LEFT, RIGHT]) / 2.0)
    assert_allclose(squeeze_at(ramp, 3.0), [LEFT, RIGHT])
    for time in np.linspace(0.0, 4.0, 17):
        assert_close(squeeze_at(ramp, time).sum(axis=0), np.zeros(6), atol=1e-14)


def test_motions_and_ramps_start_at_zero_unless_told_otherwise():
    """Half of the way at half of the duration: quintic(1/2) = 1/2."""
    ramp = RampSqueeze(goal={"left": LEFT, "right": RIGHT}, duration=2.0)
    assert_close(squeeze_at(ramp, 1.0), np.array([LEFT, RIGHT]) / 2.0, atol=1e-14)
    line = LineMotion(start=START, goal=GOAL, duration=2.0)
    first, half, last = (line.at(time).X_WP_d[:3, 3] for time in (0.0, 1.0, 2.0))
    assert_close(half, (first + last) / 2.0, atol=1e-14)
    assert np.linalg.norm(last - first) > 0.01


@pytest.mark.parametrize("function", [users_squeeze, users_squeeze_rows])
def test_a_users_squeeze_may_be_a_table_or_rows_in_the_order_of_the_arms(function):
    squeeze = FunctionSqueeze(target=function, options={"force": 3.0})
    assert_allclose(squeeze_at(squeeze, 2.0)[:, 0], (-6.0, 6.0))


@pytest.mark.parametrize(
    "squeeze",
    [
        ConstantSqueeze(wrenches={"left": LEFT, "right": RIGHT}),
        RampSqueeze(start={"left": RIGHT, "right": LEFT}, goal={"left": LEFT, "right": RIGHT}, duration=2.0),
        FunctionSqueeze(target=users_squeeze, options={"force": 2.0}),
    ],
    ids=["constant", "ramp", "function"],
)
def test_a_squeeze_survives_the_scenario_file_unchanged(squeeze):
    scenario = spatial_scenario().replace(squeeze=squeeze)
    assert Scenario.from_toml(scenario.to_toml()) == scenario


def test_the_run_squeezes_by_the_ramp():
    ramp = RampSqueeze(goal=planar_scenario().squeeze.wrenches, duration=0.1)
    result = cp.run(planar_scenario().replace(squeeze=ramp, duration=0.2, events=()))
    assert result.scenario.squeeze == ramp
    desired = result.data.desired_internal_wrench.values
    lengths = [np.linalg.norm(ramp.at(float(time), ["left", "right"])[0, :2]) for time in result.data.time]
    assert lengths[0] == 0.0
    assert lengths[-1] == pytest.approx(10.0)
    assert_close(np.linalg.norm(desired[:, 0, :2], axis=1), lengths, atol=1e-9)


@pytest.mark.parametrize(
    ("function", "time", "said"),
    [(leaking_squeeze, 0.5, "sums to"), (lopsided_squeeze, 0.0, "no entry for 'right'")],
)
def test_a_users_squeeze_that_is_none_is_refused_when_it_is_called(function, time, said):
    with pytest.raises(errors.FieldError, match=said) as caught:
        FunctionSqueeze(target=function).at(time, ["left", "right"])
    assert caught.value.path.startswith("squeeze.target")


TABLE = {"left": LEFT, "right": RIGHT}
OFF = {"left": LEFT, "right": (9.0, *RIGHT[1:])}
SQUEEZE_MISTAKES = {
    "plain table, sum": (OFF, errors.FieldError, "squeeze", "[1.0, 0.0"),
    "plain table, stranger": ({"lefft": LEFT, "right": RIGHT}, errors.FieldError, "squeeze", "'left'"),
    "plain table, too short": (
        {"left": (1.0, 2.0), "right": RIGHT},
        errors.FieldError,
        "squeeze.left",
        "must have 6",
    ),
    "plain table, missing arm": (
        {"left": (0.0,) * 6},
        errors.FieldError,
        "squeeze",
        "no entry for 'right'",
    ),
    "constant, sum": (
        {"kind": "constant", "wrenches": OFF},
        errors.FieldError,
        "squeeze.wrenches",
        "[1.0, 0.0",
    ),
    "ramp, sum of the goal": (
        {"kind": "ramp", "goal": OFF, "duration": 1.0},
        errors.FieldError,
        "squeeze.goal",
        "[1.0, 0.0",
    ),
    "ramp, sum of the start": (
        {"kind": "ramp", "start": OFF, "goal": TABLE, "duration": 1.0},
        errors.FieldError,
        "squeeze.start",
        "[1.0, 0.0",
    ),
    "ramp, stranger": (
        {"kind": "ramp", "goal": {"up": LEFT, "right": RIGHT}, "duration": 1.0},
        errors.FieldError,
        "squeeze.goal",
        "'up'",
    ),
    "ramp, no time": (
        {"kind": "ramp", "goal": TABLE, "duration": 0.0},
        errors.FieldError,
        "squeeze.duration",
        "positive",
    ),
    "unknown kind": ({"kind": "rampp"}, errors.FieldError, "squeeze.kind", "'ramp'"),
    "no function": (
        {"kind": "function", "target": "f"},
        errors.FieldError,
        "squeeze.target",
        "module:function",
    ),
}


@pytest.mark.parametrize(("squeeze", "kind", "path", "said"), SQUEEZE_MISTAKES.values(), ids=SQUEEZE_MISTAKES)
def test_a_mistake_in_a_squeeze_has_its_type_its_path_and_what_to_do(squeeze, kind, path, said):
    error = refused(squeeze=squeeze)
    assert type(error) is kind
    assert error.path == path
    assert said in error.detail
