"""Steady errors of laws against the closed forms; test_anchored compares these with runs."""

import math

import numpy as np
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.analysis import steady_errors
from coop_pin.cli import main
from coop_pin.control import RedundantSlidingMode, SlidingModeGains
from coop_pin.description.events import WrenchPulse
from coop_pin.errors import ArgumentError, OutOfRangeError

GAMMA, K, K_I, RATE = 2.0, 800.0, 5.0, 80.0
UNMEASURED = {"controller.force_path": {"kind": "none"}}


def errors(changes=None, *, scenario="adept-anchored", **given):
    return steady_errors(cp.Scenario.load(scenario, changes or {}), **given)


def test_anchored_law_has_a_constant_force_and_no_sag():
    found = errors(bias=1e-3, load=50.0)
    assert_allclose(found.force, 0.25 * K_I * K * GAMMA * 1e-3 / (0.1 * RATE))
    assert (found.sag, found.product, found.wrenches, found.delay) == (0.0, 0.0, 2, 15)
    # Beyond the saturation's width the integral's rate is limited: alpha = k_I w.
    unbounded = errors({"controller.anchor_bias": "none"}, bias=1.0)
    assert_allclose(unbounded.force, 0.5 * K * 0.25 / (0.1 * RATE))
    assert_allclose(errors({"controller.gains.anchor_gain": 0.5}, bias=1e-3).force, found.force / 5.0)


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


@pytest.mark.parametrize("cell", ["planar", pytest.param("spatial", marks=pytest.mark.slow)])
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
        forces.append(cp.run(scenario.override(tip)).data.internal_wrench.values[-1, 0, linear])
        load = WrenchPulse(time=0.0, duration=duration, wrench=(*(5.0 * axis), 0.0, 0.0, 0.0))
        sags.append(cp.run(scenario.replace(events=(load,))).data.pose_error.values[-1, linear])
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
