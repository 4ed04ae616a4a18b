"""Random grasps and events, most of them nonsense: each run ends in a typed error or in finite numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from cells import SCENARIOS
from compliant_cells import anchored

import coop_pin as cp
from coop_pin.base.errors import CoopPinError

NUMBERS = (-1.0, 0.0, 1e-300, 0.004, 0.008, 0.012, 1.0, 1e300, math.nan, math.inf, "x", None, True)
SENSIBLE = {
    "release": {"retreat": 0.01, "retreat_time": 0.01},
    "hand-over": {"duration": 0.004, "retreat": 0.01, "retreat_time": 0.01},
    "grasp": {"duration": 0.004, "tolerance": 0.05, "approach_time": 0.004, "wait": 0.0},
    "lose-arm": {"form": "braked"},
    "partner": {"duration": 0.005, "stiffness": (300.0,) * 6, "damping": (10.0,) * 6},
}
"""Fields of each kind of event with which it can happen."""
OTHERS: dict[str, tuple[Any, ...]] = {
    "arm": ("left", "right", "nobody", "", 3, None),
    "rest": ("found", "nominal", "nothing"),
    "form": ("limp", "braked", "own weight", "lost"),
    "stiffness": ((300.0,) * 6, (-1.0,) * 6, (0.0,) * 6, (1e12,) * 6, (math.nan,) * 6, (1.0,), "none"),
    "damping": ((10.0,) * 6, (-1.0,) * 6, (1e12,) * 6, 3.0),
    "motion": ({"kind": "hold", "pose": {}}, {"kind": "hold"}, {"kind": "nothing"}, 3),
    "handle": ({"xyz": (0.1, 0.0, 0.0)}, {"xyz": (1e300, 0.0, 0.0)}, {"xyz": (0.1,)}),
    "nonsense": (1, {}),
}
"""Values of fields that are no numbers."""


def any_of(rng: np.random.Generator, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def random_event(rng: np.random.Generator, scenario: cp.Scenario, after: bool) -> dict[str, Any]:
    """An event that can happen, of which fields are replaced now and then."""
    kinds = tuple(kind for kind in SENSIBLE if after or kind != "grasp")
    kind = any_of(rng, kinds)
    event: dict[str, Any] = {
        "kind": kind,
        "time": 1e-3 * int(rng.integers(9, 14) if after else rng.integers(1, 5)),
        **SENSIBLE[kind],
    }
    event |= {"motion": {"kind": "hold", "pose": scenario.start}} if kind == "partner" else {"arm": "right"}
    while rng.random() < 0.12:
        field = any_of(rng, (*event, "nonsense"))
        event[field] = any_of(rng, OTHERS.get(field, NUMBERS))
    return event


def random_grasp(rng: np.random.Generator, grasp: cp.Pose) -> dict[str, Any]:
    fields: dict[str, Any] = {"xyz": grasp.xyz, "rpy": grasp.rpy}
    if rng.random() < 0.6:
        fields |= {
            "kind": "compliant",
            "stiffness": any_of(rng, OTHERS["stiffness"] if rng.random() < 0.15 else ("paper", "firm")),
        }
        if rng.random() < 0.15:
            fields[any_of(rng, ("damping_ratio", "damping"))] = any_of(rng, NUMBERS)
    return fields


def outcome(seed: int) -> str:
    """How a random run ends: "refused", "ends" with a typed error, or "finite"; anything else is raised."""
    rng = np.random.default_rng(seed)
    base = anchored(any_of(rng, tuple(SCENARIOS)))
    grasps = {f"cell.grasps.{name}": random_grasp(rng, grasp) for name, grasp in base.cell.grasps.items()}
    events = [random_event(rng, base, bool(after)) for after in range(int(rng.integers(1, 4)))]
    changes = {"plant.payload": any_of(rng, ("free", "free", "welded")), "duration": 0.02}
    try:
        scenario = base.override(grasps | changes | {"events": events})
    except CoopPinError:
        return "refused"
    try:
        result = cp.run(scenario, warn=False)
        result.summary()
    except CoopPinError:
        return "ends"
    data = result.data
    for name in ("configuration", "velocity", "kinetic_energy", "work_payload_change"):
        assert np.isfinite(data[name].values).all(), (seed, name)
    return "finite"


def count(seeds: range) -> dict[str, int]:
    ends = [outcome(seed) for seed in seeds]
    return {end: ends.count(end) for end in ("refused", "ends", "finite")}


def test_sixty_random_grasps_and_events_end_in_typed_errors_or_finite_numbers():
    found = count(range(60))
    print(f"\n{found}")
    assert found["refused"] > 20
    assert found["finite"] > 3


@pytest.mark.slow
def test_two_thousand_random_grasps_and_events_end_in_typed_errors_or_finite_numbers():
    print(f"\n{count(range(100, 2100))}")
