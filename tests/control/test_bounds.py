"""Stability bounds of sampled force feedback against closed forms and against the scalar recursion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, OutOfRangeError
from coop_pin.control import anchor_gain_bound, force_gain_bound
from coop_pin.control.bounds import SampledLoop


def is_stable(anchor_gain, pole=0.0, delay=0, every=1, force_gain=0.0, lag=0.0):
    """The scalar internal loop, tick by tick from f = 1, with nothing but the law's own update."""
    f, Z, f_m = [1.0] * (delay + 1), 1.0, 0.0
    left = np.exp(-1.0 / lag) if lag else 0.0  # of the last torque at the end of a tick
    for tick in range(6000):
        if tick % every == 0:
            f_m = pole * f_m + (1.0 - pole) * f[-1 - delay]
            Z -= anchor_gain * f_m
        if abs(Z) > 1e100:
            return False
        f.append(left * f[-1] + (1.0 - left) * (Z - force_gain * f_m))
    late = np.abs(f[-1000:]).max()
    return late < np.abs(f[1000:2000]).max() or late < 1e-12


def test_bound_of_a_filter_and_of_a_delay_alone():
    for p in (0.0, 0.5, 0.9, 0.99):
        assert_allclose(anchor_gain_bound(pole=p), 2.0 * (1.0 + p) / (1.0 - p), rtol=1e-9)
    for D in (0, 1, 2, 5, 20):
        assert_allclose(anchor_gain_bound(delay=D), 2.0 * np.sin(np.pi / (4.0 * D + 2.0)), rtol=1e-9)


@pytest.mark.parametrize(("p", "D"), [(0.5, 1), (0.9, 3), (0.95, 10), (0.3, 2)])
def test_bound_of_both_is_where_a_root_reaches_the_unit_circle(p, D):
    """z^D (z - 1)(z - p) + g (1 - p) z: all roots inside below it, one outside above."""
    bound = anchor_gain_bound(pole=p, delay=D)

    def largest_root(g):
        polynomial = np.concatenate((np.poly([1.0, p]), np.zeros(D)))
        polynomial[-2] += g * (1.0 - p)
        return np.abs(np.roots(polynomial)).max()

    assert largest_root(0.999 * bound) < 1.0 < largest_root(1.001 * bound)
    assert_allclose(largest_root(bound), 1.0, atol=1e-8)


LOOPS = [
    *({"pole": p} for p in (0.3, 0.5, 0.9)),
    *({"delay": D} for D in (1, 2, 5)),
    {"pole": 0.5, "delay": 2},
    {"pole": 0.9, "delay": 4},
    {"every": 4, "delay": 2},
    {"every": 3, "delay": 5, "pole": 0.4},
    {"pole": 0.95, "force_gain": 9.0},
    {"pole": 0.5, "delay": 1, "force_gain": 0.4},
    *({"lag": lag, "delay": D} for lag, D in ((0.5, 0), (10.0, 0), (3.0, 2))),
    {"lag": 10.0, "pole": 0.9},
    {"lag": 2.0, "pole": 0.5, "delay": 2, "every": 4, "force_gain": 0.3},
]


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_bound_is_sharp_on_the_scalar_recursion(loop):
    bound = anchor_gain_bound(**loop)
    assert is_stable(0.95 * bound, **loop)
    assert not is_stable(1.05 * bound, **loop)


@pytest.mark.parametrize(("pole", "delay", "lag"), [(0.0, 2, 3.0), (0.9, 0, 3.0), (0.9, 4, 10.0)])
def test_the_force_gain_bound_with_a_lag_is_sharp_on_the_scalar_recursion(pole, delay, lag):
    bound = force_gain_bound(pole, delay, lag=lag)
    for factor in (0.97, 1.03):
        loop = SampledLoop(pole, delay, lag=lag, force_gain=factor * bound)
        assert loop.is_stable() == (factor < 1.0)


def test_a_lag_of_the_drives_counts_in_the_bound_that_a_scenario_is_refused_at():
    """Filter and lag alone allow 38 and 40; together, with poles of 0.9 and exp(-0.1), 0.228."""
    lag = {"controller.force_path": {"kind": "low-pass", "pole": 0.9}, "actuators.lag": 10.0 / 80.0}
    bound = anchor_gain_bound(pole=0.9, lag=10.0)
    assert_allclose(bound, 0.228, atol=5e-4)
    assert cp.Scenario.load("adept-anchored", lag).actuator_lag == 10.0
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load("adept-anchored", lag | {"controller.gains.anchor_gain": 0.23})
    assert caught.value.path == "controller.gains.anchor_gain"
    assert f"{bound:.4g}" in str(caught.value)
    # One arm's lag counts, and what it would allow without any is not exceeded.
    own = {"arm_actuators.left": {"lag": 0.125}, "controller.gains.anchor_gain": 2.1}
    with pytest.raises(FieldError):
        cp.Scenario.load("adept-anchored", own)
    filtered = {"controller.gains.anchor_gain": 0.3, "controller.force_path": lag["controller.force_path"]}
    assert cp.Scenario.load("adept-anchored", filtered).actuator_lag == 0.0
    with pytest.raises(FieldError):
        cp.Scenario.load("adept-anchored", filtered | {"arm_actuators": {"right": {"lag": 0.125}}})


def test_a_slow_sensor_allows_as_much_as_one_at_the_control_rate_until_its_delay_exceeds_its_period():
    assert_allclose(anchor_gain_bound(every=5, delay=4), 2.0, rtol=1e-9)
    assert_allclose(anchor_gain_bound(every=5, delay=5), anchor_gain_bound(delay=1), rtol=1e-9)
    assert_allclose(anchor_gain_bound(every=5, delay=9), anchor_gain_bound(delay=1), rtol=1e-9)


def test_without_an_anchor_the_bound_is_that_of_the_force_gain():
    for p in (0.0, 0.5, 0.9):
        assert anchor_gain_bound(pole=p, force_gain=0.99 * force_gain_bound(p)) > 0.0
        assert anchor_gain_bound(pole=p, force_gain=1.01 * force_gain_bound(p)) == 0.0


def test_a_loop_has_no_filter_no_delay_and_a_sensor_at_the_control_rate_unless_stated():
    assert SampledLoop(anchor_gain=1.5).is_stable()
    assert not SampledLoop(anchor_gain=2.1).is_stable()
    assert not SampledLoop(delay=1, anchor_gain=1.5).is_stable()
    assert SampledLoop(delay=1, every=2, anchor_gain=1.5).is_stable()


@pytest.mark.parametrize(("name", "value"), [("pole", 1.0), ("pole", -0.1), ("delay", -1), ("every", 0)])
def test_loops_that_do_not_exist_are_refused(name, value):
    with pytest.raises(OutOfRangeError) as caught:
        anchor_gain_bound(**{name: value})
    assert (caught.value.name, caught.value.value) == (name, value)
    least = {"pole": "0", "delay": "0", "every": "1"}[name]
    assert f"at least {least}" in str(caught.value)


def test_a_gain_beyond_the_bound_is_refused_with_both_numbers_unless_insisted_on():
    late = {"controller.gains.anchor_gain": 1.99}
    assert cp.Scenario.load("adept-anchored", late).controller.gains.anchor_gain == 1.99
    beyond = {"controller.gains.anchor_gain": 2.5}
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load("adept-anchored", beyond)
    assert caught.value.path == "controller.gains.anchor_gain"
    assert "2.5" in str(caught.value)
    assert " 2 " in str(caught.value)
    assert cp.Scenario.load("adept-anchored", beyond | {"beyond_bound": True}).beyond_bound
    filtered = {"controller.force_path": {"kind": "low-pass", "pole": 0.5}}
    assert cp.Scenario.load("adept-anchored", beyond | filtered).controller.force_path.pole == 0.5


@pytest.mark.parametrize(
    ("fields", "loop"),
    [
        ({"controller.force_path": {"kind": "late", "delay": 2}}, {"delay": 2}),
        (
            {
                "controller.force_path": {"kind": "low-pass", "pole": 0.5, "delay": 1},
                "sensors.wrist.delay": 1,
            },
            {"pole": 0.5, "delay": 2},
        ),
        ({"sensors.wrist": {"delay": 5, "rate_hz": 20.0}}, {"delay": 5, "every": 4}),
        (
            {"controller.force_path.kind": "none", "controller.payload_mass": 9.0, "sensors.wrist.delay": 3},
            {"delay": 3},
        ),
    ],
    ids=["delay", "pole and delay", "slow sensor", "own wrist"],
)
def test_gains_are_refused_from_the_bound_of_the_scenarios_own_loop_on(fields, loop):
    bound = anchor_gain_bound(**loop)
    below, beyond = ({"controller.gains.anchor_gain": factor * bound} for factor in (0.999, 1.001))
    assert cp.Scenario.load("adept-anchored", fields | below).controller.measures
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load("adept-anchored", fields | beyond)
    assert caught.value.path == "controller.gains.anchor_gain"


def test_anchor_gains_that_differ_between_arms_are_refused():
    gains = cp.Scenario.load("adept-anchored").controller.gains
    with pytest.raises(FieldError) as caught:
        cp.Scenario.load("adept-anchored", {"controller.arm_gains": {"left": gains.replace(anchor_gain=0.2)}})
    assert caught.value.path == "controller.arm_gains.*.anchor_gain"
