"""Steady errors of laws against the closed forms; test_anchored compares these with runs."""

import math

import numpy as np
import pytest
from cells import ANCHORED, SCENARIOS
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from tiers import by_default

import coop_pin as cp
from coop_pin.base.errors import ArgumentError, OutOfRangeError
from coop_pin.base.spatial import make_pose
from coop_pin.cli import main
from coop_pin.compiled import BatchSimulator
from coop_pin.control import RedundantSlidingMode, SlidingModeGains
from coop_pin.description.events import WrenchPulse
from coop_pin.feasibility import force_reserve, reachability
from coop_pin.stability import anchor_biases, steady_errors

GAMMA, K, K_I, RATE = 2.0, 800.0, 5.0, 80.0
NEEDS = ("Jacobians", "a model of arms and payload", "the regressors of arms and payload")
UNMEASURED = {"controller.force_path": {"kind": "none"}}


def errors(changes=None, *, scenario="adept-anchored", **given):
    return steady_errors(cp.Scenario.load(scenario, changes or {}), **given)


def test_anchored_law_has_a_constant_force_and_no_sag():
    found = errors(bias=1e-3, load=50.0)
    assert_allclose(found.force, 0.25 * K_I * K * GAMMA * 1e-3 / (0.1 * RATE))
    assert (found.sag, found.product, found.wrenches, found.delay) == (0.0, 0.0, 2, 15)
    assert found.zero == 0.5  # its internal part; with unequal shares that of the arm with the smaller one
    assert errors({"cell.load_shares": {"left": 0.3, "right": 0.7}}).zero == 0.7
    assert math.isnan(errors(UNMEASURED).zero)
    # Beyond the saturation's width the integral's rate is limited: alpha = k_I w.
    unbounded = errors({"controller.anchor_bias": "none"}, bias=1.0)
    assert_allclose(unbounded.force, 0.5 * K * 0.25 / (0.1 * RATE))
    assert_allclose(errors({"controller.gains.anchor_gain": 0.5}, bias=1e-3).force, found.force / 5.0)


@pytest.mark.parametrize("force_gain", [0.0, 0.5])
def test_force_feedback_slows_the_ramp_and_divides_what_a_spring_holds(force_gain):
    """1 / (1 + K_f) of both, as on the plant; not of what the integral of an anchored law holds."""
    gains = {"controller.gains.force_gain": force_gain}
    fixed = {"controller.anchor_bias": (1e-3, 1e-2), "controller.anchor_bias_answered": (1e-3, 1e-2)}
    tip = {"events": [], "duration": 8.0, "cell.arms.left.calibration_error.tip.xyz": [2.5e-3, 0.0, 0.0]}
    found = errors(gains | fixed, bias=2.5e-3)
    assert_allclose(found.growth, 1.0 / (1.0 + force_gain))
    data = cp.run("adept-anchored", gains | fixed | tip, warn=False, engine="compiled").data
    error = (data.internal_wrench - data.desired_internal_wrench).isel(arm=0).values[:, :2]
    before, last = (np.linalg.norm(error[index]) for index in (-162, -2))
    assert_allclose((last - before) / 2.0, found.growth, rtol=0.01)
    spring = gains | {"controller.gains.anchor_gain": 0.0, "controller.gains.sign_gain": 0.0}
    assert_allclose(errors(spring, bias=1e-3).force, 0.25 * K * GAMMA * 1e-3 / (1.0 + force_gain))
    assert_allclose(errors(gains, bias=1e-3).force, errors(bias=1e-3).force)


@pytest.mark.parametrize("leak", [0.2, 2.0])
def test_leaky_law_trades_force_for_sag(leak):
    found = errors(UNMEASURED | {"controller.gains.leak": leak}, bias=1e-4, load=20.0)
    spring = GAMMA * K * (1.0 + K_I / leak)
    assert_allclose([found.force, found.sag], [0.25 * spring * 1e-4, 20.0 / spring])
    assert_allclose(found.force * found.sag, found.product)
    assert (found.wrenches, found.delay) == (0, math.inf)
    assert errors(UNMEASURED | {"controller.gains.leak": 0.0}).force == math.inf


def test_own_wrist_law_trades_force_for_sag_of_the_weight_error():
    own = UNMEASURED | {"controller.payload_mass": 10.0, "controller.gains.anchor_gain": 0.01}
    found = errors(own, bias=1e-4, load=20.0)
    beta = 0.01 * RATE
    assert_allclose(
        [found.force, found.sag], [0.25 * K_I * K * GAMMA * 1e-4 / beta, beta * 20.0 / (GAMMA * K_I * K)]
    )
    assert_allclose(found.force * found.sag, found.product)
    assert found.wrenches == 0
    # beta from the weight's error and the bias: the load sags by c b, and (1 - c) D is left.
    balanced = own | {"controller.gains.anchor_gain": found.balanced}
    assert_allclose(found.balanced, 0.5 * 1e-4 * GAMMA * K_I * K / 20.0 / RATE)
    found = errors(balanced, bias=1e-4, load=20.0)
    assert_allclose([found.sag, found.force], [0.5e-4, 10.0])
    assert f"anchor_gain {found.balanced:.3g}" in found.summary()
    assert math.isnan(errors().balanced)
    assert errors(own, load=1e6).sag == math.inf  # beyond what the saturated integral can hold


def test_the_worst_arm_counts_in_a_cell_of_three():
    found = errors(scenario="three-ur5-plate", bias=1e-3)
    assert_allclose(found.force, (1 / 3) * (2 / 3) * 30.0 * 2000.0 * 5.0 * 1e-3 / 50.0)
    assert found.wrenches == 3


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_the_printed_law_without_its_integral_is_a_spring(cell):
    """Force and sag are the largest singular values of what runs at rest show, axis by axis."""
    scenario, duration = SCENARIOS[cell](), 3.0
    still = {
        "cell.gravity": [0.0, 0.0, 0.0],
        "controller.gains.sign_gain": 0.0,
        "controller.gains.pose_gain": 4.0,
        "motion": {"kind": "hold", "pose": scenario.start.model_dump()},
        "squeeze": {},
        "events": [],
        "duration": duration,
    }
    scenario = scenario.override(still)
    X_WE = scenario.start.matrix @ scenario.cell.grasps["right"].matrix
    linear = [row for row in scenario.cell.task_rows.indices if row < 3]
    forces, sags = [], []
    for axis in np.eye(3)[linear]:
        tip = {"cell.arms.right.calibration_error.tip.xyz": (X_WE[:3, :3].T @ axis * 1e-3).tolist()}
        forces.append(cp.run(scenario.override(tip), warn=False).data.internal_wrench.values[-1, 0, linear])
        load = WrenchPulse(time=0.0, duration=duration, wrench=(*(5.0 * axis), 0.0, 0.0, 0.0))
        sags.append(cp.run(scenario.replace(events=(load,)), warn=False).data.pose_error.values[-1, linear])
    found = steady_errors(scenario, bias=1e-3, load=5.0)
    assert_allclose(np.linalg.norm(sags, 2), found.sag, rtol=0.02)
    assert_allclose(np.linalg.norm(forces, 2), found.force, rtol=0.02)
    halved = {"controller.force_path": {"kind": "low-pass"}, "controller.gains.force_gain": 1.0}
    assert_allclose(steady_errors(scenario.override(halved), bias=1e-3).force, found.force / 2.0)


def test_the_printed_law_with_its_integral_ramps_and_does_not_sag():
    found = errors(scenario="adept-paper", bias=1e-4, load=100.0)
    assert (found.force, found.sag) == (math.inf, 0.0)
    assert "nan" not in found.summary()
    redundant = SlidingModeGains(pose_gain=5.0, sign_gain=0.2, damping_gain=20.0, transient_rate=5.0)
    found = errors({"controller": RedundantSlidingMode(gains=redundant)}, scenario="two-pandas-box")
    assert math.isnan(found.force)


def test_laws_in_joint_space_say_what_they_need_and_the_product_bound():
    found = errors(scenario="adept-paper", bias=1e-4, load=100.0)
    assert_allclose(found.product, 0.25 * 1e-4 * 100.0)
    fed_back = {"controller.force_path": {"kind": "late"}, "controller.gains.force_gain": 0.5}
    found = errors(fed_back, scenario="adept-paper")
    assert (found.wrenches, found.delay, found.product) == (2, math.inf, 0.0)
    filtered = {"controller.force_path": {"kind": "low-pass"}, "controller.gains.force_gain": 9.0}
    assert 0 <= errors(filtered, scenario="adept-paper").delay < 10
    needs_model = {needs: "no model" not in found._replace(needs=needs).summary() for needs in NEEDS}
    assert needs_model == {needs: "arms and payload" in needs for needs in NEEDS}


@pytest.mark.parametrize("seed", range(5))
def test_the_product_bound_holds_for_any_increasing_characteristic(seed):
    """P2: force times (sag + bias) >= c_1 c_2 b D; a phi that knows b has less force times sag."""
    rng, b, c = np.random.default_rng(seed), 1e-3, np.array([0.3, 0.7])
    knots = np.sort(rng.uniform(-20.0 * b, 20.0 * b, 40))
    phi_at = np.cumsum(rng.exponential(size=40) ** 3)
    if seed == 0:  # steep at 0 and at b alone
        knots = np.array([-1.0, -1e-6, 1e-6, b - 1e-6, b + 1e-6, 1.0])
        phi_at = np.array([-1e-9, 0.0, 1.0, 1.0 + 1e-9, 2.0, 2.0 + 1e-9])
    x = np.linspace(-10.0 * b, 10.0 * b, 200_001)
    first, second = np.interp(x + b, knots, phi_at), np.interp(x, knots, phi_at)
    load = c[0] * first + c[1] * second
    half = len(x) // 2 if seed == 0 else rng.integers(60_000, 140_000)
    reach = 200 if seed == 0 else rng.integers(500, 50_000)
    held = slice(half - reach, half + reach + 1)
    D, e = (load[held][-1] - load[held][0]) / 2.0, (x[held][-1] - x[held][0]) / 2.0
    force = c.prod() * (first - second)[held].max()
    assert force * (e + b) >= c.prod() * b * D
    if seed == 0:
        assert force * e < 0.1 * c.prod() * b * D


def test_what_cannot_be_asked_is_refused():
    with pytest.raises(ArgumentError):
        errors({"controller": cp.UserController(target="test_steady_errors:Nothing")})
    with pytest.raises(OutOfRangeError):
        errors(bias=0.0)


def test_check_prints_them(capsys):
    assert main(["check", "adept-anchored", "--poses", "3", "--bias", "2e-3", "--load", "5"]) == 0
    text = capsys.readouterr().out
    assert "2 mm leaves 0.5 N" in text
    assert "stable with 15 more ticks" in text


def test_the_further_delay_counts_from_the_stated_ones():
    wrist = {"sensors.wrist.delay": 2, "controller.force_path.delay": 1}
    plain, late = (steady_errors(cp.Scenario.load("adept-anchored", fields)).delay for fields in ({}, wrist))
    assert late == plain - 3


# ------------------------------------------------------------ what an anchor bears, on the plant

DURATION = {"planar": 9.0, "spatial": 5.0}


def at_rest(cell, **changes):
    """A test cell that holds its start without weight, with its anchored law."""
    scenario = SCENARIOS[cell]().override({"events": [], "duration": DURATION[cell]})
    still = {"motion": {"kind": "hold", "pose": scenario.start.model_dump()}, "cell.gravity": [0.0, 0.0, 0.0]}
    return scenario.replace(controller=ANCHORED[cell]).override(still | {"clock.steps_per_tick": 1} | changes)


def tip_off(scenario, vector):
    """The scenario whose first arm sees the payload off by a vector in world axes, by its tip."""
    X_WE = scenario.start.matrix @ scenario.cell.grasps["left"].matrix
    return scenario.override(
        {"cell.arms.left.calibration_error.tip.xyz": (X_WE[:3, :3].T @ np.array(vector)).tolist()}
    )


def ramps(scenarios, part=slice(3)):
    """Rate of the first arm's internal force (or moment) over the last second of each run, N/s (N m/s)."""
    batch, found = BatchSimulator().run(scenarios), []
    for index, scenario in enumerate(scenarios):
        data = batch.result(index).data
        force, ticks = data.internal_wrench.values[:, 0, part], round(scenario.clock.rate_hz)
        found.append(float(np.linalg.norm(np.nan_to_num(force[-1] - force[-1 - ticks]))))
    return found


def fixed_bound(b_0, b_0_turn=0.1):
    return {f"controller.{name}": [b_0, b_0_turn] for name in ("anchor_bias", "anchor_bias_answered")}


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_a_bias_comes_to_rest_up_to_the_limit_and_ramps_beyond(cell):
    """At equal shares and b_max = 6 b_0; a fixed bound ramps at the rate that is told."""
    shares = {"cell.load_shares": {"left": 0.5, "right": 0.5}}
    answered = {"controller.anchor_bias": [1e-3, 0.1], "controller.anchor_bias_answered": [6e-3, 0.1]}
    scenario = at_rest(cell, **shares, **answered)
    limit = steady_errors(scenario).limit
    assert 2e-3 < limit < 12e-3
    fixed = at_rest(cell, **shares, **fixed_bound(1e-3))
    assert steady_errors(fixed).limit == 2e-3
    found = ramps(
        [tip_off(scenario, [0.0, -part * limit, 0.0]) for part in (0.95, 1.1)]
        + [tip_off(fixed, [0.0, 2.5e-3, 0.0])]
    )
    told = [steady_errors(law, bias=bias) for law, bias in ((scenario, 1.1 * limit), (fixed, 2.5e-3))]
    assert found[0] < 0.02 * found[1]
    assert steady_errors(scenario, bias=0.95 * limit).growth == 0.0
    assert 0.7 * told[0].growth < found[1] < 1.1 * told[0].growth  # the centre depends on the bias a little
    assert_allclose(found[2], told[1].growth, rtol=0.02)
    assert [each.force for each in told] == [np.inf, np.inf]


@pytest.mark.parametrize("cell", by_default(SCENARIOS, "planar"))
def test_the_bias_of_an_anchor_for_a_tip_and_a_turned_base(cell):
    """0.9 of it ramps, 1.1 of it bears it, whatever the shares; the turn acts by the distance of the base."""
    base = at_rest(cell)
    bias, turn = 1.5e-3, 2e-3
    position, angle = anchor_biases(base, bias, turn)["left"]
    arm = base.cell.arms["left"].base.xyz
    sideways = np.cross([0.0, 0.0, turn], np.subtract(base.start.xyz, arm))
    distance = np.linalg.norm(np.subtract(base.start.xyz, arm))
    assert_allclose((position, angle), ((bias + turn * distance) / 2.0, turn / 2.0))
    # Tip and turn the same way: across the lever in the plane, of which the turn has all or a part.
    tip, across = bias * sideways / np.linalg.norm(sideways), np.linalg.norm(sideways)
    position *= (bias + across) / (bias + turn * distance)
    error = {"cell.arms.left.calibration_error.base.rpy": [0.0, 0.0, turn]}
    runs = [tip_off(at_rest(cell, **fixed_bound(part * position), **error), tip) for part in (0.9, 1.1)]
    too_little, enough = ramps(runs)
    assert enough < 0.02 * too_little


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_an_angle_that_an_anchor_bears_is_half_of_the_turn(cell):
    """A tip that is turned alone, about the payload's centre: moments ramp beyond half of it."""
    scenario, turn = at_rest(cell), 8e-3
    grasp = scenario.cell.grasps["left"].matrix
    X_PE, spun = grasp, make_pose((0.0, 0.0, 0.0), (0.0, 0.0, turn))
    tip = np.linalg.inv(X_PE) @ spun @ X_PE  # the tip as it is believed to be, about the payload's centre
    rpy = Rotation.from_matrix(tip[:3, :3]).as_euler("xyz").tolist()
    error = {"cell.arms.left.calibration_error.tip": {"xyz": tip[:3, 3].tolist(), "rpy": rpy}}
    _, angle = anchor_biases(scenario, 1e-9, turn)["left"]
    runs = [at_rest(cell, **fixed_bound(5e-3, part * angle), **error) for part in (0.9, 1.1)]
    too_little, enough = ramps(runs, slice(3, 6))
    assert enough < 0.02 * too_little


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_force_that_no_arm_can_change_is_held_up_to_its_limit(cell):
    """The last arm is dead: the first one asks for its squeeze in vain, of 0.8 and 1.3 times the limit."""
    scenario = at_rest(cell, **{"controller.anchor_bias": "none", "arm_actuators.right.torque_lost_at": 1.0})
    largest = steady_errors(scenario).unreachable
    ends = []
    for part in (0.8, 1.3):
        squeeze = {"left": [0.0, part * largest, 0.0, 0.0, 0.0, 0.0]}
        squeeze["right"] = [-entry for entry in squeeze["left"]]
        ends.append(scenario.override({"squeeze": squeeze, "duration": 8.0}))
    batch = BatchSimulator().run(ends)
    error = [np.linalg.norm(batch.result(index).data.pose_error.values[:, :3], axis=1) for index in (0, 1)]
    second = round(scenario.clock.rate_hz)
    held, lost = ((each[-1] - each[-1 - second]) for each in error)
    assert abs(held) < 0.1 * lost
    assert_allclose(error[0][-1], steady_errors(scenario, load=0.8 * largest).drift, rtol=0.05)
    assert steady_errors(at_rest(cell)).unreachable == np.inf


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.gate)])
def test_a_force_that_grows_reaches_the_first_drive_at_the_time_that_is_told(cell):
    """Along the direction in which the weakest drive holds least; the ramp itself begins after the start."""
    scenario = at_rest(cell, **fixed_bound(1e-3), duration=8.0)
    model = cp.model.CellArm(scenario.cell, "left")
    J = model.payload_jacobian(
        cp.solve_ik(model, scenario.start.matrix, posture=scenario.cell.arms["left"].posture)
    )[:3]
    levers = np.linalg.norm(J @ model.from_drive, axis=0)
    weakest = int(levers.argmax())
    direction = (J @ model.from_drive)[:, weakest] / levers[weakest]
    needed = cp.feasibility.static_torques(scenario, poses=5).arms[0].torque[0]
    spare = np.where(np.arange(len(needed)) == weakest, 6.0, 60.0) * levers.max()
    limits = (np.abs(needed) + spare).tolist()
    scenario = scenario.override({"cell.arms.left.torque_limits": limits})
    reach = reachability(scenario, poses=5)
    growth = steady_errors(scenario, bias=3e-3).growth
    time = force_reserve(scenario, reach) / growth
    biased = [tip_off(scenario, sign * 3e-3 * direction) for sign in (1.0, -1.0)]
    batch = BatchSimulator().run(biased)
    cut = []
    for index in (0, 1):
        data = batch.result(index).data
        hit = np.flatnonzero(data.saturated.values[:, 0].any(axis=-1))
        cut.append(data.time.values[hit[0]] if hit.size else np.inf)
    assert time < min(cut) < time + 1.5
