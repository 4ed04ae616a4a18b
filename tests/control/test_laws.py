"""Every law of the package is asked the same: checks, gains, needs, steady errors."""

import math
from typing import get_args

import pytest
from cells import SCENARIOS
from law_cells import stated, still
from numpy.testing import assert_allclose

import coop_pin as cp
from coop_pin.base.errors import FieldError, ScenarioError
from coop_pin.description.controller import PackageLaw
from coop_pin.simulation.build_controller import build_controller
from coop_pin.stability import steady_errors
from coop_pin.viz.live.panel import gain_sliders

KINDS = [law.model_fields["kind"].default for law in get_args(PackageLaw)]
SURFACE = {"pose_gain": 2.0, "sign_gain": 0.1, "transient_rate": 5.0}
GAINS = {
    "sliding-mode": SURFACE | {"damping_gain": 20.0},
    "sliding-mode-redundant": SURFACE | {"damping_gain": 20.0},
    "payload-space": SURFACE | {"sliding_gain": 400.0},
    "mean-pose": SURFACE | {"sliding_gain": 400.0},
    "symmetric": SURFACE | {"sliding_gain": 400.0},
}
UNSTABLE = {
    "sliding-mode": {"gains.force_gain": 1.5},
    "sliding-mode-redundant": {"gains.force_gain": 1.5},
    "leader-follower": {"gains.admittance_damping": 0.5},
    "prescribed-performance": {"gains.velocity_floor": 0.0},
    "admittance": {"gains.admittance_damping": 0.0},
}
"""Changes that each kind refuses; the others have an anchor, which is unstable from 2 on."""
WITHOUT_BOUND = ("prescribed-performance", "admittance")
"""Kinds that refuse what is no gain at all."""
ON_SERVOS = {"admittance": {"actuators.servo": {"command": "velocity", "rate_hz": 80.0}}}


def scenario_of(kind, **changes):
    law = {"kind": kind, "gains": GAINS.get(kind, {}), "force_path": {"kind": "late"}}
    return SCENARIOS["planar"]().override(
        {"controller": law, "events": [], "sensors.wrist": {}, **ON_SERVOS.get(kind, {})} | changes
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_refuses_gains_and_says_where(kind):
    for path, value in UNSTABLE.get(kind, {"gains.anchor_gain": 2.5}).items():
        with pytest.raises(FieldError) as refused:
            scenario_of(kind, **{f"controller.{path}": value})
        assert refused.value.path == f"controller.{path}"
        if kind not in WITHOUT_BOUND:
            assert scenario_of(kind, beyond_bound=True, **{f"controller.{path}": value})
    with pytest.raises(ScenarioError):
        scenario_of(kind, **{"controller.gains.no_such_gain": 1.0})


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_sliders_whose_ends_are_gains_that_it_takes(kind):
    scenario = scenario_of(kind)
    sliders = gain_sliders(scenario)
    assert {slider.field.rpartition(".")[2] for slider in sliders} == set(scenario.controller.active_gains)
    assert sliders
    for slider in sliders:
        assert slider.low < slider.high
        assert slider.low <= slider.value <= slider.high
        assert scenario.override({slider.field: slider.field_value(slider.value)}).controller == (
            scenario.controller.replace(gains=scenario.controller.gains.replace(**own_leak(slider)))
        )


def own_leak(slider):
    """The leak is written down by its slider; other gains stay what they are."""
    return {"leak": slider.value} if slider.field.endswith("leak") else {}


def test_a_users_class_has_no_sliders():
    law = cp.UserController(target="nowhere:Nothing")
    assert law.active_gains == {}
    assert gain_sliders(SCENARIOS["planar"]().replace(controller=law)) == ()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_says_what_it_needs_and_what_it_leaves(kind):
    scenario = scenario_of(kind)
    law = scenario.controller
    assert ("internal wrench" in law.needs) <= law.force_path.measures
    blind = law.replace(force_path={"kind": "none"})
    assert "internal wrench" not in blind.needs
    if kind in ON_SERVOS:  # steady errors refuse it by name
        assert build_controller(scenario)
        return
    found = steady_errors(scenario)
    assert found.wrenches == (2 if {"internal wrench", "wrenches of all arms"} & {*law.needs} else 0)
    assert ("no model" in found.summary()) == (not {"model", "regressor"} & {*law.needs})
    assert found.delay >= 0 or math.isinf(found.delay)
    if kind != "torque-qp":  # an extra
        assert build_controller(scenario)


def test_the_law_is_the_one_of_a_kind_for_each_arm():
    """Decentralised laws of any kind take gains of single arms, and zero at grasp."""
    law = {
        "kind": "prescribed-performance",
        "arm_gains": {"right": {"pose_gain": 2e-3}},
        "zero_at_grasp": True,
    }
    laws = build_controller(SCENARIOS["planar"]().override({"controller": law})).controllers
    assert [law.law.gains.pose_gain[0] for law in laws.values()] == [1e-3, 2e-3]
    with pytest.raises(FieldError):
        SCENARIOS["planar"]().override({"controller": law | {"arm_gains": {"nobody": {}}}})


def test_prescribed_performance_sags_as_steady_errors_say():
    gains = {"funnel_rate": 10.0, "pose_gain": 5e-4, "velocity_gain": [4.0, 4.0, 0.3]}
    push = {"kind": "wrench-pulse", "time": 0.1, "duration": 2.4, "wrench": [3.0, 0, 0, 0, 0, 0]}
    law = stated("prescribed-performance", **gains)
    carried = {"actuators.gravity_compensation": {}}
    scenario = still("planar", law, rate=500.0, duration=2.5, events=[push], **carried)
    sag = cp.run(scenario, warn=False, engine="compiled").data.pose_error.values[-1, 0]
    assert_allclose(steady_errors(scenario, load=3.0).sag, sag, rtol=0.03)
