"""The dead zone in the integral of the payload-space law: closed forms, runs, and the loads that break it."""

import numpy as np
import pytest
from batches import require_same_samples
from cells import ANCHORED, SCENARIOS, arm_of
from numpy.testing import assert_allclose
from page_texts import read_numbers, require_numbers, rounds_to
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ScenarioError
from coop_pin.base.spatial import make_pose, task_rows
from coop_pin.compiled import BatchSimulator
from coop_pin.control import ArmMeasurement, ArmReference, PayloadSpace, Saturation
from coop_pin.running.check import run_findings
from coop_pin.stability import steady_errors

GAMMA, K, K_I, MASS = 2.0, 800.0, 5.0, 67.0
DELTA, BIAS, SPRING = 1.2e-3, 1e-3, GAMMA * K
ROWS = task_rows("planar")


def on_one_axis(load, duration, *, shares=(0.5, 0.5), k_I=K_I, bias=BIAS, gamma=GAMMA, mass=MASS):
    """A mass on an axis, held by two controllers of which the first sees it off by the bias.

    Returns the position and the internal force of the first arm at each tick, shape (n, 2).
    """
    gains = {"pose_gain": gamma, "sliding_gain": K, "sign_gain": k_I, "transient_rate": 5.0}
    zone, period = (DELTA, 5.0 * DELTA), 1.0 / 80.0
    law = PayloadSpace(gains=gains, switching=Saturation(width=1.0), integral_dead_zone=zone)
    arms = [arm_of(ROWS, period, share) for share in shares]
    controllers = [law.controller_of(arm, law.gains.sized(3, 3), None) for arm in arms]
    nothing, eye, still = np.zeros(3), np.eye(3), np.zeros(3, dtype=bool)
    goal = ArmReference(make_pose((0.0, 0.0, 0.0)), nothing, nothing, nothing)

    def seen(time, x, v, off):
        pose, twist = make_pose((x + off, 0.0, 0.0)), np.array([v, 0.0, 0.0])
        return ArmMeasurement(time, nothing, twist, pose, twist, eye, None, still)

    x, v, offs, rows = 0.0, 0.0, (bias, 0.0), []
    states = [each.init(seen(0.0, x, v, off), goal) for each, off in zip(controllers, offs, strict=True)]
    for k in range(round(duration / period)):
        time, w = k * period, []
        for i, (each, off) in enumerate(zip(controllers, offs, strict=True)):
            command = each.step(seen(time, x, v, off), goal, states[i])
            states[i] = command.state
            w.append(-command.torque[0])
        acceleration = (load(time) - sum(w)) / mass
        x, v = x + period * v + 0.5 * period**2 * acceleration, v + period * acceleration
        rows.append((x, w[0] - shares[0] * sum(w)))
    return np.array(rows)


@pytest.mark.parametrize(
    ("shares", "load"),
    [
        *(((0.5, 0.5), 0.5), ((0.3, 0.7), 20.0)),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (((0.5, 0.5), 20.0), ((0.3, 0.7), 0.5))),
    ],
)
def test_a_slow_load_is_taken_by_the_arm_that_is_further_off(shares, load):
    """max(c_1 c_2 K gamma b, c_2 (L - K gamma (delta - b))): half of the load, whatever the bias."""
    x, force = on_one_axis(lambda t: load * min(t / 40.0, 1.0), 70.0, shares=shares)[-1]
    springs = np.prod(shares) * SPRING * BIAS
    expected = max(springs, shares[1] * (load - SPRING * (DELTA - BIAS)))
    assert_allclose(force, expected, rtol=1e-6)
    assert_allclose(x, min(load / SPRING - shares[0] * BIAS, DELTA - BIAS), atol=1e-9)


@pytest.mark.parametrize("load", [1000.0, pytest.param(200.0, marks=pytest.mark.slow)])
def test_a_load_that_comes_at_once_costs_its_logarithm(load):
    """c_1 c_2 K gamma b (1 + 1 / c_1 + log((L / (K gamma) - delta) / (c_1 b))) for k_I far below gamma."""
    shares, gamma = np.array([0.4, 0.6]), 8.0
    x, force = on_one_axis(lambda _: load, 120.0, shares=shares, gamma=gamma, k_I=0.2, mass=20.0)[-1]
    spring = gamma * K
    part = 1.0 + 1.0 / shares[0] + np.log((load / spring - DELTA) / (shares[0] * BIAS))
    assert_allclose(force, shares.prod() * spring * BIAS * part, rtol=0.06)
    assert_allclose(x, DELTA - BIAS, atol=1e-5)
    if load > 500.0:
        assert force * (DELTA + BIAS) < 0.25 * shares.prod() * BIAS * load


def test_loads_that_come_and_go_slowly_ratchet_without_end():
    """By 2 D - K gamma (2 delta - b) for each cycle, while one arm takes all: D' < c k_I K gamma b."""
    D, cycle = 6.0, 60.0
    assert 4.0 * D / cycle < 0.5 * K_I * SPRING * BIAS / 4.0

    def load(t):
        return D * (4.0 * abs((t / cycle - 0.25) % 1.0 - 0.5) - 1.0)

    force = on_one_axis(load, 2.26 * cycle)[:, 1]
    at_top = force[np.round((np.arange(3) + 0.25) * cycle * 80.0).astype(int)]
    assert_allclose(np.diff(at_top), 2.0 * D - SPRING * (2.0 * DELTA - BIAS), rtol=0.02)


@pytest.mark.slow
def test_a_hundred_newton_over_a_hundred_seconds_leave_half_of_them():
    load, time = map(
        float, read_numbers("impossibility", r"the same (\d+) N over (\d+) s leave half of them")
    )
    force = on_one_axis(lambda t: load * min(t / time, 1.0), time + 40.0)[-1, 1]
    assert_allclose(force, 0.5 * load, rtol=0.005)


@pytest.mark.slow
def test_ten_sine_cycles_ratchet():
    """100 N, 20 s a cycle: more than three times the load."""
    force = on_one_axis(lambda t: 100.0 * np.sin(np.pi * t / 10.0) * (t < 200.0), 201.0)[:, 1]
    load, cycle, left = read_numbers(
        "impossibility", r"the same (\d+) N over .*, and ten sine cycles of (\d+) s leave (\d+) N"
    )
    assert (float(load), float(cycle)) == (100.0, 20.0)
    assert_allclose(force[-1], float(left), rtol=0.02)


@pytest.mark.parametrize(
    ("bias", "shares"),
    [
        *((2.2e-3, (0.3, 0.7)), (2.6e-3, (0.5, 0.5)), (2.6e-3, (0.3, 0.7))),
        pytest.param(2.2e-3, (0.5, 0.5), marks=pytest.mark.slow),
    ],
)
def test_views_within_the_zone_come_to_rest_and_others_ramp(bias, shares):
    """c_1 c_2 k_I K gamma (b - 2 delta) a second beyond 2 delta."""
    force = on_one_axis(lambda _: 0.0, 60.0, shares=shares, bias=bias)[:, 1]
    expected = np.prod(shares) * K_I * SPRING * max(bias - 2.0 * DELTA, 0.0)
    assert_allclose((force[-1] - force[-801]) / 10.0, expected, rtol=1e-3, atol=1e-9)


# ------------------------------------------------------------ on the plant


def cell_with(name, bias, loads, duration, **changes):
    """A test cell at rest without weight, with the dead-zone law, a bias and loads along x from times on."""
    base = SCENARIOS[name]().replace(events=(), duration=duration)
    law, (first, *_) = ANCHORED[name], base.cell.arms
    width = law.switching.width
    gains = law.gains.replace(sign_gain=0.25 / width, leak=None)
    zone = (1.2 * np.linalg.norm(bias), 4e-3)
    law = PayloadSpace(gains=gains, switching=Saturation(width=1.0), integral_dead_zone=zone)
    X_WE = base.start.matrix @ base.cell.grasps[first].matrix
    events = [
        {"kind": "wrench-pulse", "time": t, "duration": duration - t, "wrench": [*force, 0.0, 0.0, 0.0]}
        for t, force in loads
    ]
    still = {
        "motion": {"kind": "hold", "pose": base.start.model_dump()},
        "cell.gravity": [0.0, 0.0, 0.0],
        "clock.steps_per_tick": 1,
        "events": events,
        f"cell.arms.{first}.calibration_error.tip.xyz": (X_WE[:3, :3].T @ np.array(bias)).tolist(),
    }
    frictions = {f"cell.arms.{arm}.friction": "none" for arm in base.cell.arms}
    return base.replace(controller=law).override(still | frictions | changes)


CASES = {"planar": (50.0, 60.0, 80.0), "spatial": (30.0, 12.0, 18.0)}
"""Load, N, the time in which it comes, s, and the duration of the run, s."""


@pytest.mark.parametrize("name", by_default(SCENARIOS, "spatial"))
def test_a_slow_load_on_the_plant(name):
    """c_2 (L - K gamma (delta - b)); the UR5 have turned grasp frames and unequal shares."""
    load, ramp, duration = CASES[name]
    steps = [(k * ramp / 240, (load / 240, 0.0, 0.0)) for k in range(240)]
    scenario = cell_with(name, (1e-3, 0.0, 0.0), steps, duration)
    result = cp.run(scenario, warn=False, engine="compiled")
    error = (result.data.internal_wrench - result.data.desired_internal_wrench).values[-2, 0, :3]
    errors = steady_errors(scenario, bias=1e-3, load=load)
    gains, (delta, _) = scenario.controller.gains, scenario.controller.integral_dead_zone
    by_hand = scenario.cell.shares[1] * (load - gains.pose_gain * gains.sliding_gain[0] * (delta - 1e-3))
    assert_allclose(np.linalg.norm(np.nan_to_num(error)), by_hand, rtol=0.05)
    assert_allclose(errors.ramp, by_hand)
    assert_allclose((errors.sag, errors.limit), (delta, 2.0 * delta))


@pytest.mark.gate
@pytest.mark.parametrize("name", by_default(SCENARIOS, "planar"))
def test_a_batch_is_the_single_run(name):
    scenario = cell_with(name, (1e-3, 0.0, 0.0), [(0.1, (30.0, 5.0, 0.0))], 0.6)
    single = cp.run(scenario, engine="pinocchio", warn=False).data
    require_same_samples(BatchSimulator().run([scenario]).result(0).data, single)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("load", "begin", "error", "force", "below"),
    [
        (100.0, 0.0, 1.407e-3, 2.14, 4.85),
        (400.0, 0.0, 1.407e-3, 1.58, 26.2),
        (100.0, 10.0, 0.894e-3, 3.46, 3.8),
        (400.0, 10.0, 1.179e-3, 4.45, 10.3),
    ],
)
def test_a_load_at_once_rests_below_the_product(load, begin, error, force, below):
    """Two planar arms, 1 mm of bias in the tip: times below c_1 c_2 b D / (e + b)."""
    law = {"force_path": {"kind": "none"}, "integral_dead_zone": (1.2e-3, 6e-3)}
    linear = {"controller.switching.width": 1.0, "controller.gains.sign_gain": 5.0}
    changes = {f"controller.{name}": value for name, value in law.items()} | linear
    pulse = {"kind": "wrench-pulse", "time": begin, "duration": 60.0 - begin, "wrench": [load, 0, 0, 0, 0, 0]}
    tip = {"cell.arms.left.calibration_error.tip.xyz": [1e-3, 0.0, 0.0]}
    result = cp.run(
        "adept-anchored", changes | tip | {"events": [pulse], "duration": 60.0}, warn=False, engine="compiled"
    )
    off = (result.data.internal_wrench - result.data.desired_internal_wrench).values[-2, 0, :2]
    x = float(np.linalg.norm(result.data.pose_error.values[-2, :2]))
    assert_allclose((x, np.linalg.norm(off)), (error, force), rtol=0.02)
    times = 0.25 * 1e-3 * load / (x + 1e-3) / np.linalg.norm(off)
    assert_allclose(times, below, rtol=0.03)
    first, later = (
        read_numbers("impossibility", text)
        for text in (
            r"(\d+) and (\d+) N from the start leave ([\d.]+) and ([\d.]+) N at [\d.]+ mm of error. "
            r"That is ([\d.]+) and (\d+) times below",
            r"(\d+) and (\d+) N from .* As a step after (?:\d+) s they leave ([\d.]+) and ([\d.]+) N at "
            r"(?:[\d.]+) and (?:[\d.]+) mm, ([\d.]+) and (\d+) times below",
        )
    )
    shown, column = later if begin else first, int(load > 100.0)
    assert float(shown[column]) == load
    assert rounds_to(np.linalg.norm(off), shown[2 + column])
    assert rounds_to(times, shown[4 + column])
    bias = r"with (\d) mm of bias and \$\\delta\$ = ([\d.]+) mm"
    require_numbers("impossibility", {bias: [1, 1.2], r"As a step after (\d+) s": 10})
    off_at = read_numbers("impossibility", r"N at ([\d.]+) and ([\d.]+) mm, [\d.]+ and \d+ times below")
    if begin:
        assert rounds_to(1e3 * x, off_at[column])
    else:
        require_numbers("impossibility", {r"N at ([\d.]+) mm of error": 1e3 * x})


# ------------------------------------------------------------ fields, and what `check` says


@pytest.mark.parametrize(
    "changes",
    [
        {"controller.force_path": {"kind": "late"}},
        {"controller.gains.leak": 0.5},
        {"controller.integral_dead_zone": [1e-3, -1e-3]},
        {"controller.integral_dead_zone": 1e-3},
    ],
)
def test_a_dead_zone_beside_an_anchor_or_a_leak_is_refused(changes):
    zone = {"controller.force_path": {"kind": "none"}, "controller.integral_dead_zone": [1e-3, 5e-3]}
    with pytest.raises(ScenarioError, match="integral_dead_zone"):
        cp.Scenario.load("adept-anchored", zone | changes)


POSES = 11


def test_check_judges_the_loop_beyond_the_zone_and_the_forecast_says_what_it_leaves_out():
    zone = {"controller.integral_dead_zone": [1.2e-3, 6e-3]}
    with_zone, without = (
        cp.Scenario.load(
            "adept-anchored", {"events": [], "controller.force_path": {"kind": "none"}} | changes
        )
        for changes in (zone, {"controller.gains.leak": 0.0})
    )
    assert with_zone.controller.beyond_dead_zone == without.controller
    loops = [
        next(each for each in run_findings(scenario) if each.kind == "loop stability").value
        for scenario in (with_zone, without)
    ]
    assert loops[0] == loops[1]
    assert any("dead zone" in each.sentence for each in cp.check(with_zone, poses=POSES))
    fast = {"controller.gains.sign_gain": 4.0, "controller.gains.pose_gain": 20.0}
    assert not run_findings(with_zone.override(fast)).ok
