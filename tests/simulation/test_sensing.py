"""What a controller measures: sensors and their errors, holding torques, and the random sources."""

import contextlib
import itertools

import numpy as np
import pinocchio as pin
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose, assert_array_equal

import coop_pin as cp
from coop_pin.base import errors
from coop_pin.base.spatial import internal_wrenches, make_pose
from coop_pin.control import ArmMeasurement, CellCommand
from coop_pin.control.bounds import force_gain_bound
from coop_pin.figures.run_figures import internal_force_figure
from coop_pin.simulation.build_controller import build_controller
from coop_pin.simulation.devices.drives import Applied
from coop_pin.simulation.devices.encoder import Encoders
from coop_pin.simulation.devices.signals import SensorSignals, generator
from coop_pin.simulation.devices.wrist import Wrist
from coop_pin.simulation.simulation import Simulation
from coop_pin.viz.live.live_scene import LiveScene, initial_scene
from coop_pin.viz.report import scenario_facts

T = 0.0125
CLOCK = cp.Clock(rate_hz=80.0)
COUNTS = [pytest.param(3000, id="short"), pytest.param(100_000, id="full", marks=pytest.mark.slow)]
ANYTHING = {
    "sensors.encoder": {"resolution": 1e-4, "noise": 1e-5, "offset": 1e-4},
    "sensors.velocity.kind": "observer",
    "sensors.wrist": {"noise": {"force": 1.0, "moment": 0.1}, "delay": 1, "rate_hz": 40.0},
}


def scenario_of(name, changes=None, **fields):
    scenario = SCENARIOS[name]().replace(events=(), duration=0.5, clock={"rate_hz": 80.0}, **fields)
    return scenario.override(changes or {})


def started(scenario, ticks=1):
    """A simulation after some ticks."""
    simulation = Simulation(scenario, build_controller(scenario))
    for _ in range(ticks):
        simulation.tick()
    return simulation


def measured(simulation, count):
    """Measurements of all arms at ``count`` more ticks during which the plant stays as it is."""
    signals = itertools.islice(simulation.signals(simulation.ticks_done), count)
    return [seen_by(simulation, of_tick) for of_tick in signals]


def seen_by(simulation, signals):
    """Measurements of all arms at a tick, of a plant that stays as it is."""
    return simulation.sensing.measure(simulation.time, simulation.plant, at_rest(simulation), signals.sensors)


def first_of(simulation):
    """The first measurements, and the signals of their tick."""
    plant, signals = simulation.plant, next(simulation.signals())
    references = simulation.references(0.0)
    return simulation.sensing.start(plant.q, plant.v, references, signals.sensors), signals


def at_rest(simulation):
    """No torque cut, and none reported."""
    return Applied.at_rest([len(place.drive) for place in simulation.slots])


def of_arm(measurements, arm, field):
    return np.array([getattr(tick[arm], field) for tick in measurements])


# ---------------------------------------------------------------- encoders


def encoders(rng_name="test", **fields):
    sensors, joints = cp.Sensors(**fields), 6
    deviation = np.array(sensors.encoder.noise)
    return Encoders.of_sensors(sensors, T, joints, "sensors"), deviation, generator(0, rng_name)


def readings(sensor, count, speed=0.0):
    (encoders, deviation, rng), v, state, pairs = sensor, np.full(6, speed), None, []
    for k in range(count):
        q, noise = 0.3 + v * T * k, deviation * rng.standard_normal(6)
        pair, state = encoders.step(state or encoders.start(q, noise), q, v, noise)
        pairs.append(pair)
    return tuple(np.array(values) for values in zip(*pairs, strict=True))


@pytest.mark.parametrize("count", COUNTS)
def test_encoder_noise_and_offset_are_as_stated(count):
    q, v = readings(encoders(encoder={"noise": 2e-4, "offset": (0.0, 0.1, 0.0, 0.0, 0.0, -0.2)}), count)
    error = q - 0.3 - np.array((0.0, 0.1, 0.0, 0.0, 0.0, -0.2))
    assert error.std() == pytest.approx(2e-4, rel=0.05)
    assert abs(error.mean()) < 5 * 2e-4 / np.sqrt(error.size)
    correlation = np.corrcoef(error.T) - np.eye(6)
    assert np.abs(correlation).max() < 6 / np.sqrt(count)
    assert abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 5 / np.sqrt(count)
    assert_allclose(v, 0.0)


@pytest.mark.parametrize("count", COUNTS)
def test_an_encoder_counts_in_steps_with_the_error_of_a_uniform_distribution(count):
    q, v = readings(encoders(encoder={"resolution": 1e-3}), count, speed=0.123456)
    assert_allclose(q / 1e-3, np.round(q / 1e-3), atol=1e-6)
    error = q - 0.3 - 0.123456 * T * np.arange(count)[:, None]
    assert np.abs(error).max() <= 0.5e-3 * (1 + 1e-9)
    assert error.std() == pytest.approx(1e-3 / np.sqrt(12.0), rel=0.05)
    assert_allclose(v, 0.123456)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", ["difference", "observer"])
def test_velocities_from_encoders_have_the_noise_of_their_filters(kind, count):
    """Variances of the impulse responses, summed in closed form and by the filter itself."""
    field, p = {"difference": "cutoff_hz", "observer": "bandwidth_hz"}[kind], np.exp(-2 * np.pi * 5.0 * T)
    velocity = {"kind": kind, field: 5.0}
    _, v = readings(encoders(velocity=velocity, encoder={"noise": 1e-4}), count)
    if kind == "difference":
        gain = (1 - p) * np.sqrt(2 / (1 + p))
    else:  # alpha-beta filter, with double pole p: Kalata (1984)
        alpha, beta = 1 - p**2, (1 - p) ** 2
        gain = np.sqrt(2 * beta**2 / (alpha * (4 - 2 * alpha - beta)))
    assert v[100:].std() == pytest.approx(1e-4 * gain / T, rel=0.05)


@pytest.mark.parametrize("kind", ["difference", "observer"])
def test_velocities_from_encoders_start_at_rest_and_reach_a_constant_speed(kind):
    sensor = encoders(velocity={"kind": kind})
    _, v = readings(sensor, 60, speed=0.4)
    assert_allclose(v[0], 0.0)
    assert np.all(np.diff(v[:4, 0]) > 0.0)
    assert_allclose(v[-1], 0.4, rtol=1e-9)


# ---------------------------------------------------------------- wrist sensor


def wrist_readings(sensor, count, F_P, R_WP=None, **grasp):
    """Ages and values at successive ticks of an arm that sees the payload turned by R_WP."""
    changes = {"arm_sensors.left.wrist": sensor.model_dump(), "cell.grasps.left": grasp}
    signals = SensorSignals(scenario_of("spatial", changes), [6, 6]).draw(count).arms[0]
    wrist, wrenches = Wrist.at_rest(sensor.delay), []
    for error, arrived in zip(signals.wrist_error, signals.wrist_arrived, strict=True):
        wrist = wrist.step(F_P, error, np.eye(3) if R_WP is None else R_WP, arrived)
        wrenches.append(wrist.wrench)
    return signals.wrist_age, np.array(wrenches)


@pytest.mark.parametrize("count", COUNTS)
def test_wrist_errors_are_as_stated_in_sensor_axes_about_the_tip(count):
    sensor = cp.sensors.WristSensor(
        noise={"force": (1.0, 2.0, 3.0), "moment": 0.1},
        offset={"force": (5.0, 0.0, 0.0), "moment": (0.0, 0.0, 2.0)},
        drift={"force": 0.01, "moment": (0.0, -0.02, 0.0)},
    )
    grasp, R_WP = {"xyz": (0.1, -0.2, 0.3), "rpy": (0.4, -0.9, 1.3)}, make_pose(rpy=(0.2, 0.5, -0.7))[:3, :3]
    X_PE = make_pose(*grasp.values())
    F_P = np.array((10.0, -5.0, 3.0, 0.3, 0.2, -0.4))
    age, wrenches = wrist_readings(sensor, count, F_P, R_WP, **grasp)
    assert_allclose(age, 0.0)
    X_WE = pin.SE3(R_WP, np.zeros(3)) * pin.SE3(X_PE)  # a second formulation: Pinocchio's forces
    in_sensor = np.array([X_WE.actInv(pin.Force(wrench)).vector for wrench in wrenches])
    error = in_sensor - pin.SE3(X_PE).actInv(pin.Force(F_P)).vector
    time = T * np.arange(count)
    drift = np.outer(time, (0.01, 0.01, 0.01, 0.0, -0.02, 0.0))
    error = error - drift - np.array((5.0, 0.0, 0.0, 0.0, 0.0, 2.0))
    sigma = np.array((1.0, 2.0, 3.0, 0.1, 0.1, 0.1))
    assert_allclose(error.std(axis=0), sigma, rtol=0.05)
    assert np.all(np.abs(error.mean(axis=0)) < 5 * sigma / np.sqrt(count))
    assert np.abs(np.corrcoef(error.T) - np.eye(6)).max() < 6 / np.sqrt(count)


def test_ages_of_a_delayed_slow_sensor_that_is_lost_and_returns():
    """Samples at ticks 0, 4, 8, ...; those of [0.1 s, 0.2 s), ticks 8 and 12, are lost; two ticks late."""
    sensor = cp.sensors.WristSensor(delay=2, rate_hz=20.0, lost=[(0.1, 0.2)], noise={"force": 1.0})
    age, wrenches = wrist_readings(sensor, 24, np.ones(6))
    expected = [np.inf] * 2 + [2, 3, 4, 5] + list(range(2, 14)) + [2, 3, 4, 5] + [2, 3]
    assert age.tolist() == expected
    assert_allclose(wrenches[:2], 0.0)
    held = [np.array_equal(wrenches[k], wrenches[k - 1]) for k in range(3, 24)]
    fresh = [age[k] < age[k - 1] + 1 for k in range(3, 24)]
    assert held == [not new for new in fresh]
    whole = cp.sensors.WristSensor(delay=2, rate_hz=20.0, noise={"force": 1.0})
    assert_allclose(wrenches[-1], wrist_readings(whole, 24, np.ones(6))[1][-1])


def test_a_sensor_that_is_stuck_repeats_its_sample_as_a_new_one():
    """Samples at ticks 0, 4, 8, ...; that of 8 is the first at or after 0.1 s, and two ticks late."""
    sensor = cp.sensors.WristSensor(delay=2, rate_hz=20.0, stuck_at=0.1, noise={"force": 1.0})
    whole = sensor.replace(stuck_at=None)
    age, wrenches = wrist_readings(sensor, 24, np.ones(6))
    expected, free = wrist_readings(whole, 24, np.ones(6))
    assert age.tolist() == expected.tolist()
    assert_array_equal(wrenches[:10], free[:10])
    assert_array_equal(wrenches[10:], np.tile(free[9], (14, 1)))
    assert not np.array_equal(free[10], free[9])


@pytest.mark.parametrize("path", ["late", "low-pass"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_ideal_wrist_sensors_report_the_true_wrenches_and_their_internal_part(name, path):
    changes = {"controller.force_path": {"kind": path}}
    ideal = started(scenario_of(name, changes), 6)
    sensed = started(scenario_of(name, changes | {"sensors.wrist": {}}), 6)
    assert_allclose(ideal.plant.q, sensed.plant.q, rtol=0, atol=1e-12)
    rows, truth = sensed.scenario.cell.task_rows, sensed.plant.interaction_wrenches()
    (seen,), (other,) = measured(sensed, 1), measured(ideal, 1)
    scale = np.abs(truth).max()
    for arm, F in zip(seen, truth, strict=True):
        assert_allclose(arm.interaction_wrench, rows.select(F), rtol=0, atol=1e-9 * scale)
        assert arm.interaction_wrench_age == arm.internal_wrench_age == 0.0
    for arm, expected in zip(seen, other, strict=True):
        assert_allclose(arm.internal_wrench, expected.internal_wrench, rtol=0, atol=1e-9 * scale)


@pytest.mark.parametrize("name", SCENARIOS)
def test_at_rest_each_wrist_carries_its_share_of_the_weight(name):
    simulation = started(scenario_of(name, {"cell.gravity": [0.0, -3.0, -9.81], "sensors.wrist": {}}), 0)
    cell = simulation.scenario.cell
    first, _ = first_of(simulation)
    for share, seen in zip(cell.shares, first, strict=True):
        weight = share * cell.payload.mass * np.array([*cell.gravity, 0.0, 0.0, 0.0])
        assert_allclose(seen.interaction_wrench, cell.task_rows.select(weight), rtol=0, atol=1e-10)
        assert (seen.interaction_wrench_age, seen.internal_wrench_age) == (0.0, np.inf)


@pytest.mark.parametrize("count", [1000, pytest.param(20_000, id="full", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SCENARIOS)
def test_noise_enters_before_the_split_so_that_internal_wrenches_sum_to_zero(name, count):
    """f_i = (1 - c_i) F_i - c_i F_j has the standard deviation sqrt((1 - c_i)^2 + c_i^2) of the wrists'."""
    changes = {"controller.force_path": {"kind": "late"}, "sensors.wrist": {"noise": {"force": 1.0}}}
    simulation = started(scenario_of(name, changes))
    seen = measured(simulation, count)
    f = np.stack([of_arm(seen, arm, "internal_wrench") for arm in range(2)])
    assert np.abs(f.sum(axis=0)).max() < 1e-9
    linear = 2 if name == "planar" else 3
    noise = (f - f.mean(axis=1, keepdims=True))[..., :linear]
    c = simulation.scenario.cell.shares
    expected = np.sqrt((1.0 - c) ** 2 + c**2)
    assert_allclose(noise.std(axis=(1, 2)), expected, rtol=0.05)


@pytest.mark.parametrize("name", SCENARIOS)
def test_wrenches_are_turned_by_the_arms_own_wrong_kinematics(name):
    """F_i about P in world axes, as X_WP' = X_WP X_PE C X_EP sees force and moment of the sensor at E."""
    wrong = {"cell.arms.left.calibration_error.tip": {"xyz": (2e-3, 0.0, 0.0), "rpy": (0.0, 0.0, 0.05)}}
    simulation = started(scenario_of(name, wrong | {"sensors.wrist": {}}), 3)
    cell, plant = simulation.scenario.cell, simulation.plant
    (left, right) = measured(simulation, 1)[0]
    X_WP, F = plant.chain.payload_pose(plant.q), plant.interaction_wrenches()
    assert_allclose(right.interaction_wrench, cell.task_rows.select(F[1]), rtol=0, atol=1e-8)
    X_PE = cell.grasps["left"].matrix
    C = cell.arms["left"].calibration_error.tip.matrix
    at_P = F[0].copy()
    about_W = np.concatenate((at_P[:3], at_P[3:] + np.cross(X_WP[:3, 3], at_P[:3])))
    in_sensor = pin.SE3(X_WP @ X_PE).actInv(pin.Force(about_W))
    seen_W = pin.SE3(X_WP @ X_PE @ C).act(in_sensor)
    p = (X_WP @ X_PE @ C @ np.linalg.inv(X_PE))[:3, 3]
    expected = np.concatenate((seen_W.linear, seen_W.angular - np.cross(p, seen_W.linear)))
    assert_allclose(left.interaction_wrench, cell.task_rows.select(expected), rtol=0, atol=1e-6)
    assert np.abs(left.interaction_wrench - cell.task_rows.select(F[0])).max() > 1e-3


# ---------------------------------------------------------------- transport of the internal wrench


class Listener(cp.CellController):
    """Hands everything on and keeps what it saw at every tick."""

    def __init__(self, controller):
        self.controller, self.seen = controller, []

    def init(self, measurements, references):
        return self.controller.init(measurements, references)

    def step(self, measurements, references, state):
        self.seen.append(list(measurements))
        return self.controller.step(measurements, references, state)


def heard(scenario, ticks):
    spy = Listener(build_controller(scenario))
    simulation = Simulation(scenario, spy)
    for _ in range(ticks):
        simulation.tick()
    return spy.seen


@pytest.mark.parametrize("wrist", [None, {}], ids=["ideal", "wrists"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_the_force_path_delays_by_whole_ticks(name, wrist):
    changes = {"controller.gains.force_gain": 0.0} | ({"sensors.wrist": wrist} if wrist is not None else {})
    late = scenario_of(name, changes | {"controller.force_path": {"kind": "late"}})
    prompt = heard(late, 9)
    for kind in ({"kind": "late", "delay": 3}, {"kind": "low-pass", "pole": 0.6, "delay": 3}):
        delayed = heard(late.override({"controller.force_path": kind}), 9)
        assert of_arm(delayed, 0, "internal_wrench_age").tolist() == [np.inf] * 4 + [3.0] * 5
        p, f_m = kind.get("pole", 0.0), prompt[0][1].internal_wrench
        for k in range(9):
            if k > 3:
                f_m = p * f_m + (1.0 - p) * prompt[k - 3][1].internal_wrench
            assert_allclose(delayed[k][1].internal_wrench, f_m, rtol=0, atol=1e-12 * np.abs(f_m).max())


@pytest.mark.parametrize("name", SCENARIOS)
def test_without_one_wrist_no_internal_wrench_is_fresh(name):
    """The right one has no samples in [0.05 s, 0.1 s), ticks 4 to 7; the left one keeps its own."""
    changes = {
        "controller.force_path": {"kind": "low-pass", "pole": 0.5},
        "controller.gains.force_gain": 0.0,
        "sensors.wrist": {},
        "arm_sensors": {"right": {"wrist": {"lost": [(0.05, 0.1)]}}},
    }
    seen = heard(scenario_of(name, changes), 11)
    ages = [float("inf"), 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 0.0]
    for arm in range(2):
        assert of_arm(seen, arm, "internal_wrench_age").tolist() == ages
    assert of_arm(seen, 0, "interaction_wrench_age").tolist() == [0.0] * 11
    assert of_arm(seen, 1, "interaction_wrench_age").tolist() == [0.0, *ages[1:]]
    held = of_arm(seen, 0, "internal_wrench")[3:8]
    assert_allclose(held, held[:1].repeat(5, axis=0), rtol=0, atol=0)


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("delay", [1, 3])
def test_the_bound_of_delayed_force_feedback_is_that_of_its_roots(pole, delay):
    def radius(gain):
        polynomial = np.zeros(delay + 2)
        polynomial[:2], polynomial[-1] = (1.0, -pole), polynomial[-1] + gain * (1.0 - pole)
        return np.abs(np.roots(polynomial)).max()

    bound = force_gain_bound(pole, delay)
    assert radius(0.99 * bound) < 1.0 < radius(1.01 * bound)


@pytest.mark.parametrize("wrist", [None, {"delay": 3, "rate_hz": 40.0}], ids=["path", "slow wrists"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_delayed_force_feedback_is_unstable_from_its_bound_on(name, wrist):
    """Three ticks of delay are three samples of the control rate, and one of half that rate."""
    path = {"kind": "low-pass", "pole": 0.5, "delay": 3 if wrist is None else 0}
    bound = force_gain_bound(0.5, 3 if wrist is None else 1)
    changes = {"controller.force_path": path, "controller.gains.sign_gain": 0.0}
    changes |= {} if wrist is None else {"sensors.wrist": wrist}
    field = "controller.gains.force_gain"
    for factor in (0.9, 1.1):
        gain = changes | {field: factor * bound}
        with pytest.raises(errors.FieldError) if factor > 1.0 else contextlib.nullcontext() as refused:
            scenario_of(name, gain)
        if refused is not None:
            assert refused.value.path == field
        simulation = started(scenario_of(name, gain, beyond_bound=True).replace(duration=2.0), 120)
        steps = np.abs(np.diff(simulation.result().data.internal_axial.values[:, 0]))
        early, late = steps[5:30].max(), steps[-25:].max()
        assert late < 0.2 * early if factor < 1.0 else late > 4.0 * early


# ---------------------------------------------------------------- sources, seeds, results


@pytest.mark.parametrize("name", SCENARIOS)
def test_adding_one_source_does_not_change_another(name):
    noisy, joints = {"sensors.encoder.noise": 1e-4}, {}
    variants = {
        "alone": noisy,
        "with wrist": noisy | {"sensors.wrist": {"noise": {"force": 1.0}}},
        "with other arm": noisy | {"arm_sensors": {"right": {"encoder": {"noise": 1e-3}}}},
        "other seed": noisy | {"seed": 1},
    }
    for key, changes in variants.items():
        joints[key] = of_arm(measured(started(scenario_of(name, changes), 1), 3), 0, "q")
        if key == "alone":
            again = of_arm(measured(started(scenario_of(name, changes), 1), 3), 0, "q")
    draws = {key: np.diff(q, axis=0) for key, q in joints.items()}
    assert np.array_equal(joints["alone"], again)
    assert_allclose(draws["with wrist"], draws["alone"], rtol=0, atol=1e-14)
    assert_allclose(draws["with other arm"], draws["alone"], rtol=0, atol=1e-14)
    assert np.abs(draws["other seed"] - draws["alone"]).max() > 1e-5


@pytest.mark.parametrize("name", cp.scenario_names())
def test_a_wrist_sensor_that_no_law_uses_and_a_seed_leave_every_bit(name):
    scenario = cp.Scenario.load(name, {"duration": 0.05, "events": (), "sensors.wrist": None})
    before = started(scenario, 4).result().data
    wrist = {"sensors.wrist": {"noise": {"force": 1.0}}, "seed": 5}
    after = started(scenario.override(wrist), 4).result().data
    fed_back = scenario.controller.force_path.kind != "none"
    assert set(after.data_vars) > set(before.data_vars)
    for variable in [] if fed_back else before.data_vars:
        np.testing.assert_array_equal(after[variable].values, before[variable].values, strict=True)
    assert np.isfinite(after.measured_wrench.values[-1, :, after.wrench_is_determined.values]).any()


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_noisy_run_is_the_same_for_the_same_seed_and_saves_true_and_measured_signals(name, tmp_path):
    scenario = scenario_of(name, ANYTHING | {"controller.force_path": {"kind": "late"}}, beyond_bound=True)
    first, again, other = (started(scenario.replace(seed=seed), 9).result() for seed in (3, 3, 4))
    assert first.data.identical(again.data)
    assert not np.array_equal(first.data.torque, other.data.torque)
    first.save(tmp_path / "result.nc")
    assert cp.RunResult.load(tmp_path / "result.nc").data.identical(first.data)
    data, rows = first.data, list(scenario.cell.task_rows.indices)
    error = (data.measured_drive_position - data.drive_position).values
    assert 2e-5 < np.abs(error).max() < 2.1e-4
    assert np.abs((data.measured_drive_velocity - data.drive_velocity).values).max() > 1e-6
    assert np.isfinite(data.measured_wrench.values[..., rows]).all()
    assert data.measured_wrench_age.values[:5, 0].tolist() == [np.inf, 1.0, 2.0, 1.0, 2.0]
    assert data.measured_internal_wrench_age.values[:5].tolist() == [np.inf] * 3 + [1.0, 2.0]
    wrench = data.measured_internal_wrench.values
    assert np.abs(np.nansum(wrench, axis=1)).max() < 1e-2 * np.nanmax(np.abs(wrench))
    axial = np.einsum("nmi,nmi->nm", np.nan_to_num(wrench[..., :3]), data.axial_direction.values)
    assert_allclose(data.measured_internal_axial, axial, rtol=1e-9, atol=1e-9)
    assert 1e-5 < np.abs(data.seen_pose_error.values).max() < 1e-3


def test_a_report_states_sensors_and_calibration_that_are_not_ideal():
    changes = ANYTHING | {"cell.arms.left.calibration_error.base.xyz": (0.0, 0.001, 0.0)}
    facts = {}
    for key, scenario in (("plain", scenario_of("planar")), ("wrong", scenario_of("planar", changes))):
        facts[key] = dict(scenario_facts(started(scenario).result()))
    assert set(facts["wrong"]) - set(facts["plain"]) == {
        "sensors of left",
        "sensors of right",
        "calibration of left",
    }
    assert "0.001" in facts["wrong"]["calibration of left"]
    assert "observer" in facts["wrong"]["sensors of right"]


def test_measurements_of_every_sensor_are_floats_and_frozen_arrays():
    for tick in heard(scenario_of("spatial", ANYTHING | {"controller.force_path": {"kind": "late"}}), 4):
        for value in (value for seen in tick for value in seen):
            if isinstance(value, np.ndarray):
                assert not value.flags.writeable
                assert value.base is None or not value.base.flags.writeable
            else:
                assert value is None or type(value) is float
    assert ArmMeasurement._fields[-5:-3] == ("messages", "sent")  # numbers of shared joints come after them


def test_only_signals_that_differ_from_the_truth_are_recorded():
    plain = set(started(scenario_of("planar")).result().data.data_vars)
    added = {
        "sensors.encoder.noise": {"drive_position", "measured_drive_position", "measured_drive_velocity"},
        "cell.arms.left.calibration_error.joint_offset": {"seen_pose_error"},
    }
    added["sensors.encoder.noise"] |= {"seen_pose_error"}
    for field, names in added.items():
        data = started(scenario_of("planar", {field: 1e-4})).result().data
        assert set(data.data_vars) - plain == names
    assert np.abs(data.seen_pose_error.values[:, 0]).max() > 1e-5
    assert np.abs(data.seen_pose_error.values[:, 1]).max() < 1e-8


@pytest.mark.parametrize("name", SCENARIOS)
def test_figures_and_the_live_view_show_the_measured_internal_force_where_it_differs(name):
    changes = {"controller.force_path": {"kind": "late"}}
    for wrist in (None, {"noise": {"force": 3.0}}):
        simulation = started(scenario_of(name, changes | ({"sensors.wrist": wrist} if wrist else {})), 4)
        result, snapshot = simulation.result(), simulation.snapshot()
        panel = internal_force_figure(result).axes[0]
        drawn = {line.get_label(): line.get_ydata() for line in panel.lines}
        assert ("measured" in drawn) == (wrist is not None)
        scene = LiveScene(initial_scene(simulation.scenario))
        frame = np.frombuffer(scene.frame(snapshot), dtype="<f4")
        curves = zip(scene.curves, frame[-len(scene.curves) :], strict=True)
        shown = [value for curve, value in curves if (curve.plot, curve.role) == ("axial", "measured")]
        if wrist is None:
            assert snapshot.measured_internal_wrench is None
            assert shown == []
            continue
        assert_allclose(drawn["measured"], result.data.measured_internal_axial.values[:, 0], rtol=0)
        assert np.abs(drawn["measured"] - drawn["actual"])[1:].max() > 0.1
        assert_allclose(shown, result.data.measured_internal_axial.values[-1], rtol=1e-6)


def test_fields_below_a_table_that_the_scenario_lacks_are_set_one_by_one():
    wrist = {"sensors.wrist.delay": 1, "sensors.wrist.noise.force": 2.0, "sensors.wrist.noise.moment": 0.1}
    arms = {f"arm_sensors.{arm}.encoder.noise": 1e-5 for arm in ("left", "right")}
    sensors = scenario_of("planar", wrist | arms | {"arm_sensors.left.encoder.offset": 0.1})
    assert (sensors.sensors.wrist.delay, sensors.sensors.wrist.noise.force) == (1, 2.0)
    assert sensors.sensors.wrist.noise.moment == 0.1
    assert [sensors.sensors_of(arm).encoder.noise for arm in ("left", "right")] == [1e-5, 1e-5]
    assert sensors.sensors_of("left").encoder.offset == 0.1
    with pytest.raises(errors.UnknownFieldError):
        scenario_of("planar", {"sensors.wrist.delay": 1, "sensors.wrist.noize.force": 2.0})


# ---------------------------------------------------------------- refusals

BAD = {
    "sensors.encoder.noise": (-1.0, "sensors.encoder.noise"),
    "sensors.encoder.resolution": ((1e-4, -1e-4, 0.0), "sensors.encoder.resolution"),
    "sensors.wrist.noise.force": (-1.0, "sensors.wrist.noise.force"),
    "sensors.wrist.offset.force": ((1.0, 2.0), "sensors.wrist.offset.force"),
    "sensors.wrist.delay": (40, "sensors.wrist.delay"),
    "arm_sensors.left.wrist.delay": (40, "arm_sensors.left.wrist.delay"),
    "sensors.wrist.rate_hz": (30.0, "sensors.wrist.rate_hz"),
    "arm_sensors.lefft.encoder.noise": (1e-4, "arm_sensors.lefft"),
    "sensors.wrist.lost": ([(0.1, 0.2), (0.4, 0.3)], "sensors.wrist.lost.1"),
    "arm_sensors.right.wrist.lost": ([(0.1, 0.6)], "arm_sensors.right.wrist.lost.0"),
    "controller.force_path": ({"kind": "late", "delay": 40}, "controller.force_path.delay"),
    "cell.arms.left.calibration_error.joint_offset": ((1e-3, 1e-3), "cell.arms.left"),
}


@pytest.mark.parametrize("field", BAD)
def test_bad_sensors_are_refused_at_their_field(field):
    value, path = BAD[field]
    with pytest.raises(errors.FieldError) as refused:
        scenario_of("planar", {field: value})
    assert refused.value.path == path


@pytest.mark.parametrize("rate_hz", [200.0, 79.0, 53.4])
def test_a_refused_rate_names_rates_that_divide(rate_hz):
    with pytest.raises(errors.FieldError) as refused:
        scenario_of("planar", {"sensors.wrist.rate_hz": rate_hz})
    allowed = [float(word) for word in str(refused.value).partition("example ")[2].split(" or ")]
    for rate in allowed:
        scenario_of("planar", {"sensors.wrist.rate_hz": rate})


def test_values_for_each_joint_must_be_as_many_as_the_joints():
    for field in ("sensors.encoder.offset", "arm_sensors.left.holding_torque_error"):
        scenario = scenario_of("planar", {field: (0.1, 0.1)})
        with pytest.raises(errors.FieldError) as refused:
            Simulation(scenario, build_controller(scenario))
        assert refused.value.path == field


# ---------------------------------------------------------------- holding torques and generators


def test_holding_torques_have_the_stated_error():
    plain = scenario_of("spatial")
    wrong = plain.override({"sensors.holding_torque_error": (0.1, 0.0, -0.1, 0.0, 0.0, 0.5)})
    exact, seen = (heard(scenario, 1)[0][0].holding_torque for scenario in (plain, wrong))
    assert_allclose(seen, exact * np.array((1.1, 1.0, 0.9, 1.0, 1.0, 1.5)), rtol=1e-14)


@pytest.mark.parametrize("robot", [None, {"mass_error": 0.0}, {"mass_error": -0.2}])
@pytest.mark.parametrize("name", SCENARIOS)
def test_holding_torques_keep_the_cell_at_rest_without_internal_wrench(name, robot):
    """As commands: the robot's own gravity compensation acts as well."""
    actuators = {"gravity_compensation": robot, "lag": 0.02}
    scenario = SCENARIOS[name]().override({"cell.gravity": [0.0, -3.0, -9.81], "actuators": actuators})
    simulation = Simulation(scenario, build_controller(scenario))
    plant, rows = simulation.plant, scenario.cell.task_rows
    first, signals = first_of(simulation)
    torques = [measurement.holding_torque for measurement in first]
    assert max(np.abs(torque).max() for torque in torques) > 1.0
    plant.drive(simulation.actuation.apply(0.0, CellCommand(torques, None), signals.missed).torques)
    acceleration = plant.chain.mechanism.solver.acceleration(plant.q, plant.v, plant.generalised_force())
    assert np.abs(acceleration).max() < 1e-10
    internal = internal_wrenches(plant.interaction_wrenches(), scenario.cell.shares)
    assert np.abs([rows.select(wrench) for wrench in internal]).max() < 1e-10
    simulation.tick()
    later = seen_by(simulation, signals)
    assert [measurement.holding_torque for measurement in later] == [None] * len(first)


def test_a_source_draws_the_same_whatever_other_sources_there_are():
    draws = {(seed, name): tuple(generator(seed, name).normal(size=4)) for seed in (0, 1) for name in "ab"}
    assert len(set(draws.values())) == 4
    assert draws[0, "a"] == tuple(generator(0, "a").normal(size=4))


@pytest.mark.parametrize("name", SCENARIOS)
def test_signals_are_the_same_drawn_tick_by_tick_and_at_once(name):
    """A single run draws them in growing blocks, a batch all at once."""
    wrist = {"noise": {"force": 1.0}, "rate_hz": 20.0, "delay": 3, "lost": [[0.1, 0.3], [0.2, 0.25]]}
    changes = ANYTHING | {"arm_sensors.right.wrist": wrist, "controller.force_path": {"kind": "late"}}
    scenario, count = scenario_of(name, changes), 700
    joints = [3, 3] if name == "planar" else [6, 6]
    whole, rows = SensorSignals(scenario, joints).draw(count), Simulation(scenario).signals()
    for k in range(count):
        row = next(rows).sensors
        assert (row.age, row.arrived) == (whole.age[k], whole.arrived[k])
        for arm, arms in zip(row.arms, whole.arms, strict=True):
            assert all(np.array_equal(part, parts[k]) for part, parts in zip(arm, arms, strict=True))
    oldest = np.maximum(*(np.where(np.isinf(arm.wrist_age), 1e9, arm.wrist_age) for arm in whole.arms))
    later = np.isfinite(whole.age)
    assert later.sum() > 600
    assert (whole.age[later] >= oldest[later]).all()
