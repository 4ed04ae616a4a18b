"""Test cells with compliant grasps, and states and mass matrices of their chains."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
from cells import ANCHORED, SCENARIOS

import coop_pin as cp
from coop_pin.grasps import CellChain

UNEVEN = (3e4, 5e4, 2e4, 300.0, 200.0, 450.0)

STABLE_ALONE = {
    "planar": {
        "controller.gains.sliding_gain": (100.0, 100.0, 1.0),
        "controller.gains.sign_gain": 0.02,
        "controller.gains.pose_gain": 0.5,
    },
    "spatial": {
        "clock.rate_hz": 1000.0,
        "clock.steps_per_tick": 1,
        "controller.gains.anchor_gain": 0.02,
    },
}
"""Changes with which each arm alone is stable, so that no stiffness makes the gains too large."""


def with_grasps(scenario: cp.Scenario, stiffness=UNEVEN, arms=None, **fields) -> cp.Scenario:
    """The scenario with compliant grasps."""
    grasps = {
        name: cp.CompliantGrasp(xyz=grasp.xyz, rpy=grasp.rpy, stiffness=stiffness, **fields)
        if arms is None or name in arms
        else grasp
        for name, grasp in scenario.cell.grasps.items()
    }
    return scenario.replace(cell=scenario.cell.replace(grasps=grasps))


@cache
def anchored(name: str) -> cp.Scenario:
    """A short run of the anchored law, with gains that hold at every stiffness, without events."""
    scenario = SCENARIOS[name]().replace(controller=ANCHORED[name], events=())
    return scenario.override(STABLE_ALONE[name] | {"duration": 0.2})


def moved(chain: CellChain, X_WP: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A state near the one at which a chain holds its payload, with deflected grasps."""
    rng, model = np.random.default_rng(seed), chain.mechanism.model
    q = pin.integrate(model, chain.configuration(X_WP), 1e-2 * rng.normal(size=model.nv))
    return q, rng.normal(size=model.nv)


def mass_matrix(chain: CellChain, q: np.ndarray) -> np.ndarray:
    """M(q), full."""
    upper = np.triu(pin.crba(chain.mechanism.model, chain.mechanism.model.createData(), q))
    return upper + np.triu(upper, 1).T
