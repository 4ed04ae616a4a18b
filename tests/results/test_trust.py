"""Verdicts on simulation and task: causes, first times, states; on planar and spatial cells."""

import json
import re

import numpy as np
import pytest
from cells import SCENARIOS, spatial_scenario
from numpy.testing import assert_allclose
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, DivergedError, FieldError, OutOfRangeError
from coop_pin.cli import main
from coop_pin.description.thresholds import TaskLimits, TrustThresholds
from coop_pin.description.urdf import find_urdf
from coop_pin.results.breaches import Breach
from coop_pin.results.energies import WORK
from coop_pin.results.metrics import PHASE_METRICS
from coop_pin.results.task import TaskMonitor
from coop_pin.results.trust import TrustMonitor

GOALS = {  # straight paths that stretch an arm: through a singular pose
    "planar": {"xyz": (0.5, 0.75, 0.0)},
    "spatial": {"xyz": (0.45, 0.05, 0.9), "rpy": (0.3, -0.2, 0.5)},
}
STOPS = {  # robot, joint, the side and place of a narrower stop, which a path to the goal passes
    "planar": ("adept_3dof", "joint_2", "upper", -1.6, {"xyz": (0.6, 0.35, 0.0), "rpy": (0.0, 0.0, 0.947)}),
    "spatial": ("ur5", "elbow_joint", "upper", 1.9, {"xyz": (0.45, 0.05, 0.6), "rpy": (0.3, -0.2, 0.5)}),
}


def along_a_line(name, goal, duration):
    scenario = SCENARIOS[name]()
    motion = {"kind": "line", "start": scenario.start, "goal": goal, "duration": 2.0}
    return scenario.override({"motion": motion, "events": [], "duration": duration})


@pytest.fixture(scope="module", params=SCENARIOS)
def singular(request):
    return cp.run(along_a_line(request.param, GOALS[request.param], 2.5), warn=False)


def causes(result):
    return {breach.cause for breach in result.breaches()}


# ---------------------------------------------------------------- causes


@pytest.mark.parametrize("name", by_default(["adept-paper", "two-pandas-box"], "adept-paper"))
def test_a_sound_run_that_keeps_its_task_says_so(name):
    result = cp.run(name, {"duration": 3.0, "events": []}, warn=False)
    assert result.breaches() == result.task.deviations == ()
    assert (result.simulation_sound, result.task.state, result.task.kept) == (True, "kept", True)
    assert result.verdict() == f"{result.task.text}; simulation sound"
    assert [result.metrics()[name] for name in ("simulation_sound", "task_kept")] == [1.0, 1.0]
    with pytest.raises(AttributeError, match="simulation_sound"):
        _ = result.trustworthy


def test_a_motion_through_a_singular_pose_is_marked_with_the_pose_as_its_first_cause(singular):
    """Its position error afterwards is small: nothing else on top of the table says so."""
    first, *others = singular.breaches()
    assert first.cause == "jacobian condition"
    assert first.allowed == 100.0 < first.value
    conditions = singular.data.jacobian_condition.sel(arm=first.arm).values
    assert first.time == singular.data.time.values[np.flatnonzero(conditions > 100.0)[0]]
    assert first.value == conditions.max()
    expected = {"energy"} if len(singular.data.joint) == 6 else {"closure error", "energy"}
    assert causes(singular) >= expected
    assert singular.task.state == "off"
    assert [breach.time for breach in others] == sorted(breach.time for breach in others)
    assert not singular.simulation_sound
    assert singular.metrics()["simulation_sound"] == 0.0
    more = f"; {len(others)} more" * bool(others)
    assert (
        singular.verdict()
        == f"SIMULATION NOT SOUND: {first}{more}; do not believe the rest: {singular.task.text}"
    )
    assert singular.summary().splitlines()[0] == f"{singular.scenario.name}: {singular.verdict()}"


def test_what_was_breached_and_when_is_what_the_record_says(singular):
    """Energy and closure errors against their definitions, over the whole record."""
    data, found = singular.data, {(breach.cause, breach.arm): breach for breach in singular.breaches()}
    works = [data[f"work_{name}"].values for name in ("actuation", "friction", "external", "payload_change")]
    gravity = data.potential_energy.values
    gross = np.cumsum([0.0, *sum(np.abs(np.diff(work)) for work in (*works, gravity))])
    energy = data.kinetic_energy.values + gravity
    error, allowed = np.abs(energy - energy[0] - sum(works)), 1e-6 + 1e-6 * gross
    breach = found["energy", ""]
    assert breach.time == data.time.values[np.flatnonzero(error > allowed)[0]]
    worst = np.argmax(error - allowed)
    assert_allclose((breach.value, breach.allowed), (error[worst], allowed[worst]), rtol=1e-9)
    for arm in data.arm.values:
        closure = np.maximum(data.closure_distance, data.closure_angle).sel(arm=arm).values
        assert (("closure error", arm) in found) == (closure.max() > 1e-6)
        if closure.max() > 1e-6:
            breach = found["closure error", arm]
            assert breach[3:5] == (data.time.values[np.flatnonzero(closure > 1e-6)[0]], closure.max())


def stopped(name, folder):
    robot, joint, side, stop, goal = STOPS[name]
    found = find_urdf(robot)
    pattern = rf'(<joint name="{joint}".*?{side}=")[^"]*'
    text, changed = re.subn(pattern, rf"\g<1>{stop}", found.path.read_text(), count=1, flags=re.DOTALL)
    assert changed == 1
    (folder / "narrow.urdf").write_text(text)
    scenario = along_a_line(name, goal, 1.5)
    arm = scenario.cell.arms["left"]
    near = {"urdf": str(folder / "narrow.urdf"), "package_dirs": [str(path) for path in found.package_dirs]}
    arms = dict(scenario.cell.arms) | {"left": arm.replace(**near)}
    return scenario.replace(cell=scenario.cell.replace(arms=arms))


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_arm_through_its_joint_stop_is_marked(name, tmp_path):
    """The plant has no stops: the arm goes on as if nothing were there, and the tracking looks good."""
    _, joint, side, stop, _ = STOPS[name]
    result = cp.run(stopped(name, tmp_path), warn=False)
    (breach,) = result.breaches()
    positions = result.data.joint_position.sel(arm="left").values
    positions = positions[:, list(result.data.joint_name.sel(arm="left").values).index(joint)]
    beyond = positions - stop if side == "upper" else stop - positions
    assert breach[:3] == ("joint limit", "left", joint)
    assert breach.time == result.data.time.values[np.flatnonzero(beyond > 1e-6)[0]] > 0.0
    assert (breach.value, breach.allowed) == (positions[np.argmax(beyond)], stop)
    assert f"left {joint} at its stop from {breach.time:.4g} s" in result.verdict()
    slack = {"trust.joint_slack": float(beyond.max()) + 0.1}
    assert cp.RunResult(result.scenario.override(slack), result.data).simulation_sound


def test_a_torque_cut_breaches_when_it_lasts_without_a_break():
    """Cuts of 0.1 s are borne by default, longer ones are not; the time is the start of the cut."""
    weak = {"duration": 0.5, "events": [], "cell.arms.left.torque_limits": 3.0}
    result = cp.run("adept-paper", weak, warn=False)
    saturated = result.data.saturated.sel(arm="left").values
    found = [breach for breach in result.task.deviations if breach.cause == "torque cut"]
    expected = []
    for joint, cut in zip(result.data.joint_name.sel(arm="left").values, saturated.T, strict=True):
        runs = [span.span() for span in re.finditer("1+", "".join(str(int(tick)) for tick in cut))]
        long = [(first, (last - first - 1) / 80.0) for first, last in runs if (last - first - 1) / 80.0 > 0.1]
        if long:
            expected.append(
                ("torque cut", "left", joint, long[0][0] / 80.0, max(span[1] for span in long), 0.1)
            )
    assert expected
    assert sorted(breach[:3] for breach in found) == sorted(entry[:3] for entry in expected)
    for breach, entry in zip(sorted(found), sorted(expected), strict=True):
        assert_allclose(breach[3:], entry[3:], rtol=0, atol=1e-9)
    patient = cp.RunResult(result.scenario.override({"task.torque_cut": 1.0}), result.data)
    assert "torque cut" not in {breach.cause for breach in patient.task.deviations}


def test_a_torque_cut_lasts_as_long_where_few_samples_are_kept():
    """Start and end are known to within the time from one to the next."""
    weak = {"duration": 0.8, "events": [], "cell.arms.left.torque_limits": 1.0}
    cut = {}
    for every in (1, 7):
        breaches = cp.run("adept-paper", weak | {"clock.record_every": every}, warn=False).task.deviations
        cut[every] = {b.joint: (b.time, b.value) for b in breaches if b.cause == "torque cut"}
    assert cut[7]
    for joint, found in cut[7].items():
        assert_allclose(found[0], cut[1][joint][0], rtol=0, atol=7 / 80)
        assert_allclose(found[1], cut[1][joint][1], rtol=0, atol=2 * 7 / 80)


def test_a_diverged_run_says_so_last_and_still_does_after_loading(tmp_path):
    late = {"controller.force_path": {"kind": "late"}, "controller.gains.force_gain": 1.5}
    with pytest.raises(DivergedError) as caught:
        cp.run("adept-paper", late | {"beyond_bound": True, "events": []}, warn=False)
    result = caught.value.result
    assert result.task.state == "lost"
    assert result.task.deviations[-1] == ("error", "", "", result.end, result.end, 20.0)
    result.save(tmp_path / "result.nc")
    assert cp.RunResult.load(tmp_path / "result.nc").task == result.task


def test_what_is_no_number_is_a_breach(singular):
    data = singular.data.copy(deep=True)
    data["closure_angle"][3, 1] = np.nan
    data["kinetic_energy"][5] = np.nan
    data["jacobian_condition"][4, 0] = np.nan
    times = {breach[:2]: breach.time for breach in cp.RunResult(singular.scenario, data).breaches()}
    left, right = data.arm.values
    assert times["closure error", right] == data.time.values[3]
    assert times["jacobian condition", left] == data.time.values[4]
    assert times["energy", ""] == data.time.values[5]


# ---------------------------------------------------------------- while it runs


def test_samples_one_by_one_have_the_breaches_of_the_whole(singular):
    data = singular.data
    joints = [(str(arm), list(data.joint_name.sel(arm=arm).values)) for arm in data.arm.values]
    limits = data.position_lower.values, data.position_upper.values
    monitor = TrustMonitor(singular.scenario.trust, joints, *limits)
    samples = {str(name): data[name].values for name in ("time", *data.data_vars)}
    varying = {name: values for name, values in samples.items() if "time" in data[name].dims}
    first = {}
    for tick in range(len(data.time)):
        for breach in monitor.breaches({name: values[tick : tick + 1] for name, values in varying.items()}):
            first.setdefault(breach[:3], breach.time)
    assert first.keys() == {breach[:3] for breach in singular.breaches()}
    for breach in singular.breaches():
        assert_allclose(first[breach[:3]], breach.time, rtol=0, atol=1e-9)


def test_a_run_can_end_at_its_first_breach(singular):
    ended = cp.run(singular.scenario, stop_at_breach=True, warn=False)
    first = singular.breaches()[0]
    assert ended.end == first.time < singular.end
    assert [breach[:4] for breach in ended.breaches()] == [first[:4]]
    for name in ("configuration", "torque", "interaction_wrench"):
        part = singular.data[name].values[: len(ended.data.time)]
        np.testing.assert_array_equal(ended.data[name].values, part)


def test_a_sound_run_does_not_end_early():
    assert cp.run("adept-paper", {"duration": 0.5, "events": []}, stop_at_breach=True, warn=False).end == 0.5


# ---------------------------------------------------------------- thresholds


def test_thresholds_are_fields_of_the_scenario():
    scenario = spatial_scenario().override({"trust.closure_error": 1e-20})
    assert cp.Scenario.from_toml(scenario.to_toml()).trust == TrustThresholds(closure_error=1e-20)
    assert causes(cp.run(scenario.replace(duration=0.02), warn=False)) == {"closure error"}
    for wrong in ({"closure_error": 0.0}, {"torque_cut": 1.0}, {"jacobian_condition": 0.5}):
        with pytest.raises(FieldError):
            TrustThresholds(**wrong)
    with pytest.raises(FieldError, match=r"task\.torque_cut"):
        scenario.override({"trust.torque_cut": 0.5})
    for wrong in ({"position": 0.0}, {"torque_cut": -1.0}, {"recovery": -1.0}):
        with pytest.raises(FieldError):
            TaskLimits(**wrong)


# ---------------------------------------------------------------- windows


@pytest.fixture(scope="module")
def pushed():
    """Six seconds with an event that ends at 1.1 s."""
    push = {"kind": "wrench-pulse", "time": 1.0, "duration": 0.1, "wrench": (50.0, 0.0, 0.0, 0.0, 0.0, 0.0)}
    return cp.run("adept-paper", {"duration": 6.0, "events": [push]}, warn=False)


def test_metrics_after_the_last_event_have_their_own_window(pushed):
    metrics = pushed.metrics()
    ((start, end),) = pushed.windows_of("after_event_position_rms_m")
    assert_allclose((start, end), (3.1, 6.0), atol=0.5 / 80)  # with the 2 s of recovery
    inside = pushed.data.time.values >= start - 1e-9
    assert_allclose(
        metrics["after_event_internal_axial_mean_N"], pushed.data.internal_axial.values[inside].mean()
    )
    assert metrics["after_event_position_rms_m"] == pushed.position_rms(window=(start, end))


def test_a_window_can_be_asked_for(pushed):
    time, error = pushed.data.time.values, pushed.data.pose_error.values
    inside = (time > 2.0 - 1e-9) & (time < 3.0 - 1e-9)
    found = pushed.position_rms(window=(2, 3)), pushed.orientation_rms(window=(2, 3))
    expected = [
        np.sqrt((np.linalg.norm(error[inside, part], axis=1) ** 2).mean())
        for part in (slice(0, 3), slice(3, 6))
    ]
    assert_allclose(found, expected, rtol=1e-12)
    force = pushed.internal_force(window=(2.0, 3.0))
    assert_allclose(force.axial_mean, pushed.data.internal_axial.values[inside].mean(), rtol=1e-12)
    for wrong in ((3.0, 2.0), (2.0, 2.0), (-1.0, 2.0), (5.0, 7.0), (np.nan, 2.0), (7.0, 8.0)):
        with pytest.raises(OutOfRangeError):
            pushed.internal_force(window=wrong)
    for wrong in (3.0, (1.0,), "ab", (1.0, 2.0, 3.0), (None, 2.0)):
        with pytest.raises(ArgumentError):
            pushed.position_rms(window=wrong)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_short_run_has_its_tracking_metrics(name):
    result = cp.run(SCENARIOS[name]().replace(duration=0.5, events=()), warn=False)
    metrics = result.metrics()
    assert all(np.isnan(metrics[f"after_event_{metric}"]) for metric in PHASE_METRICS)
    assert np.isfinite([result.position_rms(), result.orientation_rms(), *result.internal_force()]).all()
    moves = result.data.desired_twist.values.any()
    assert np.isfinite(metrics["moving_position_rms_m" if moves else "rest_position_rms_m"])


def test_every_metric_has_its_window_beside_it_in_the_summary(pushed):
    lines = {line.split()[0]: line for line in pushed.summary().splitlines()[2:]}
    applies = [name for name, value in pushed.metrics().items() if not np.isnan(value)]
    assert len(applies) > 10
    for name in applies:
        assert all(str(window) in lines[name] for window in pushed.windows_of(name))
    assert pushed.windows_of("settling_time_s") == ((0.0, 1.0),)
    assert pushed.windows_of("event_peak_position_error_m") == ((1.0, 6.0),)
    assert pushed.windows_of("torque_peak_Nm") == ((0.0, 6.0),)


# ---------------------------------------------------------------- task


@pytest.mark.parametrize("every", by_default([1, 5], 5))
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_largest_errors_are_the_maxima_of_the_data_and_their_limits_make_the_verdict(name, every):
    """After the start's decay, pushes at seeded times and all; also where few samples are kept."""
    rng = np.random.default_rng(len(name))
    for time in rng.uniform(0.0, 0.9, 3):
        push = {"kind": "wrench-pulse", "time": float(time), "duration": 0.05, "wrench": (20.0,) + (0.0,) * 5}
        scenario = SCENARIOS[name]().replace(duration=1.0, task=TaskLimits(), events=(push,))
        whole = cp.run(scenario, warn=False)
        metrics, data = whole.metrics(), whole.data
        errors = {
            "position_error_max_m": np.linalg.norm(data.pose_error.values[:, :3], axis=1),
            "internal_force_error_max_N": np.hypot(
                data.internal_axial_error.values, data.internal_shear_error.values
            ).max(axis=1),
        }
        limits = (whole.scenario.task.position, 1.0)
        if all(values[0] <= limit for values, limit in zip(errors.values(), limits, strict=True)):
            assert [metrics[key] for key in errors] == [values.max() for values in errors.values()]
        else:
            late = data.time.values >= time - 1e-9
            assert all(metrics[key] >= values[late].max() for key, values in errors.items())
        assert whole.task.state == ("kept" if not whole.task.deviations else "off")
        patient = cp.RunResult(scenario.override({"task.recovery": 9.0}), whole.data)
        assert np.isfinite([patient.position_rms(), *patient.internal_force()]).all()
        thinned = cp.run(scenario.override({"clock.record_every": every}), warn=False)
        assert thinned.task == whole.task
        assert_allclose([*thinned.metrics().values()], [*metrics.values()], rtol=1e-9, atol=1e-12)


def deviations(position, force, *, blocks=1, events=(), saturated=(0,) * 7, period=1.0, **task):
    """Deviations of seven samples 1 s apart with position errors, m, and axial errors of the first arm, N."""
    scenario = SCENARIOS["spatial"]().replace(duration=6.0, task=TaskLimits(**task))
    scenario = scenario.override({"events": events})
    m, k = len(scenario.cell.arms), 6
    samples = {
        "time": period * np.arange(7.0),
        "pose_error": np.outer(position, (0.0, 0.6, 0.8, 0.0, 0.0, 0.0)),
        "internal_axial_error": np.outer(force, np.eye(m)[0]),
        "internal_shear_error": np.zeros((7, m)),
        "internal_moment_error": np.zeros((7, m)),
        "internal_wrench": np.zeros((7, m, 6)),
        "desired_internal_wrench": np.full((7, m, 6), (20.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        "saturated": np.multiply.outer(saturated, np.eye(m, k)[:, :] * np.eye(m)[0][:, None]) > 0,
    }
    monitor, found = TaskMonitor([("first", ("a",) * k)] + [("other", ("a",) * k)] * (m - 1)), ()
    for rows in np.array_split(np.arange(7), blocks):
        part = {name: values[rows] for name, values in samples.items()}
        found = monitor.deviations(part, scenario, found)
    return list(found)


OFF, GOOD = 3e-3, 1e-3
PUSHED = {"kind": "wrench-pulse", "time": 3.0, "duration": 1.0, "wrench": (1.0,) + (0.0,) * 5}


@pytest.mark.parametrize("blocks", [1, 2, 7])
@pytest.mark.parametrize(
    ("position", "force", "options", "expected"),
    [
        ([GOOD] * 7, [1.9] * 7, {}, []),  # a tenth of 20 N
        ([GOOD] * 7, [0, 0, 2.1, 2.5, 0, 2.4, 0], {}, [("internal force", "first", "", 2.0, 2.5, 2.0)]),
        ([9.0, OFF, GOOD, 0, 0, OFF, 0], [0.0] * 7, {}, [("position", "", "", 5.0, OFF, 2e-3)]),
        ([9.0, OFF, GOOD, 0, 0, 0, 0], [9, 9, 9, 0, 0, 0, 0], {}, []),  # a start that decays
        ([9.0, OFF, GOOD, GOOD, OFF, GOOD, 0], [9.0] * 7, {},  # the force never does
         [("position", "", "", 4.0, OFF, 2e-3), ("internal force", "first", "", 6.0, 9.0, 2.0)]),
        ([9.0, 9.0, 9.0, 9.0, 0, 0, 0], [0.0] * 7, {"events": [PUSHED]},
         [("position", "", "", 3.0, 9.0, 2e-3)]),
        ([0.0, 0, 0, OFF, OFF, OFF, 0], [0.0] * 7, {"events": [PUSHED], "recovery": 1.0}, []),
        ([0.0, 0, 0, OFF, OFF, OFF, OFF], [0.0] * 7, {"events": [PUSHED], "recovery": 1.0},
         [("position", "", "", 6.0, OFF, 2e-3)]),
        ([np.nan] + [0.0] * 6, [0.0] * 7, {}, []),
        ([9.0, 5, 4, 4, 3, OFF, OFF], [0.0] * 7, {}, [("position", "", "", 6.0, OFF, 2e-3)]),  # too slow
        ([9.0, 5, OFF, 4, 3, OFF, OFF], [0.0] * 7, {}, [("position", "", "", 3.0, 4.0, 2e-3)]),
    ],
)  # fmt: skip
def test_errors_count_from_the_end_of_the_starts_decay(position, force, options, expected, blocks):
    found = deviations(position, force, blocks=blocks, **options)
    assert str(found) == str([Breach(*entry) for entry in expected])


@pytest.mark.parametrize("cell", SCENARIOS)
def test_a_task_that_is_off_says_by_how_much_when_and_which_arm(cell):
    scenario = SCENARIOS[cell]().replace(
        duration=1.0, events=(), task=TaskLimits(force=1e-3, force_share=0.0)
    )
    result = cp.run(scenario, warn=False)
    assert result.simulation_sound
    assert result.task.state == "off"
    first = result.task.deviations[0]
    assert first.arm in result.scenario.cell.arms or first.cause in ("position", "orientation")
    assert 0.0 <= first.time <= 1.0
    assert first.value > first.allowed
    assert str(first) in result.verdict()


# ---------------------------------------------------------------- command line

pytestmark = pytest.mark.filterwarnings("ignore::coop_pin.base.errors.ScenarioWarning")

FAST = ["--duration", "0.5", "--events", "[]", "--no-replay", "--no-figures"]
WEAK = ["--cell.arms.left.torque-limits", "2", "--cell.arms.right.torque-limits", "2"]


def test_a_run_that_does_not_keep_its_task_ends_with_code_4_and_its_reasons(tmp_path, capsys):
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST, *WEAK]) == 4
    text = capsys.readouterr().out
    out = text.splitlines()
    deviations = cp.RunResult.load(tmp_path / "result.nc").task.deviations
    assert str(deviations[0]) in " ".join(text.split())
    assert len(deviations) > 1
    assert any("--verbose" in line for line in out)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert (metrics["simulation_sound"], metrics["task"]) == (True, "off")
    assert metrics["reasons"] == [str(breach) for breach in deviations]
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST, *WEAK, "--verbose"]) == 4
    out = " ".join(capsys.readouterr().out.split())
    assert all(str(breach) in out for breach in deviations)
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST, *WEAK, "--quiet"]) == 4
    out, err = capsys.readouterr()
    assert out == ""
    assert str(deviations[0]) in " ".join(err.split())


def test_the_command_can_end_a_run_at_its_first_breach_with_code_3(tmp_path):
    narrow = ["--trust.closure-error", "1e-20", "--stop-at-breach", "--quiet"]
    assert main(["run", "adept-paper", "--out", str(tmp_path), *FAST, *narrow]) == 3
    result = cp.RunResult.load(tmp_path / "result.nc")
    assert 0.0 <= result.end < 0.5
    assert json.loads((tmp_path / "metrics.json").read_text())["simulation_sound"] is False


# ---------------------------------------------------------------- samples written by hand


def found_by_hand(lower=(np.nan, np.nan), upper=(np.nan, np.nan), at_once=True, **given):
    """Breaches in six samples of one arm with two joints, 0.1 s apart, all zero but for what is given."""
    shapes = {"joint_position": (6, 1, 2), "jacobian_condition": (6, 1)}
    shapes |= {"closure_distance": (6, 1), "closure_angle": (6, 1)}
    names = (*WORK, "kinetic_energy", "potential_energy")
    samples = {name: np.zeros(shape) for name, shape in shapes.items()} | {
        name: np.zeros(6) for name in names
    }
    for name, values in given.items():
        samples[name].reshape(6, -1)[:, 0] = values
    samples["time"] = 0.1 * np.arange(6)
    thresholds = TrustThresholds(
        joint_slack=0.125,
        jacobian_condition=100.0,
        closure_error=1e-3,
        energy_floor=0.5,
        energy_share=0.1,
    )
    monitor = TrustMonitor(thresholds, [("arm", ("one", "two"))], np.array([lower]), np.array([upper]))
    if at_once:
        return monitor.breaches(samples)
    ticks = [{name: values[k : k + 1] for name, values in samples.items()} for k in range(6)]
    return tuple(breach for tick in ticks for breach in monitor.breaches(tick))


@pytest.mark.parametrize(
    ("positions", "found"),
    [
        ([0.0, 2.0625, 2.25, 2.5, -1.75, -1.0625], [("joint limit", "arm", "one", 0.2, -1.75, -1.0)]),
        ([0.0, 2.0625, 2.25, 2.5, -1.25, -1.0625], [("joint limit", "arm", "one", 0.2, 2.5, 2.0)]),
        ([0.0, 2.125, 2.125, -1.125, 0.0, 0.0], []),
    ],
)
def test_the_joint_limit_is_the_one_exceeded_most(positions, found):
    limits = {"lower": (-1.0, np.nan), "upper": (2.0, np.nan)}
    assert list(found_by_hand(joint_position=positions, **limits)) == found


def test_the_first_sample_beyond_and_the_worst_value_of_condition_and_closure_error():
    condition, opened = [1.0, 100.0, 101.0, 300.0, 200.0, 1.0], [0.0, 1e-3, 2e-3, 5e-3, 0.0, 0.0]
    assert found_by_hand(jacobian_condition=condition) == (
        ("jacobian condition", "arm", "", 0.2, 300.0, 100.0),
    )
    for name in ("closure_distance", "closure_angle"):
        assert found_by_hand(**{name: opened}) == (("closure error", "arm", "", 0.2, 5e-3, 1e-3),)


@pytest.mark.parametrize("blocks", [1, 2, 7])
def test_a_torque_cut_of_the_allowed_time_is_borne(blocks):
    """From the first to the last of n ticks are n - 1 periods; 3 times 0.1 exceeds 0.3 by rounding."""
    limits = {"torque_cut": 0.3, "blocks": blocks, "period": 0.1}
    assert deviations([0.0] * 7, [0.0] * 7, saturated=[1, 1, 1, 1, 0, 1, 0], **limits) == []
    (found,) = deviations([0.0] * 7, [0.0] * 7, saturated=[0, 1, 1, 1, 1, 1, 0], **limits)
    assert found[:3] == ("torque cut", "first", "a")
    assert_allclose(found[3:], (0.1, 0.4, 0.3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("at_once", [True, False])
def test_energy_may_be_off_by_a_share_of_all_work_done_and_of_all_lifting(at_once):
    """Works count by amount; allowed are 0.5, 0.7, 0.8, 1.1, 1.4 and 1.5 J; worst is the most beyond."""
    works = {"work_actuation": [10, 11, 12, 12, 12, 13], "work_friction": [-1, -2, -2, -2, -2, -2]}
    lifted, off = np.array([0, 0, 0, 3, 0, 0]), np.array([0.0, 0.69, 0.81, 1.0, 2.0, 2.05])
    kinetic = 5.0 + off - lifted + np.sum(list(works.values()), axis=0)
    found = found_by_hand(kinetic_energy=kinetic, potential_energy=lifted, at_once=at_once, **works)
    assert [breach[:3] for breach in found] == [("energy", "", "")] * (1 if at_once else 3)
    assert_allclose(found[0][3], 0.2, rtol=0, atol=1e-12)
    assert_allclose(found[0 if at_once else 1][4:], (2.0, 1.4), rtol=0, atol=1e-12)


@pytest.mark.parametrize("at_once", [True, False])
def test_energy_that_a_changed_payload_brings_is_explained(at_once):
    """It counts once as work, and not as lifting."""
    works = {"work_payload_change": [0, 0, 7, 7, 7, 7], "work_external": [0, 2, 2, 2, 2, 2]}
    kinetic = 5.0 + np.sum(list(works.values()), axis=0)
    assert found_by_hand(kinetic_energy=kinetic, at_once=at_once, **works) == ()
