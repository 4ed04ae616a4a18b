"""Controllers with a model, each by a published property of its paper, in a planar and a spatial cell."""

import numpy as np
import pytest
from cells import SCENARIOS
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.errors import FieldError, ScenarioError

STEP = 0.02


def stated(target, **options):
    """Changes that name a controller of the package."""
    path = {"kind": "late"}
    return {"controller": {"kind": "user", "target": target, "options": options, "force_path": path}}


def computed_torque(**options):
    return stated("coop_pin.model_based:ComputedTorqueController", **options)


def still(name, controller, *, step=0.0, rate=250.0, duration=0.5, **changes):
    """A test cell at rest, whose reference is a step away along x."""
    scenario = SCENARIOS[name]().replace(events=(), duration=duration)
    goal = scenario.start.model_dump()
    goal["xyz"] = [goal["xyz"][0] + step, *goal["xyz"][1:]]
    motion = {"kind": "hold", "pose": goal}
    return scenario.override(
        {"motion": motion, "clock.rate_hz": rate, "clock.steps_per_tick": 1} | controller | changes
    )


def x_error(result):
    return result.data.pose_error.values[:, 0]


def force_error(result):
    """Internal-wrench error of the first arm over time, shape (n, 6)."""
    error = result.data.internal_wrench - result.data.desired_internal_wrench
    return np.nan_to_num(error.values[:, 0])


@pytest.mark.parametrize("name", SCENARIOS)
def test_computed_torque_with_the_exact_model_decays_at_the_chosen_poles(name):
    """Tarn, Bejczy and Yun (1987): e'' + K_v e' + K_p e = 0; what is left is of the order of the tick."""
    worst = []
    for rate in (125.0, 250.0):
        result = cp.run(
            still(name, computed_torque(position_gain=25.0, velocity_gain=10.0), step=STEP, rate=rate)
        )
        t = result.data.time.values
        worst.append(np.abs(x_error(result) + STEP * (1.0 + 5.0 * t) * np.exp(-5.0 * t)).max())
        assert worst[-1] < 2.5 * STEP / rate
    assert_allclose(worst[0] / worst[1], 2.0, rtol=0.15)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_internal_force_integral_takes_out_what_a_wrong_model_leaves(name):
    """Hsu, Li and Sastry (1989): the internal force converges; the tracking error of the model stays."""
    wrong = {"mass": 1.3, "inertia": 0.8, "friction": 0.0}
    left = {}
    for gain in (0.0, 0.2):
        controller = computed_torque(model=wrong, anchor_gain=gain, position_gain=100.0, velocity_gain=20.0)
        result = cp.run(still(name, controller, step=STEP, duration=1.0))
        left[gain] = np.abs(force_error(result)[-125:]).max()
        assert np.abs(x_error(result)[-125:]).max() > 1e-4
    assert left[0.2] < 0.2 * left[0.0]


def test_options_that_the_class_does_not_take_are_refused_with_their_path():
    with pytest.raises(FieldError) as refused:
        cp.run("adept-paper", computed_torque(gain=1.0))
    assert refused.value.path == "controller.options"
    with pytest.raises(ScenarioError):
        cp.run("adept-paper", computed_torque(model={"mas": 2.0}))


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_payload_answers_a_push_like_the_stated_mass_spring_and_damper(name):
    """Schneider and Cannon (1992): M_d e'' + D e' + K e = F_ext, whatever payload and arms weigh."""
    M_d, D, K, push = 15.0, 240.0, 1500.0, 30.0
    linear, angular = (2, 1) if name == "planar" else (3, 3)
    controller = stated(
        "coop_pin.model_based:ObjectImpedanceController",
        **{
            field: [value] * linear + [value / M_d] * angular
            for field, value in {"inertia": M_d, "damping": D, "stiffness": K}.items()
        },
    )
    event = {"kind": "wrench-pulse", "time": 0.0, "duration": 1.0, "wrench": [push, 0, 0, 0, 0, 0]}
    result = cp.run(
        still(name, controller, duration=1.0, rate=500.0, events=[event], **{"sensors.wrist": {}})
    )
    t = result.data.time.values
    p, r = np.roots([M_d, D, K])
    answer = push / K * (1.0 + (r * np.exp(p * t) - p * np.exp(r * t)) / (p - r)).real
    assert_allclose(x_error(result), answer, atol=0.03 * push / K)
    assert_allclose(x_error(result)[-1], push / K, rtol=0.02)
