"""Test cells with a law of the package or with servos, and what tests of laws read of a run."""

from __future__ import annotations

import numpy as np
from cells import SCENARIOS

import coop_pin as cp

OUTSIDE_GAINS = ("model", "tracking_weight", "friction_coefficient")


def stated(kind, **fields):
    """Changes that name a law of the package."""
    gains = {name: value for name, value in fields.items() if name not in OUTSIDE_GAINS}
    rest = {name: value for name, value in fields.items() if name in OUTSIDE_GAINS}
    return {"controller": {"kind": kind, "gains": gains, "force_path": {"kind": "late"}, **rest}}


def still(name, controller, *, step=0.0, rate=250.0, duration=0.5, **changes):
    """A test cell at rest, whose reference is a step away along x."""
    scenario = SCENARIOS[name]().replace(events=(), duration=duration)
    goal = scenario.start.model_dump()
    goal["xyz"] = [goal["xyz"][0] + step, *goal["xyz"][1:]]
    motion = {"kind": "hold", "pose": goal}
    return scenario.override(
        {"motion": motion, "clock.rate_hz": rate, "clock.steps_per_tick": 1} | controller | changes
    )


def force_error(result):
    """Internal-wrench error of the first arm over time, shape (n, 6)."""
    error = result.data.internal_wrench - result.data.desired_internal_wrench
    return np.nan_to_num(error.values[:, 0])


def servo_cell(name, kind, servo=None, **changes):
    """A test cell without friction whose arms have servos, on a line of 11 mm and 20 mrad in 0.5 s."""
    base = SCENARIOS[name]()
    start = base.start
    goal = start.replace(xyz=np.add(start.xyz, (0.01, -0.005, 0.0)), rpy=np.add(start.rpy, (0.0, 0.0, 0.02)))
    arms = {f"cell.arms.{arm}.friction": "none" for arm in base.cell.arms}
    return base.override(
        {
            "duration": 0.5,
            "events": [],
            "clock.rate_hz": 200.0,
            "clock.steps_per_tick": 5,
            "motion": cp.motions.LineMotion(start=start, goal=goal, duration=0.5),
            "controller": cp.laws.Admittance(command=kind),
            "actuators.servo": {"command": kind, "rate_hz": 1000.0, **(servo or {})},
            **arms,
            **changes,
        }
    )
