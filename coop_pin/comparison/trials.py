"""Trials: named sets of changes under which controllers are compared."""

from __future__ import annotations

import contextlib
import math
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.base.errors import FieldError
from coop_pin.description.cell.contact import PRESSES, PatchGrasp
from coop_pin.description.scenario import Scenario
from coop_pin.design.tuning_rule import force_path_of
from coop_pin.feasibility.least_squeeze import with_enough_squeeze
from coop_pin.model.transmission import friction

_NO_FRICTION = 1e-9
"""Friction is scaled by it rather than by 0, so that a model with the nominal friction is a factor away."""
_RATES_HZ = (80.0, 250.0, 1000.0)
_TINY = 1e-3
"""Radius with which faces are looked for, m."""
_PALM_MU, _PALM_RADIUS, _PALM_RATE_HZ = 0.6, 0.03, 1000.0
"""Friction of palms, their largest radius, m, and least control rate: each arm alone needs a high one."""
BENCHMARK = (
    "adept-anchored",
    "two-pandas-box",
    "panda-ur5-bar",
    "three-ur5-plate",
    "kinova-pair",
    "five-joint-pair",
)
"""Scenarios of the benchmark: arms of 3, 5, 6 and 7 joints, like and unlike, two and three of them."""


class Trial(NamedTuple):
    """A trial.

    Attributes:
        changes: fields of the scenario, by dotted path. What a model must not know is an event or an error:
            models are built from the scenario's cell.
        random: whether anything in it is; it then runs once for each seed.
        friction: factor on the friction of all arms, of which no model knows.
    """

    changes: dict[str, Any]
    random: bool = False
    friction: float = 1.0


@typed
def benchmark_scenario(scenario: Scenario, duration: float | None = None) -> Scenario:
    """Return a scenario as all controllers meet it.

    It has no events, an ideal wrist sensor on every arm, and robots that carry their own weight.

    Args:
        scenario: cell, motion and squeeze.
        duration: s; the scenario's own when None.
    """
    changes: dict[str, Any] = {"events": [], "sensors": {"wrist": {}}, "arm_sensors": {}, "arm_actuators": {}}
    if any(scenario.cell.gravity):
        changes["actuators.gravity_compensation"] = {}
    if duration is not None:
        changes["duration"] = duration
    return scenario.override(changes)


@typed
def standard_trials(scenario: Scenario) -> dict[str, Trial]:
    """Return the standard trials of a benchmark scenario by name.

    The first arm is the one with a bias, the last one loses its torque, or its commands: then the robot goes
    on to carry its own weight. The push is the payload's weight on
    Earth for a fifth of a second. Cells without friction have no friction trials. Where all grasps lie on
    flat faces of the payload, palms hold it by friction alone in one, with at least 1.5 times the least
    squeeze: whether they drop it is an outcome.

    Args:
        scenario: scenario, as of ``benchmark_scenario``.
    """
    arms, mass, half = list(scenario.cell.arms), scenario.cell.payload.mass, scenario.duration / 2.0
    change, push = (
        {"kind": "payload-change", "time": 0.0},
        9.81 * mass * np.array([2.0, 1.0, 0.0, 0.0, 0.0, 0.0]) / math.sqrt(5.0),
    )
    error, wrist = f"cell.arms.{arms[0]}.calibration_error", "sensors.wrist"
    pulse = {"kind": "wrench-pulse", "time": half, "duration": 0.2, "wrench": push.tolist()}
    noise = {
        wrist: {"noise": {"force": 1.0, "moment": 0.05}},
        "sensors.encoder": {"resolution": 1e-5, "noise": 1e-5},
    }
    last, drives = f"arm_actuators.{arms[-1]}", scenario.actuators
    rubbing = any(
        joints.viscous.any() or joints.coulomb.any()
        for joints in (friction(arm, name) for name, arm in scenario.cell.arms.items())
    )
    return {
        "nominal": Trial({}),
        **{
            f"mass x{factor:g}": Trial({"events": [change | {"mass": factor * mass}]})
            for factor in (0.5, 2.0)
        },
        **(
            {"friction x0": Trial({}, friction=0.0), "friction x3": Trial({}, friction=3.0)}
            if rubbing
            else {}
        ),
        "push": Trial({"events": [pulse]}),
        **({"held by palms": Trial(palms)} if (palms := _palms(scenario)) else {}),
        "bias 0.1 mm": Trial({f"{error}.tip.xyz": [1e-4, 0.0, 0.0]}),
        "bias 1 mm": Trial({f"{error}.tip.xyz": [1e-3, 0.0, 0.0]}),
        "base turned by 1 mrad": Trial({f"{error}.base.rpy": [0.0, 0.0, 1e-3]}),
        "noise": Trial(noise, random=True),
        "wrench 1 tick late": Trial({f"{wrist}.delay": 1}),
        "wrench 3 ticks late": Trial({f"{wrist}.delay": 3}),
        **{f"{rate:g} Hz": Trial(_rate(scenario, rate)) for rate in _RATES_HZ},
        "wrist lost at half time": Trial({f"{wrist}.lost": [[half, scenario.duration]]}),
        "torque of an arm lost": Trial({last: drives.replace(torque_lost_at=half).model_dump()}),
        "commands of an arm lost": Trial({last: drives.replace(commands_lost_at=half).model_dump()}),
    }


def friction_changes(scenario: Scenario, factor: float) -> dict[str, Any]:
    """Return the changes that scale the friction of all arms."""
    changes = {}
    for name, arm in scenario.cell.arms.items():
        coefficients = friction(arm, name)
        changes[f"cell.arms.{name}.friction"] = {
            "viscous": (factor * coefficients.viscous).tolist(),
            "coulomb": (factor * coefficients.coulomb).tolist(),
            "coulomb_velocity": coefficients.coulomb_velocity,
            "stiction": (factor * (coefficients.coulomb + coefficients.excess)).tolist(),
            "stribeck_velocity": coefficients.stribeck_velocity,
        }
    return changes


def changes_of(scenario: Scenario, trial: Trial, controller: dict[str, Any]) -> dict[str, Any]:
    """Return all changes of a run: the controller, and the trial without what a model could know of it."""
    if trial.friction == 1.0:
        return {"controller": controller} | trial.changes
    factor = max(trial.friction, _NO_FRICTION)
    fields = controller.get("options", controller)
    if (model := fields.get("model")) is not None:
        changed = fields | {"model": model | {"friction": model.get("friction", 1.0) / factor}}
        controller = controller | {"options": changed} if "options" in controller else changed
    return friction_changes(scenario, factor) | {"controller": controller} | trial.changes


def _palms(scenario: Scenario) -> dict[str, Any]:
    """Return the changes to patches in place of all grasps; none where one is not on a flat face."""
    cell, grasps = scenario.cell, dict[str, PatchGrasp]()
    for name, grasp in cell.grasps.items():
        for press in PRESSES:
            palm = PatchGrasp(xyz=grasp.xyz, rpy=grasp.rpy, mu=_PALM_MU, radius=_TINY, press=press)
            with contextlib.suppress(FieldError):
                edge = float(np.abs(palm.bounds(cell.payload)).min())
                grasps[name] = palm.replace(radius=min(_PALM_RADIUS, edge))
    if len(grasps) < len(cell.arms) or not any(cell.gravity):
        return {}
    held = scenario.override({"cell.grasps": grasps, "cell.pads": {}, "plant.payload": "free"})
    law = held.controller.replace(force_path=force_path_of(held))
    squeeze, _ = with_enough_squeeze(held.replace(controller=law))
    return {
        "cell.grasps": {name: grasp.model_dump() for name, grasp in grasps.items()},
        "cell.pads": {},
        "plant.payload": "free",
        "squeeze": squeeze.squeeze.model_dump(),
        **_rate(scenario, max(_PALM_RATE_HZ, scenario.clock.rate_hz)),
    }


def _rate(scenario: Scenario, rate_hz: float) -> dict[str, Any]:
    """Return the changes to another control rate, with integration steps no longer than before."""
    clock = scenario.clock
    steps = math.ceil(clock.steps_per_tick * clock.rate_hz / rate_hz - 1e-9)
    return {"clock.rate_hz": rate_hz, "clock.steps_per_tick": max(1, steps)}
