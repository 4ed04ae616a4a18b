"""Metrics of runs against numbers written by hand, on datasets of a few samples made by hand."""

import math

import numpy as np
import pytest
from cells import SCENARIOS
from close import assert_close

import coop_pin as cp
from coop_pin.base.errors import OutOfRangeError
from coop_pin.base.spatial import make_pose
from coop_pin.base.spatial.internal_wrench import (
    minimum_norm_internal_wrenches,
    nonsqueezing_internal_wrenches,
    virtual_linkage_internal_wrenches,
)
from coop_pin.description.events import PayloadChange
from coop_pin.results import TaskLimits, metrics
from coop_pin.results.breaches import LimitViolation
from coop_pin.results.dataset import LIMITS, dataset
from coop_pin.results.energies import energy_balance
from coop_pin.results.quantities import quantities
from coop_pin.results.quantity import allocate
from coop_pin.results.task import LARGEST, monitored
from coop_pin.results.window import EventWindows, Window, checked_window, samples_of

SCENARIO = SCENARIOS["planar"]().replace(task=TaskLimits())
PLATE = cp.Scenario.load("three-ur5-plate")
EXACT = 1e-14
NO_LIMIT = math.nan


def event(time):
    return PayloadChange(time=time, mass=1.0)


def made(time, *, scenario=SCENARIO, events=(), limits=None, joints=None, **samples):
    """A result whose samples are at rest at the origin, but for those stated."""
    count, arms = len(time), len(scenario.cell.arms)
    at_rest = allocate(quantities(scenario), count, {"q": 1, "v": 1, "arm": arms, "joint": 2})
    values = {name: np.zeros_like(value) for name, value in at_rest.items()}
    values["payload_pose"][:] = values["desired_pose"][:] = np.eye(4)
    values["tip_position"][:] = np.arange(arms)[:, None] * np.array((2.0, 0.0, 0.0))
    values["time"] = np.array(time, dtype=float)
    for name in samples.keys() & at_rest.keys():
        values[name][:] = samples[name]
    still = [np.zeros((count, 2))] * arms
    values |= {"angles": still, "rates": still, "drive": [np.eye(2)] * arms}
    values |= {"jacobian": [np.tile(np.eye(3, 2), (count, 1, 1))] * arms}
    joints = [["one", "two"]] * arms if joints is None else joints
    limits = np.full((4, arms, 2), NO_LIMIT) if limits is None else limits
    scenario = scenario.replace(duration=float(time[-1]), events=events)
    data = dataset(scenario, values, joints, limits)
    for name in samples.keys() - at_rest.keys():  # what follows from the joints
        data[name].values[:] = samples[name]
    return cp.RunResult(scenario, data)


def poses(positions, turns=None, axis=(1.0, 0.0, 0.0)):
    turns = np.zeros(len(positions)) if turns is None else turns
    return np.array([make_pose(p, turn * np.array(axis)) for p, turn in zip(positions, turns, strict=True)])


def along_z(heights, turns=None):
    return poses([(0.0, 0.0, height) for height in heights], turns)


# ------------------------------------------------------------ windows


@pytest.mark.parametrize(
    ("window", "inside"),
    [
        ((1.0, 3.0), [False, True, True, False, False]),
        ((1.0, 4.0), [False, True, True, True, True]),
        ((4.0, 4.0), [False, False, False, False, True]),
        ((2.5, 9.0), [False, False, False, True, True]),
        ((5.0, 9.0), [False] * 5),
        ((1.0 + 1e-10, 3.0 + 1e-10), [False, True, True, False, False]),
        ((1.0, 4.0 - 1e-10), [False, True, True, True, True]),
        ((1.0, 3.9), [False, True, True, True, False]),
    ],
)
def test_a_window_has_its_start_and_not_its_end_unless_the_run_ends_there(window, inside):
    data = made([0.0, 1.0, 2.0, 3.0, 4.0]).data
    assert samples_of(data, Window(*window)).tolist() == inside


def test_windows_of_a_run():
    with_events = made([0.0, 20.0], events=(event(12.0), event(10.0))).scenario
    assert EventWindows.of(with_events, 20.0) == ((0.0, 10.0), (10.0, 20.0), 12.0)
    assert EventWindows.of(with_events, 10.0) == ((0.0, 10.0), None, 12.0)
    assert EventWindows.of(with_events.replace(events=()), 20.0) == ((0.0, 20.0), None, 0.0)


MOVES = np.where(np.arange(10)[:, None] % 5 >= 3, 1.0, 0.0) * np.ones(6)  # at 3, 4, 8 and 9 s
PUSH = {"kind": "wrench-pulse", "time": 4.0, "duration": 2.0, "wrench": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("events", "recovery", "late", "expected"),
    [
        ((), 0.0, 0, ([3, 4, 8, 9], [0, 1, 2, 5, 6, 7], [])),
        ((), 0.0, 2, ([3, 4, 8, 9], [2, 5, 6, 7], [])),  # errors of the start decay until 2 s
        ((event(5.0),), 0.0, 0, ([3, 4, 8, 9], [0, 1, 2, 5, 6, 7], [5, 6, 7, 8, 9])),
        ((PUSH,), 0.0, 0, ([3, 8, 9], [0, 1, 2, 6, 7], [6, 7, 8, 9])),
        ((PUSH,), 2.0, 0, ([3, 9], [0, 1, 2], [8, 9])),
        ((event(0.0),), 0.0, 0, ([3, 4, 8, 9], [0, 1, 2, 5, 6, 7], list(range(10)))),
        ((event(9.5),), 0.0, 0, ([3, 4, 8, 9], [0, 1, 2, 5, 6, 7], [])),
    ],
)
def test_phases_are_by_the_reference_the_decay_and_the_events(events, recovery, late, expected):
    error = np.zeros((10, 6))
    error[:late, 0] = 1.0
    result = made(np.arange(10.0), desired_twist=MOVES, pose_error=error)
    scenario = result.scenario.replace(duration=10.0, events=events).override({"task.recovery": recovery})
    phases = cp.RunResult(scenario, result.data).phases
    assert tuple(np.flatnonzero(mask).tolist() for mask in phases.values()) == expected


def test_a_window_that_is_asked_for_lies_within_the_run():
    for window in ((0.0, 4.0), (1.0, 4.0 + 1e-10), (3.0, 3.5)):
        assert checked_window(window, 4.0) == window
    for window in ((-1e-10, 1.0), (4.0, 5.0), (1.0, 1.0), (2.0, 1.0), (1.0, 4.0 + 1e-8)):
        with pytest.raises(OutOfRangeError):
            checked_window(window, 4.0)
    assert [str(Window(*window)) for window in ((1.0, 2.5), (2.0, 2.0))] == ["1 to 2.5 s", "at 2 s"]


def test_the_windows_of_each_metric():
    windows = {
        "after_event_position_rms_m": ((12.0, 20.0),),
        "moving_position_rms_m": (),
        "rest_position_rms_m": ((0.0, 20.0),),
        "settling_time_s": ((0.0, 10.0),),
        "resettling_time_s": ((10.0, 20.0),),
        "event_peak_position_error_m": ((10.0, 20.0),),
        "torque_peak_Nm": ((0.0, 20.0),),
    }
    result = made([0.0, 4.0, 12.0, 20.0], events=(event(12.0), event(10.0)))
    assert {name: result.windows_of(name) for name in windows} == windows


def test_what_serves_to_compute_is_not_stored():
    result = made([0.0, 1.0])
    assert not {"time", "payload_pose", "desired_pose", "desired_squeeze"} & set(result.data.data_vars)


def test_a_result_of_two_megabytes_is_read_back(tmp_path):
    """What a file unpacks to is bounded by its size; the slack for small files does not cover this one."""
    result = made(np.arange(2000.0))
    assert result.data.nbytes > 2e6
    result.save(tmp_path / "new" / "folder" / "result.nc")
    assert cp.RunResult.load(tmp_path / "new" / "folder" / "result.nc").data.identical(result.data)


# ------------------------------------------------------------ tracking


def test_the_pose_error_is_actual_minus_desired_in_world_axes():
    result = made(
        [0.0, 1.0],
        payload_pose=poses([(1.0, 2.0, 3.0), (0.0, 0.0, 0.0)], [0.7, 0.0]),
        desired_pose=poses([(0.9, 2.2, 3.0), (0.0, 0.0, 0.0)], [0.4, 0.2]),
    )
    expected = [[0.1, -0.2, 0.0, 0.3, 0.0, 0.0], [0.0, 0.0, 0.0, -0.2, 0.0, 0.0]]
    assert_close(result.data.pose_error, expected, atol=EXACT)
    assert_close(result.data.payload_position, [[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]], atol=EXACT)
    assert_close(result.data.desired_position, [[0.9, 2.2, 3.0], [0.0, 0.0, 0.0]], atol=EXACT)
    half = [[math.sin(0.35), 0.0, 0.0, math.cos(0.35)], [0.0, 0.0, 0.0, 1.0]]
    assert_close(result.data.payload_quaternion, half, atol=EXACT)
    half = [[math.sin(0.2), 0.0, 0.0, math.cos(0.2)], [math.sin(0.1), 0.0, 0.0, math.cos(0.1)]]
    assert_close(result.data.desired_quaternion, half, atol=EXACT)


OUT, IN = 5.1e-3, 4.9e-3
TIMES = [0.0, 0.5, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("heights", "turns", "settled"),
    [
        ([OUT, IN, OUT, IN, IN, IN], [0] * 6, 2.0),
        ([0] * 6, [OUT, IN, -OUT, IN, IN, IN], 2.0),
        ([IN, OUT, 0, 0, 0, 0], [0, 0, OUT, OUT, IN, IN], 3.0),
        ([IN] * 6, [IN] * 6, 0.0),
        ([0, 0, 0, 0, 0, OUT], [0] * 6, math.inf),
        ([0] * 6, [0, 0, 0, 0, 0, OUT], math.inf),
        ([0, 0, 0, 0, OUT, IN], [0] * 6, 4.0),
        ([5e-3] * 6, [0] * 6, 0.0),
        ([math.nextafter(5e-3, 1.0)] * 6, [0] * 6, math.inf),
    ],
)
def test_settling_is_of_position_and_of_orientation(heights, turns, settled):
    assert made(TIMES, payload_pose=along_z(heights, turns)).settling_time() == settled


def test_the_band_is_of_the_distance_and_of_the_angle_and_not_of_single_axes():
    corner = np.full(3, 3.0e-3)  # 5.2 mm
    assert made([0.0, 1.0], payload_pose=poses([corner, (0, 0, 0)])).settling_time() == 1.0
    turned = np.array([make_pose((0, 0, 0), corner), np.eye(4)])
    assert made([0.0, 1.0], payload_pose=turned).settling_time() == 1.0


@pytest.mark.parametrize(
    ("force", "heights", "events", "expected"),
    [
        ((0.0, 0.0, 3.0, 0.0, 0.0), (0.0,) * 5, (), (0.0, 3.0)),  # near at the start: all counts
        ((10.0, 4.0, 0.5, 0.2, 0.4), (0.0,) * 5, (), (4.0, 0.4)),  # until it grows
        ((10.0, 4.0, 0.5, 0.2, 0.1), (0.0,) * 5, (), (4.0, 0.1)),  # it does not: the last one
        ((10.0, 4.0, 0.5, 0.2, 0.4), (0.0,) * 5, (event(1.0),), (1.0, 4.0)),
        ((10.0, 4.0, 3.0, 2.0, 5.0), (0.0,) * 5, (), (4.0, 5.0)),  # it never gets there
        ((10.0, 0.5, 0.2, 0.1, 0.4), (1.0,) * 5, (), (1.0, 0.5)),  # the pose never does
        ((0.0, 0.0, 0.0, 0.0, 0.1), (0.1, 0.01, 0.006, 0.0019, 0.0), (), (4.0, 0.1)),  # of the pose
    ],
)
def test_the_decay_of_the_start_lasts_until_errors_are_small_and_grow(force, heights, events, expected):
    error = np.zeros((5, 2))
    error[:, 0] = force
    pose = np.zeros((5, 6))
    pose[:, 1] = heights
    result = made(np.arange(5.0), events=events, internal_axial_error=error, pose_error=pose)
    monitor, name = monitored(result.arrays, result.scenario), LARGEST["internal force"]
    assert (monitor.counted_from[name], monitor.largest[name]) == expected
    assert result.metrics()[name] == expected[1]


def test_settling_ends_at_the_first_event_and_resettling_starts_there():
    heights = [OUT, IN, OUT, IN, OUT, IN]
    result = made(TIMES, payload_pose=along_z(heights), events=(event(2.0),))
    assert result.settling_time() == math.inf  # no sample is in the band between 1.0 and the event at 2.0
    assert result.metrics()["resettling_time_s"] == 2.0
    result = made(TIMES, payload_pose=along_z(heights), events=(event(3.0),))
    assert (result.settling_time(), result.metrics()["resettling_time_s"]) == (2.0, 1.0)


def test_resettling_is_nan_without_an_event_and_where_nothing_left_the_band():
    left_before = along_z([OUT, 0, 0, 0, 0, 0])
    assert math.isnan(made(TIMES, payload_pose=along_z([OUT] * 6)).metrics()["resettling_time_s"])
    assert math.isnan(
        made(TIMES, payload_pose=left_before, events=(event(2.0),)).metrics()["resettling_time_s"]
    )
    never = made(TIMES, payload_pose=along_z([0, 0, 0, 0, 0, OUT]), events=(event(2.0),))
    assert never.metrics()["resettling_time_s"] == math.inf


def test_the_peak_after_an_event_is_of_the_position_from_the_event_to_the_last_sample():
    pose = poses([(9.0, 0, 0), (0, 0, 0), (0.3, 0, 0.4), (0.1, 0, 0)], [2.0, 2.0, 2.0, 2.0])
    times = [0.0, 1.0, 2.0, 3.0]
    assert math.isnan(made(times, payload_pose=pose).metrics()["event_peak_position_error_m"])
    assert_close(
        made(times, payload_pose=pose, events=(event(1.0),)).metrics()["event_peak_position_error_m"],
        0.5,
        atol=EXACT,
    )
    assert_close(
        made(times, payload_pose=pose, events=(event(2.0),)).metrics()["event_peak_position_error_m"],
        0.5,
        atol=EXACT,
    )
    assert_close(
        made(times, payload_pose=pose, events=(event(2.5),)).metrics()["event_peak_position_error_m"],
        0.1,
        atol=EXACT,
    )


STEADY = [0.0, 3.99, 4.0, 5.0, 6.0, 7.0]


def test_rms_errors_are_over_what_is_moving_or_at_rest_or_a_window():
    positions = [(8, 8, 8), (8, 8, 8), (0.3, 0, 0.4), (0, 0.7, 0), (0, 0, 0), (0.2, 0, 0)]
    turns = [1.0, 1.0, -0.1, 0.2, 0.0, 0.5]
    pose = poses(positions, turns)
    found = made(STEADY, payload_pose=pose, desired_twist=np.eye(6))
    assert_close(found.position_rms(), 0.2 / math.sqrt(2), atol=EXACT)  # all is small at 6 s
    assert_close(found.orientation_rms(), 0.5 / math.sqrt(2), atol=EXACT)
    window = (4.0, 7.0)
    assert_close(found.position_rms(window=window), math.sqrt((0.25 + 0.49 + 0.04) / 4), atol=EXACT)
    assert_close(found.orientation_rms(window=window), math.sqrt((0.01 + 0.04 + 0.25) / 4), atol=EXACT)
    push = PUSH | {"time": 4.0, "duration": 2.0}
    cut = made(STEADY, payload_pose=pose, events=(push,), desired_twist=np.array((0, 0, 1, 0, 0, 0))[:, None])
    values = cut.metrics()
    assert_close(values["rest_position_rms_m"], math.sqrt(0.04 / 2), atol=EXACT)
    assert math.isnan(values["moving_position_rms_m"])  # at 4 s alone, and then it is pushed
    assert_close(values["after_event_orientation_rms_rad"], math.sqrt(0.25 / 2), atol=EXACT)


# ------------------------------------------------------------ internal force


def squeezed(left, desired, **samples):
    """Wrenches on two arms at (0, 0, 0) and (2, 0, 0): equal and opposite, desired ones in payload axes."""
    both = [np.stack((np.array(rows), -np.array(rows)), axis=1) for rows in (left, desired)]
    return made(STEADY, interaction_wrench=both[0], desired_squeeze=both[1], **samples)


def test_internal_force_over_a_window():
    left = [[99.0] * 6] * 2 + [
        [-10, 3, 4, 1, 2, 2],
        [-12, 0, 1, 0, 0, 5],
        [-8, 0, 0, 0, 0, 0],
        [-2, 0, 0, 0, 0, 0],
    ]
    wanted = [[0.0] * 6] * 2 + [
        [-8, 3, 0, 1, 0, 2],
        [-8, 0, 0, 0, 0, 1],
        [-8, 0, 0, 0, 0, 0],
        [-4, 0, 0, 0, 0, 0],
    ]
    found = squeezed(left, wanted).internal_force(window=(4.0, 7.0))
    assert_close(found.axial_mean, (-10 - 12 - 8 - 2) / 4, atol=EXACT)
    assert_close(found.axial_rms_error, math.sqrt((4 + 16 + 0 + 4) / 4), atol=EXACT)
    assert_close(found.shear_rms, math.sqrt((16 + 1 + 0 + 0) / 4), atol=EXACT)
    assert_close(found.moment_rms_error, math.sqrt((4 + 16 + 0 + 0) / 4), atol=EXACT)
    assert_close(found.force_rms_error, math.sqrt((24 + 17) / 4), atol=EXACT)
    before = squeezed(left, wanted).internal_force(window=(4.0, 6.0))
    assert_close(before.axial_mean, -11.0, atol=EXACT)
    assert_close(before.moment_rms_error, math.sqrt(20 / 2), atol=EXACT)
    over = metrics.internal_force(squeezed(left, wanted).data, np.array([False] * 4 + [True] * 2))
    assert_close(over.axial_mean, -5.0, atol=EXACT)


def test_parts_of_the_actual_and_of_the_desired_internal_wrench():
    data = squeezed([[-10, 3, 4, 1, 2, 2]] * 6, [[-8, 0, 6, 0, 3, 4]] * 6).data
    for name, value in {
        "internal_axial": -10.0,
        "internal_shear": 5.0,
        "internal_moment": 3.0,
        "desired_internal_axial": -8.0,
        "desired_internal_shear": 6.0,
        "desired_internal_moment": 5.0,
        "internal_axial_error": -2.0,
        "internal_shear_error": math.hypot(3, 2),
        "internal_moment_error": math.sqrt(1 + 1 + 4),
    }.items():
        assert_close(data[name], np.full((6, 2), value), atol=EXACT)


def test_rows_that_rigid_bodies_do_not_determine_count_as_zero():
    nan = math.nan
    data = squeezed([[-10, 3, nan, nan, nan, 2]] * 6, [[-8, 0, 0, 0, 0, 0]] * 6).data
    assert_close(data.internal_axial, np.full((6, 2), -10.0), atol=EXACT)
    assert_close(data.internal_shear, np.full((6, 2), 3.0), atol=EXACT)
    assert_close(data.internal_moment, np.full((6, 2), 2.0), atol=EXACT)
    assert data.wrench_is_determined.values.tolist() == [True, True, False, False, False, True]


def test_every_definition_takes_undetermined_rows_as_zero():
    """Forces along z would turn about x and y; without them the tips lie in one plane."""
    rng = np.random.default_rng(8)
    F, tips = rng.normal(size=(2, 2, 6)), rng.normal(size=(2, 2, 3))
    F[..., 2] = np.nan
    found = made([0.0, 1.0], interaction_wrench=F, tip_position=tips).internal_wrench_definitions()
    known, plane = np.nan_to_num(F), tips * (1.0, 1.0, 0.0)
    for name, definition in {
        "minimum_norm": minimum_norm_internal_wrenches,
        "nonsqueezing": nonsqueezing_internal_wrenches,
        "virtual_linkage": virtual_linkage_internal_wrenches,
    }.items():
        expected = definition(known, plane)
        expected[..., 2] = np.nan
        assert_close(found[name], expected, atol=1e-12)


def test_the_internal_wrench_is_what_the_load_shares_leave():
    scenario = SCENARIO.replace(cell=SCENARIO.cell.replace(load_shares={"left": 0.25, "right": 0.75}))
    wrench = np.zeros((2, 2, 6))
    wrench[:, 0], wrench[:, 1] = (4, 1, 0, 0, 0, 8), (8, 3, 0, 0, 0, 0)
    data = made([0.0, 1.0], scenario=scenario, interaction_wrench=wrench).data
    left = np.array((4 - 3, 1 - 1, 0, 0, 0, 8 - 2))
    assert_close(data.internal_wrench, np.broadcast_to((left, -left), (2, 2, 6)), atol=EXACT)


def test_the_desired_wrench_turns_with_the_payload():
    turned = poses([(5.0, 0, 0)] * 2, [math.pi / 2, 0.0], axis=(0.0, 0.0, 1.0))
    data = made([0.0, 1.0], payload_pose=turned, desired_squeeze=(1, 2, 3, 4, 5, 6)).data
    assert_close(data.desired_internal_wrench[0], [(-2, 1, 3, -5, 4, 6)] * 2, atol=1e-13)
    assert_close(data.desired_internal_wrench[1], [(1, 2, 3, 4, 5, 6)] * 2, atol=EXACT)


def test_the_axial_direction_of_three_arms_is_towards_the_middle_of_the_other_two():
    tips = np.array([(0, 0, 0), (6, 0, 0), (0, 8, 0)], dtype=float)
    wrench = np.zeros((2, 3, 6))
    wrench[:, 0], wrench[:, 1], wrench[:, 2] = (10, 0, 1, 0, 0, 0), (-10, 5, 0, 0, 0, 0), (0, -5, -1, 0, 0, 0)
    data = made([4.0, 5.0], scenario=PLATE, tip_position=tips, interaction_wrench=wrench).data
    directions = [
        (0.6, 0.8, 0.0),
        (-6 / math.sqrt(52), 4 / math.sqrt(52), 0.0),
        (3 / math.sqrt(73), -8 / math.sqrt(73), 0.0),
    ]
    assert_close(data.axial_direction, [directions] * 2, atol=EXACT)
    axial = [6.0, 80 / math.sqrt(52), 40 / math.sqrt(73)]
    assert_close(data.internal_axial, [axial] * 2, atol=1e-13)
    shear = [math.sqrt(101 - 36), math.sqrt(125 - 6400 / 52), math.sqrt(26 - 1600 / 73)]
    assert_close(data.internal_shear, [shear] * 2, atol=1e-13)
    assert_close(metrics.internal_force(data, np.ones(2, dtype=bool)).axial_mean, sum(axial) / 3, atol=1e-13)


def test_the_band_has_its_edges():
    data = made([0.0, 1.0]).data
    data["pose_error"][:, 0] = data["pose_error"][:, 4] = 5e-3
    assert metrics.in_band(data, turns=True).all()
    data["pose_error"][1, 4] = math.nextafter(5e-3, 1.0)
    assert metrics.in_band(data, turns=True).tolist() == [True, False]
    assert metrics.in_band(data, turns=False).all()


def test_on_positional_rows_the_position_alone_settles():
    """A turn that nothing controls, of 0.1 rad at the end; then one of the position."""
    scenario = SCENARIO.replace(cell=SCENARIO.cell.replace(rows="positional"))
    turned = along_z([0.0] * 6, np.array([0, 0, 0, 0, 0, 0.1]))
    result = made(STEADY, scenario=scenario, payload_pose=turned)
    assert result.settling_time() == result.metrics()["settling_time_s"] == 0.0
    assert result.task.kept
    away = made(STEADY, scenario=scenario, payload_pose=along_z([0, 0, 0, 0, 0, 0.02]))
    assert away.settling_time() == math.inf
    assert away.task.deviations == (("position", "", "", 7.0, 0.02, 2e-3),)


DRIFTING = np.linspace(0.0, 8.0, 17)


@pytest.mark.parametrize(
    ("changes", "drift"),
    [
        ({}, 0.03),
        ({"payload_twist": (0.0, 0.0, 9e-3, 0.0, 0.0, 0.0)}, math.nan),  # the payload moves as well
        ({"payload_twist": (0.0, 0.0, 3e-3, 0.0, 0.0, 0.0)}, 0.03),
        ({"desired_twist": np.where(DRIFTING[:, None] == 4.0, 1e-9, 0.0)}, math.nan),
        ({"desired_twist": np.where(DRIFTING[:, None] == 3.5, 1.0, 0.0)}, 0.03),
        ({"events": (event(3.5),)}, math.nan),
        ({"events": (event(3.0),)}, 0.03),
    ],
)
def test_joints_drift_where_the_payload_rests_in_the_last_second(changes, drift):
    """The second joint of the last arm at -0.03 rad/s on average; earlier speeds do not count."""
    speeds = np.zeros((len(DRIFTING), 2, 2))
    speeds[:-3] = 1.0
    speeds[-3:, 1, 1] = (-0.01, -0.07, -0.01)
    result = made(DRIFTING, joint_velocity=speeds, **changes)
    assert_close(result.metrics()["joint_drift_rad"], drift, atol=1e-15)
    breaches = [breach for breach in result.task.deviations if breach.cause == "joint drift"]
    assert [(breach.arm, breach.joint, breach.time) for breach in breaches] == [
        ("right", "two", 7.0) for _ in range(not math.isnan(drift))
    ]
    patient = cp.RunResult(result.scenario.override({"task.joint_drift": 0.04}), result.data)
    assert not [breach for breach in patient.task.deviations if breach.cause == "joint drift"]


def test_a_summary_says_how_long_the_run_was_and_whether_that_was_all():
    for end, is_whole in ((7.0, True), (7.0 - 1e-10, True), (6.5, False)):
        result = made([*STEADY[:-1], end])
        second = cp.RunResult(result.scenario.replace(duration=7.0), result.data).summary().splitlines()[1]
        assert second.split(";")[0].split()[:2] == [f"{end:g}", "s"]
        assert ("ended before its 7 s" in second) is not is_whole


@pytest.mark.parametrize(("times", "missing"), [((), False), ((1.0,), False), ((1.0, 7.5), True)], ids=str)
def test_a_summary_says_that_a_run_ends_with_its_events(times, missing):
    result = made(STEADY)
    scenario = result.scenario.replace(duration=8.0, events=tuple(map(event, times)))
    summary = cp.RunResult(scenario, result.data).summary()
    assert ("no metrics after the last event" in summary) is missing
    assert "no metrics while the reference moves" in summary


def test_a_torque_beyond_its_limit_is_what_was_asked_with_the_compensation_of_gravity():
    actuators = SCENARIO.actuators.replace(gravity_compensation=cp.actuators.GravityCompensation())
    limits = np.full((4, 2, 2), NO_LIMIT)
    limits[list(LIMITS).index("torque_limit")] = 10.0
    result = made(
        [0.0, 1.0],
        scenario=SCENARIO.replace(actuators=actuators),
        limits=limits,
        commanded_torque=12.0,
        requested_torque=[[(9.0, 11.0), (9.0, 9.0)]],
    )
    assert result.limit_violations() == (LimitViolation("left", "two", "torque", 11.0, 10.0, 0.0),)


def test_a_metric_that_is_no_number_is_a_word():
    assert metrics.metric_text(0.123456) == "0.1235"
    words = {metrics.metric_text(math.nan), metrics.metric_text(math.inf)}
    assert len(words) == 2
    assert all(word.replace(" ", "").isalpha() for word in words)


@pytest.mark.parametrize(("summary", "title"), [("", SCENARIO.name), ("Two arms.", "Two arms.")])
def test_the_title_of_a_dataset_is_the_summary_or_the_name(summary, title):
    assert made([0.0, 1.0], scenario=SCENARIO.replace(summary=summary)).data.title == title


def test_a_tip_in_the_middle_of_the_others_has_no_axial_direction():
    tips = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0)], dtype=float)
    data = made([0.0, 1.0], scenario=PLATE, tip_position=tips).data
    nan = math.nan
    assert_close(data.axial_direction, [[(1, 0, 0), (nan, nan, nan), (-1, 0, 0)]] * 2, atol=EXACT)


def test_a_single_arm_has_no_internal_force():
    cell = SCENARIO.cell
    alone = SCENARIO.replace(
        cell=cell.replace(
            arms={"left": cell.arms["left"]}, grasps={"left": cell.grasps["left"]}, load_shares=None
        ),
        squeeze={},
    )
    found = made(STEADY, scenario=alone, interaction_wrench=(1, 2, 3, 4, 5, 6))
    assert np.isnan(found.data.axial_direction).all()
    assert np.isnan(found.internal_force()).all()
    assert not found.data.internal_wrench.any()


# ------------------------------------------------------------ closure error, energy, torques, limits


def test_closure_error_torque_peak_and_energy_balance_are_over_the_whole_run():
    distance, angle = np.zeros((3, 2)), np.zeros((3, 2))
    distance[0, 1], distance[2, 0], angle[2, 1] = 3e-3, 2e-3, 7e-3
    torque = np.array([[(1, math.nan), (-2, 3)], [(-9, math.nan), (4, 5)], [(0, math.nan), (8, 0)]])
    result = made(
        [0.0, 1.0, 2.0],
        closure_distance=distance,
        closure_angle=angle,
        torque=torque,
        kinetic_energy=[1, 4, 2],
        potential_energy=[10, 12, 9],
        work_actuation=[0, 8, 8],
        work_friction=[0, -2, -4],
        work_external=[0, 1, 1],
        work_payload_change=[0, 0, -6],
    )
    assert result.closure_error_max() == (3e-3, 7e-3)
    assert result.metrics()["torque_peak_Nm"] == 9.0
    assert_close(energy_balance(result.data), [0.0, -2.0, 1.0], atol=EXACT)
    assert_close(result.energy_balance_max(), 2.0, atol=EXACT)


@pytest.mark.parametrize(
    ("cell", "engine", "every"),
    [
        ("spatial", "pinocchio", 3),
        *(
            pytest.param(*others, marks=pytest.mark.slow)
            for others in (
                ("planar", "compiled", 3),
                *(("planar", "pinocchio", 1), ("spatial", "compiled", 1)),
                *(("planar", "pinocchio", 3), ("planar", "compiled", 1)),
                *(("spatial", "pinocchio", 1), ("spatial", "compiled", 3)),
            )
        ),
    ],
)
def test_the_work_of_an_event_at_the_start_is_no_energy_error(cell, engine, every):
    """As of one at the next tick: at t = 0 the work is done before the first sample."""
    scenario = SCENARIOS[cell]()
    half = {"kind": "payload-change", "mass": scenario.cell.payload.mass / 2.0}
    turn = {"kind": "gravity-turn", "gravity": (9.81, 0.0, 0.0)}
    for event in (half, turn):
        for time in (0.0, scenario.clock.period):
            changes = {"events": [event | {"time": time}], "duration": 0.2, "clock.record_every": every}
            result = cp.run(scenario.override(changes), engine=engine, warn=False)
            balance = np.abs(energy_balance(result.arrays)).max()
            assert max(balance, result.energy_balance_max()) < 1e-6
            assert "energy" not in {breach.cause for breach in result.breaches()}
    assert np.abs(result.data.work_payload_change.values[-1]) > 1e-3


def test_limits_that_were_exceeded():
    limits = np.full((4, 2, 2), NO_LIMIT)
    limits[0, 0, 0], limits[1, 0, 0] = -1.0, 2.0
    limits[2, 0, 0], limits[3, 0, 0] = 3.0, 10.0
    limits[2, 1, 0] = 3.0
    position, velocity, commanded = np.zeros((4, 2, 2)), np.zeros((4, 2, 2)), np.zeros((4, 2, 2))
    position[:, 0, 0] = [0.0, 2.1, -1.5, 2.2]
    velocity[:, 0, 0] = [0.0, -3.0, -3.5, 3.2]
    velocity[:, 1, 0] = [0.0, 3.0, 3.0 + 1e-10, -3.0]
    commanded[:, 0, 0] = [0.0, 0.0, 0.0, 10.5]
    for values in (position, velocity, commanded):
        values[:, :, 1] = 1e9  # no limit, and in the left arm no joint
    result = made(
        [0.0, 1.0, 2.0, 3.0],
        limits=limits,
        joints=[["one"], ["one", "two"]],
        joint_position=position,
        joint_velocity=velocity,
        commanded_torque=commanded,
    )
    assert result.limit_violations() == (
        LimitViolation("left", "one", "position", -1.5, -1.0, 1.0),
        LimitViolation("left", "one", "velocity", -3.5, -3.0, 2.0),
        LimitViolation("left", "one", "torque", 10.5, 10.0, 3.0),
    )


# ------------------------------------------------------------ all together


def test_every_metric_stands_under_its_own_name():
    position = [(0.1, 0, 0), (0, 0, 0), (0.3, 0, 0), (0, 0, 0), (0, 0.4, 0), (0, 0, 0)]
    result = made(
        [0.0, 1.0, 4.0, 5.0, 6.0, 7.0],
        events=(event(6.0),),
        payload_pose=poses(position, [0.0, 0.0, 0.0, 0.5, 0.0, 0.0]),
        interaction_wrench=[[(-4, 3, 0, 0, 0, 2), (4, -3, 0, 0, 0, -2)]],
        closure_distance=1e-9,
        closure_angle=2e-9,
        kinetic_energy=[0, 0, 0, 0, 0, 6],
        torque=-11.0,
    )
    found = result.metrics()
    force = {
        "internal_axial_mean_N": -4.0,
        "internal_axial_rms_error_N": 4.0,
        "internal_shear_rms_N": 3.0,
        "internal_moment_rms_error_Nm": 2.0,
    }
    expected = {
        "simulation_sound": 0.0,
        "task_kept": 0.0,
        "position_error_max_m": 0.4,
        "orientation_error_max_rad": 0.0,
        "internal_force_error_max_N": 5.0,
        "internal_moment_error_max_Nm": 2.0,
        "settling_time_s": math.inf,
        "resettling_time_s": 1.0,
        "event_peak_position_error_m": 0.4,
        "moving_position_rms_m": math.nan,
        "moving_orientation_rms_rad": math.nan,
        **{f"moving_{name}": math.nan for name in force},
        "rest_position_rms_m": 0.4 / math.sqrt(2),
        "rest_orientation_rms_rad": 0.0,
        **{f"rest_{name}": value for name, value in force.items()},
        "after_event_position_rms_m": 0.4 / math.sqrt(2),
        "after_event_orientation_rms_rad": 0.0,
        **{f"after_event_{name}": value for name, value in force.items()},
        "closure_error_max_m": 1e-9,
        "closure_error_max_rad": 2e-9,
        "energy_balance_max_J": 6.0,
        "torque_peak_Nm": 11.0,
        "joint_drift_rad": math.nan,
    }
    assert list(found) == list(expected)
    assert found.pop("settling_time_s") == expected.pop("settling_time_s")
    assert_close(list(found.values()), list(expected.values()), atol=1e-13)


def test_every_metric_is_shown_with_the_scale_of_its_unit():
    """From the unit at the end of its name, SI, to the one shown."""
    scales = {("m", "mm"): 1e3, ("rad", "mrad"): 1e3, ("B", "kB"): 1e-3}
    units = {"Nm": "N m"}
    for name, (_, unit, scale) in metrics.METRIC_TEXTS.items():
        in_si = units.get(name.rsplit("_", 1)[1], name.rsplit("_", 1)[1])
        assert scale == (1.0 if unit == in_si else scales[in_si, unit])
    after = [name for name in metrics.METRIC_TEXTS if name.startswith("after_event_")]
    assert after == [f"after_event_{name}" for name in metrics.PHASE_METRICS]


def test_where_one_error_never_decays_no_mean_has_the_start_of_the_others_in_it():
    """One arm is off by 1 mm: the force is never within its limit, position and turn come to be."""
    bias = {"events": (), "duration": 6.0, "cell.arms.left.calibration_error.tip.xyz": (1e-3, 0.0, 0.0)}
    result = cp.run("adept-paper", bias | {"controller.gains.sign_gain": 0.2}, warn=False)
    metrics, (largest,) = result.metrics(), result.windows_of("position_error_max_m")
    assert 0.0 < largest.start < largest.end == result.end
    assert metrics["moving_position_rms_m"] <= metrics["position_error_max_m"] < 2e-3
    assert result.windows_of("moving_position_rms_m")[0].start >= largest.start
    assert result.windows_of("internal_force_error_max_N") == (Window(0.0, result.end),)


@pytest.mark.parametrize("name", ["adept-compliant", "two-pandas-box"])
@pytest.mark.parametrize(
    "event",
    [
        {"kind": "payload-change", "time": 0.0, "mass": 5.0},
        {"kind": "gravity-turn", "time": 0.0, "gravity": [0.0, 9.81, 0.0]},
    ],
)
def test_energy_is_balanced_from_before_an_event_at_the_start(name, event):
    result = cp.run(name, {"duration": 0.05, "events": [event]}, warn=False)
    work = result.data["work_payload_change"].values[0]
    assert abs(work) > 0.005  # J, all of it in the first sample
    assert result.energy_balance_max() < 1e-6
