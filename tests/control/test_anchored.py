"""The payload-space law on the plant: its formulas for bias, weight, delay and noise, and its scenarios."""

import numpy as np
import pytest
from cells import ANCHORED, CATALOGUE_CELLS, SCENARIOS
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import coop_pin as cp
from coop_pin.base.errors import DivergedError
from coop_pin.control import anchor_gain_bound
from coop_pin.description.scenario import Scenario

NOTHING_MEASURED = {"controller.force_path": {"kind": "none"}}


def at_rest(name, duration, changes=None):
    """A test cell, or one of the catalogue, with the anchored law that stays where it starts."""
    scenario = Scenario.load(name) if name in CATALOGUE_CELLS else SCENARIOS[name]()
    controller = ANCHORED.get(name, scenario.controller)
    scenario = scenario.replace(controller=controller, events=(), duration=duration)
    still = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}, "clock.steps_per_tick": 1}
    return scenario.override(still | (changes or {}))


def biased(bias):
    return {"cell.arms.left.calibration_error.tip.xyz": bias}


def rates(scenario):
    """gamma, the force per metre and second k_I K of the positions, and beta = g / T."""
    gains = scenario.controller.gains
    k_I = np.ravel(gains.sign_gain)[0] / scenario.controller.switching.width
    return gains.pose_gain, k_I * gains.sliding_gain[0], gains.anchor_gain / scenario.clock.period


def world_bias(result, bias):
    """The bias of the first arm's tip in world axes, m, shape (3,)."""
    R_WP = Rotation.from_quat(result.data.payload_quaternion.values[-1]).as_matrix()
    grasp, *_ = result.scenario.cell.grasps.values()
    return R_WP @ grasp.matrix[:3, :3] @ bias


def force_error(result, arm=0):
    """Internal-force error of an arm over time, N, shape (n, 3)."""
    error = result.data.internal_wrench - result.data.desired_internal_wrench
    return np.nan_to_num(error.isel(arm=arm).values[:, :3])


def largest(values):
    return float(np.linalg.norm(values, axis=-1).max())


# ------------------------------------------------------------ scenarios


@pytest.fixture(scope="module")
def papers_experiment():
    return cp.run("adept-anchored", warn=False, engine="compiled")


def test_the_papers_experiment_keeps_its_internal_force(papers_experiment):
    result = papers_experiment
    assert result.position_rms(window=(4.0, 10.0)) <= 0.03e-3
    assert result.internal_force(window=(4.0, 10.0)).force_rms_error <= 0.01
    time = result.data.time.values
    assert largest(force_error(result)[time >= 11.7]) < 0.02
    assert result.settling_time() < 2.5
    assert result.metrics()["resettling_time_s"] < 2.5


def test_both_experiments_differ_by_the_controller_alone():
    paper, anchored = (Scenario.load(name).model_dump() for name in ("adept-paper", "adept-anchored"))
    assert {key for key in paper if paper[key] != anchored[key]} == {"name", "summary", "controller"}
    assert paper["controller"]["kind"] == "sliding-mode"


# ------------------------------------------------------------ bias


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_kinematic_bias_leaves_a_constant_internal_force(name):
    """f = c_i k_I K gamma (b_i - bbar) / beta, and nothing grows; unequal shares in the spatial cell."""
    bias = [1e-3, 0.0 if name == "planar" else 0.5e-3, 0.0]
    result = cp.run(
        at_rest(name, 12.0 if name == "planar" else 5.0, biased(bias)), warn=False, engine="compiled"
    )
    gamma, stiffness, beta = rates(result.scenario)
    shares = np.prod(result.scenario.cell.shares)
    expected = shares * stiffness * gamma * world_bias(result, bias) / beta
    error = force_error(result)
    assert_allclose(error[-1], expected, atol=0.01 * np.linalg.norm(expected))
    assert_allclose(error[-50], error[-1], atol=1e-3 * np.linalg.norm(expected))


def held_with_a_bias(name, duration, changes=None):
    """Internal-force errors at the end with 0.5 mm of bias in the first arm, shape (m, 3); their scenario.

    Also what a rate of 1 /s would make of the bias: c_i k_I K gamma (b_i - bbar).
    """
    scenario = Scenario.load(name)
    first, *_ = arms = list(scenario.cell.arms)
    result = cp.run(
        scenario,
        {
            "motion": {"kind": "hold", "pose": scenario.start.model_dump()},
            "duration": duration,
            f"cell.arms.{first}.calibration_error.tip.xyz": [4e-4, 3e-4, 0.0],
        }
        | (changes or {}),
        warn=False,
        engine="compiled",
    )
    gamma, stiffness, _ = rates(result.scenario)
    shares = np.array(scenario.cell.shares)
    R_WP = Rotation.from_quat(result.data.payload_quaternion.values[-1]).as_matrix()
    bias = R_WP @ scenario.cell.grasps[first].matrix[:3, :3] @ [4e-4, 3e-4, 0.0]
    errors = (result.data.internal_wrench - result.data.desired_internal_wrench).values[-1, :, :3]
    own = np.eye(len(arms))[0]
    return errors, result.scenario, np.outer(shares * (own - shares[0]), stiffness * gamma * bias)


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE_CELLS)
def test_a_bias_loads_every_arm_by_its_own_part(name):
    """Redundant, unequal, three and continuous arms: f_i = c_i k_I K gamma (b_i - bbar) / beta."""
    errors, scenario, by_rate = held_with_a_bias(name, 5.0)
    expected = by_rate / rates(scenario)[2]
    assert_allclose(errors, expected, atol=0.01 * np.linalg.norm(expected[0]))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three-ur5-plate", "panda-ur5-bar"])
def test_a_lost_sensor_loads_every_arm_by_its_own_part(name):
    """Three and unequal arms: f_i = c_i k_I K gamma (b_i - bbar) (1 / beta + 1 / leak)."""
    errors, scenario, by_rate = held_with_a_bias(name, 8.0, {"sensors.wrist": {"lost": [[5.0, 8.0]]}})
    leak = scenario.controller.active_gains["leak"]
    expected = by_rate * (1.0 / rates(scenario)[2] + 1.0 / leak)
    assert_allclose(errors, expected, atol=0.1 * np.linalg.norm(expected[0]))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [80.0, 160.0])
@pytest.mark.parametrize("bias", [1e-4, 1e-3])
def test_bias_force_at_two_biases_and_two_rates(bias, rate):
    result = cp.run(
        at_rest("planar", 30.0, biased([bias, 0.0, 0.0]) | {"clock.rate_hz": rate}),
        warn=False,
        engine="compiled",
    )
    gamma, stiffness, beta = rates(result.scenario)
    expected = 0.25 * stiffness * gamma * bias / beta
    assert_allclose(np.linalg.norm(force_error(result)[-1]), expected, rtol=0.01)
    # Tracking: half of the bias, which no law can tell from the truth.
    assert_allclose(np.linalg.norm(result.data.pose_error.values[-1, :3]), bias / 2, rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("bias", [1e-4, 1e-3])
def test_the_internal_force_stays_for_an_hour(bias):
    scenario = Scenario.load("adept-anchored")
    result = cp.run(
        scenario,
        biased([bias, 0.0, 0.0])
        | {"events": [], "duration": 3600.0, "clock.steps_per_tick": 1, "clock.record_every": 800},
        warn=False,
    )
    gamma, stiffness, beta = rates(scenario)
    late = result.data.time.values >= 600.0
    error, time = force_error(result)[late], result.data.time.values[late]
    drift = np.abs(np.polyfit(time, error, 1)[0]).max()
    print(f"{1e3 * bias:g} mm: {np.linalg.norm(error[-1]):.5f} N after an hour, drift {drift:.2g} N/s")
    assert_allclose(np.linalg.norm(error, axis=1), 0.25 * stiffness * gamma * bias / beta, rtol=0.02)
    assert drift < 1e-9


@pytest.mark.slow
def test_two_pandas_hold_a_biased_box_for_a_minute():
    result = cp.run(
        "two-pandas-box", {"duration": 60.0, "clock.record_every": 10} | biased([1e-3, 0.0, 0.0]), warn=False
    )
    force, error = force_error(result), result.data.pose_error.values[:, :3]
    late = result.data.time.values >= 4.0
    print(f"{largest(force[late]):.3f} N at most from 4 s on, {1e3 * largest(error):.3f} mm")
    assert largest(force[late]) < 0.5
    assert largest(result.data.pose_error.values[:, :3]) <= 0.53e-3
    assert not result.data.saturated.values.any()


# ------------------------------------------------------------ stability


def grows(name, gain, *, pole=0.0, delay=0, every=1, lag=0.0):
    """Whether the internal force grows at this anchor gain, over wrist sensors and drives of this timing."""
    scenario = at_rest(name, {"planar": 25.0, "spatial": 10.0}.get(name, 5.0))
    wrist = {"delay": delay, "rate_hz": scenario.clock.rate_hz / every}
    path = {"kind": "low-pass", "pole": pole}
    changes = {"beyond_bound": True, "controller.gains.anchor_gain": gain, "controller.force_path": path}
    changes["actuators.lag"] = lag * scenario.clock.period
    try:
        result = cp.run(scenario, changes | {"sensors.wrist": wrist}, warn=False, engine="compiled")
    except DivergedError:
        return True
    error = np.linalg.norm(force_error(result), axis=1)
    fifth = len(error) // 5
    early = min(error[fifth : fifth + 100].max(), 20.0)  # more than that, torques are at their limits
    return error[-100:].max() > early


TIMINGS = [
    *({"pole": p} for p in (0.0, 0.5, 0.9)),
    *({"delay": D} for D in (1, 2, 5)),
    {"pole": 0.5, "delay": 2},
    {"pole": 0.9, "delay": 3},
    {"every": 4, "delay": 3},
    {"every": 4, "delay": 5},
    {"every": 2, "delay": 2, "pole": 0.5},
    {"lag": 3.0, "delay": 2},
    {"lag": 5.0, "pole": 0.8},
]


@pytest.mark.slow
@pytest.mark.parametrize("timing", TIMINGS, ids=str)
def test_anchor_gain_bound_is_sharp_on_the_plant(timing):
    bound = anchor_gain_bound(**timing)
    assert not grows("planar", 0.95 * bound, **timing)
    assert grows("planar", 1.05 * bound, **timing)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "timing"),
    [
        ("spatial", {"delay": 2}),
        ("spatial", {"pole": 0.5, "delay": 2}),
        ("spatial", {"every": 4, "delay": 5, "pole": 0.5}),
        ("spatial", {"lag": 3.0, "pole": 0.5}),
        ("three-ur5-plate", {"pole": 0.5, "delay": 2}),
        ("panda-ur5-bar", {"pole": 0.5, "delay": 2}),
    ],
    ids=str,
)
def test_anchor_gain_bound_is_sharp_in_space(name, timing):
    bound = anchor_gain_bound(**timing)
    assert not grows(name, 0.95 * bound, **timing)
    assert grows(name, 1.05 * bound, **timing)


# ------------------------------------------------------------ noise, loss and turned bases


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration", "gain"),
    [
        ("planar", 240.0, 0.1),
        ("planar", 240.0, 0.5),
        ("spatial", 60.0, 0.1),
        ("three-ur5-plate", 24.0, 0.1),
    ],
)
def test_noise_of_the_wrists_is_filtered_by_the_anchor(name, duration, gain):
    """rms f = sigma sqrt(g / (2 - g)), sigma^2 = (1 - c)^2 + (m - 1) c^2 of the noise of one wrist, 1 N."""
    changes = {"controller.gains.anchor_gain": gain, "sensors.wrist": {"noise": {"force": 1.0}}}
    scenario = at_rest(name, duration, changes)
    result, m = cp.run(scenario, warn=False), len(scenario.cell.arms)
    rows = 2 if name == "planar" else 3
    error = np.array([force_error(result, arm)[1600:, :rows] for arm in range(m if m > 2 else 1)])
    c = scenario.cell.shares[0]
    sigma = np.sqrt((1.0 - c) ** 2 + (m - 1) * c**2)
    assert_allclose(np.sqrt(np.mean(error**2)), sigma * np.sqrt(gain / (2.0 - gain)), rtol=0.05)


def test_a_lost_sensor_adds_what_the_leak_leaves():
    """c_i gamma K (k_I / lambda) |b_i - bbar| more than anchored; in 5 / beta after its return as before."""
    scenario = at_rest("planar", 14.0, biased([1e-3, 0.0, 0.0]) | {"sensors.wrist": {"lost": [[8.0, 12.0]]}})
    result = cp.run(scenario, warn=False)
    gamma, stiffness, beta = rates(scenario)
    error, time = np.linalg.norm(force_error(result), axis=1), result.data.time.values
    anchored = 0.25 * stiffness * gamma * 1e-3 / beta
    added = 0.25 * stiffness * gamma * 1e-3 / scenario.controller.active_gains["leak"]
    before, lost, after = (error[time < end][-1] for end in (8.0, 12.0, 12.0 + 5.0 / beta))
    assert_allclose(before, anchored, rtol=0.02)
    assert_allclose(lost, anchored + added, rtol=0.1)
    assert lost <= 0.5
    assert_allclose(after, before, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "end"), [(2.5, 7.0), (7.5, 9.0)])
def test_two_pandas_carry_on_without_their_sensor(start, end):
    """Lost in mid-motion and at rest, at a bias of 1 mm."""
    lost = {"sensors.wrist": {"lost": [[start, end]]}}
    scenario = Scenario.load("two-pandas-box", biased([1e-3, 0.0, 0.0]) | lost)
    result = cp.run(scenario, warn=False)
    gamma, stiffness, beta = rates(scenario)
    error, time = np.linalg.norm(force_error(result), axis=1), result.data.time.values
    assert not result.data.saturated.values.any()
    assert error.max(where=time >= 2.0, initial=0.0) <= 5.0
    assert largest(result.data.pose_error.values[:, :3]) <= 2e-3
    before, lost, after, later = (
        error[time < t][-1] for t in (start, end, end + 5.0 / beta, end + 10.0 / beta)
    )
    print(
        f"lost {start:g} to {end:g} s: {before:.3f}, {lost:.3f}, {after:.3f}, {later:.3f} N, at most"
        f" {error.max(where=time >= 2.0, initial=0.0):.2f} N,"
        f" {1e3 * largest(result.data.pose_error.values[:, :3]):.2f} mm"
    )
    anchored = 0.25 * stiffness * gamma * 1e-3 / beta
    # Of what is left when the sensor returns, (1 - g)^(5 / g) = 0.5 % remain: in mid-motion 4.5 N of it.
    assert_allclose(after, anchored, atol=0.1 * anchored + np.exp(-5.0) * (lost - anchored))
    assert_allclose(later, anchored, rtol=0.02)
    if start > 7.0:
        leaked = 0.25 * stiffness * gamma * 1e-3 / scenario.controller.active_gains["leak"]
        assert_allclose(lost, anchored + leaked, rtol=0.1)
        assert_allclose(after, before, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_turned_base_moves_the_payload_under_a_squeeze(name):
    """By beta |sum f_d| / (k_I K gamma): each arm turns f_d by its own pose, and the sum is not zero."""
    turned = {"cell.arms.left.calibration_error.base.rpy": [0.0, 0.0, 1e-3]}
    scenario = at_rest(name, 12.0 if name == "planar" else 5.0, turned)
    loose = {"squeeze": dict.fromkeys(scenario.cell.arms, (0.0,) * 6)}
    squeezed, free = (cp.run(scenario, changes, warn=False) for changes in ({}, loose))
    gamma, stiffness, beta = rates(scenario)
    f_d = squeezed.data.desired_internal_wrench.values[-1, 0, :3]
    sum_f_d = np.cross([0.0, 0.0, 1e-3], f_d)
    shift = (squeezed.data.pose_error - free.data.pose_error).values[-1, :3]
    expected = -beta * sum_f_d / (stiffness * gamma)
    assert_allclose(shift, expected, atol=0.02 * np.linalg.norm(expected))


# ------------------------------------------------------------ without the internal wrench


@pytest.mark.slow
@pytest.mark.parametrize("leak", [0.5, 1.0, 2.0])
def test_sag_times_internal_force_is_what_the_product_bound_says(leak):
    """P2: c_1 c_2 b D, whatever the leak; D = 100 N, b = 0.1 mm. Load along the bias."""
    load = {"kind": "wrench-pulse", "time": 0.0, "duration": 20.0, "wrench": [100.0, 0, 0, 0, 0, 0]}
    changes = NOTHING_MEASURED | {"events": [load], "controller.gains.leak": leak}
    result = cp.run(
        at_rest("planar", 20.0, changes | biased([1e-4, 0.0, 0.0])), warn=False, engine="compiled"
    )
    force, sag = force_error(result)[-2], result.data.pose_error.values[-2, :3]
    assert_allclose(np.linalg.norm(force) * np.linalg.norm(sag), 2.49e-3, atol=0.7e-5)
    from_the_mean_view = sag + 0.5 * world_bias(result, [1e-4, 0.0, 0.0])
    assert_allclose(
        np.linalg.norm(force) * np.linalg.norm(from_the_mean_view), 0.25 * 1e-4 * 100.0, rtol=1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("known", "gain", "bias"), [(0.0, 0.01, 1e-4), (18.0, 0.05, 1e-4), (18.0, 0.02, 2e-4)]
)
def test_own_wrist_wrenches_sag_by_the_error_of_the_weight(known, gain, bias):
    """20 N of weight in the plane, of which some are known; P2 with D = weight error."""
    per_newton = Scenario.load("adept-paper").cell.payload.mass / 20.0
    changes = NOTHING_MEASURED | {
        "cell.gravity": [20.0 / 11.2, 0.0, 0.0],
        "controller.payload_mass": known * per_newton,
        "controller.gains.anchor_gain": gain,
        "sensors.wrist": {},
    }
    # The bias along gravity in world axes, so that the true sag is the measured one less c_1 b.
    scenario = at_rest("planar", 40.0, changes)
    turned = (scenario.start.matrix[:3, :3] @ scenario.cell.grasps["left"].matrix[:3, :3]).T @ [bias, 0, 0]
    result = cp.run(scenario, biased(turned.tolist()), warn=False, engine="compiled")
    gamma, stiffness, beta = rates(scenario)
    force, sag = (np.linalg.norm(v[-1]) for v in (force_error(result), result.data.pose_error.values[:, :3]))
    unknown = 20.0 - known
    assert_allclose(force, 0.25 * stiffness * gamma * bias / beta, rtol=0.02)
    measured_sag = beta * unknown / (gamma * stiffness)
    assert_allclose(sag, measured_sag, atol=0.02 * measured_sag + 0.5 * bias)
    seen = result.data.pose_error.values[-1, 0] + 0.5 * bias
    assert_allclose(abs(seen) * force, 0.25 * bias * unknown, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["leaky", "own wrist"])
@pytest.mark.parametrize("name", ["spatial", "three-ur5-plate"])
def test_sag_and_internal_force_in_space(name, law):
    """Under gravity, with unequal shares and with three arms; P2 with c (1 - c) of the biased arm."""
    # Little load: the leaky law does not see that a sag changes the arms' own weights at the payload.
    bias, push = [2e-4, 0.0, 1e-4], np.array([0.0, 1.5, -4.0])
    known = Scenario.load(name).cell.payload.mass - 1.0 if name in CATALOGUE_CELLS else 2.0
    changes = {
        "leaky": {
            "controller.gains.leak": 1.0,
            "events": [{"kind": "wrench-pulse", "time": 0.0, "duration": 8.0, "wrench": [*push, 0, 0, 0]}],
        },
        "own wrist": {
            "controller.payload_mass": known,
            "controller.gains.anchor_gain": 0.02,
            "sensors.wrist": {},
        },
    }[law]
    first = next(iter(at_rest(name, 8.0).cell.arms))
    bias_of = {f"cell.arms.{first}.calibration_error.tip.xyz": bias}
    result = cp.run(at_rest(name, 8.0, NOTHING_MEASURED | changes | bias_of), warn=False, engine="compiled")
    (gamma, stiffness, beta), c = rates(result.scenario), result.scenario.cell.shares[0]
    b, gains = world_bias(result, bias), result.scenario.controller.gains
    if law == "leaky":
        load, spring = push, gamma * (gains.sliding_gain[0] + stiffness / gains.leak)
    else:
        load, spring = np.array([0.0, 0.0, -9.81]), gamma * stiffness / beta
    found, sag = force_error(result)[-2], result.data.pose_error.values[-2, :3] + c * b
    assert_allclose(found, c * (1.0 - c) * spring * b, atol=0.02 * c * (1.0 - c) * spring * np.linalg.norm(b))
    assert_allclose(sag, load / spring, atol=0.02 * np.linalg.norm(load) / spring)
    product = np.linalg.norm(found) * np.linalg.norm(sag)
    assert_allclose(product, c * (1.0 - c) * np.linalg.norm(b) * np.linalg.norm(load), rtol=0.03)


def test_zero_at_grasp_makes_a_bias_of_the_tip_vanish():
    """The leaky law runs as if there were no bias: 7.6 N without."""
    run = {"events": [], "duration": 6.0, "clock.steps_per_tick": 2} | NOTHING_MEASURED
    biases = [[0.0, 0.0, 0.0], [1e-3, 0.5e-3, 0.0]]
    exact, zeroed = (
        cp.run(
            "adept-anchored",
            run | biased(bias) | {"controller.zero_at_grasp": True},
            warn=False,
            engine="compiled",
        )
        for bias in biases
    )
    assert_allclose(force_error(zeroed), force_error(exact), atol=1e-6)
    assert_allclose(zeroed.data.pose_error, exact.data.pose_error, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CATALOGUE_CELLS if "plate" in name or "pandas" in name])
def test_zero_at_grasp_in_space(name):
    bias = {"xyz": [1e-3, -0.5e-3, 0.3e-3], "rpy": [2e-3, 0.0, -1e-3]}
    arm = next(iter(Scenario.load(name).cell.arms))
    changes = {"controller.zero_at_grasp": True, "duration": 3.0}
    exact = cp.run(name, changes, warn=False, engine="compiled")
    zeroed = cp.run(
        name, changes | {f"cell.arms.{arm}.calibration_error.tip": bias}, warn=False, engine="compiled"
    )
    assert_allclose(zeroed.data.internal_wrench, exact.data.internal_wrench, atol=1e-4)
    assert_allclose(zeroed.data.pose_error, exact.data.pose_error, atol=1e-7)
