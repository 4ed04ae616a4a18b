"""Learned stiffness: spring and damper of a law as functions of the load's mass, learnt from rewards."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

LEARNT, LOADS = "stiffness learnt from rewards tracks better", "it does so over loads of different mass"
SEEN, UNSEEN = (2.0, 5.0, 11.0, 22.0), (3.0, 8.0, 16.0)
FIXED, BY_MASS = np.array([1.0, 0.0, 1.0, 0.0]), np.ones(4)
"""Entries of a policy that are learnt: log gamma and log K at 7 kg, each with its change by log mass."""


def costs(cell: cp.Scenario, policies: Array, masses: tuple[float, ...], seed: int) -> tuple[Array, Array]:
    """Return tracking in mm and cost, mm + 0.2 N of internal force, of each policy and mass."""
    runs: list[Any] = []
    for policy in policies:
        for mass in masses:
            spring, damper = np.exp(np.clip(policy.reshape(2, 2) @ [1.0, np.log(mass / 7.0)], -3.0, 3.0))
            gains = {
                "pose_gain": 2.0 * spring,
                "sliding_gain": (800.0 * damper, 800.0 * damper, 40.0 * damper),
            }
            load = {"mass": mass, "inertia": tuple(mass / 11.2 * np.array(cell.cell.payload.inertia))}
            changes = {f"controller.gains.{name}": value for name, value in gains.items()}
            changes |= {f"cell.payload.{name}": value for name, value in load.items()}
            runs.append(cell.override(changes | {"seed": seed + len(runs) % len(masses)}))
    metrics = cp.compiled.simulate_batch(runs).metrics()
    names = ("moving_position_rms_m", "moving_internal_axial_rms_error_N")
    track, force = (np.array([run.get(name, np.nan) for run in metrics]) for name in names)
    shape = len(policies), len(masses)
    track = np.minimum(np.nan_to_num(1e3 * track, nan=1e3), 1e3).reshape(shape)
    return track, track + 0.2 * np.nan_to_num(force, nan=5e3).reshape(shape)


def learn(cell: cp.Scenario, free: Array, generations: int) -> tuple[Array, Array]:
    """Return the policy that the cross-entropy method finds, and the least cost of each generation."""
    rng, mean, spread, best = np.random.default_rng(0), np.zeros(4), 0.7 * free, []
    for _ in range(generations):
        policies = mean + spread * rng.standard_normal((16, 4))
        cost = costs(cell, policies, SEEN, 0)[1].mean(axis=1)
        chosen = policies[np.argsort(cost)[:4]]
        mean, spread = chosen.mean(axis=0), chosen.std(axis=0) + 0.02 * free
        best.append(cost.min())
    return mean, np.array(best)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Learn one stiffness for all loads and one by mass; try both, and the first gains, on unseen loads."""
    policies, curves = [np.zeros(4)], []
    for label, free in {"one stiffness": FIXED, "stiffness by mass": BY_MASS}.items():
        policy, best = learn(cell, free, 3 if short else 12)
        policies.append(policy)
        curves.append(Trace(label, np.arange(1.0, len(best) + 1.0), best))
    track, cost = costs(cell, np.array(policies), UNSEEN, 100)
    ratio, part = 100 * track[2] / track[0], 100 * cost[2].mean() / cost[1].mean()
    by_mass = {f"{mass:g} kg: error, of that of the first gains": k for k, mass in enumerate(UNSEEN)}
    return [
        Measured(LEARNT, "mean error, of that of the first gains", ratio.mean(), "%", most=50.0),
        *(Measured(LOADS, text, ratio[k], "%", most=50.0) for text, k in by_mass.items()),
        Measured(LOADS, "by mass: cost, of that of one stiffness", part, "%", most=100.0),
    ], curves
