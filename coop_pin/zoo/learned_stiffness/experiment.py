"""Learned stiffness: spring and damper of a law as functions of the load's mass, learnt from rewards."""

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

LEARNT, LOADS = "stiffness learnt from rewards tracks better", "it does so over loads of different mass"
ADAPTS = "the stiffness adapts to the load"
INTEGRAL = {"controller.gains.sign_gain": 0.507, "controller.gains.anchor_gain": 0.5}
SEEN, UNSEEN = (2.0, 5.0, 11.0, 22.0), (3.0, 8.0, 16.0)
FIXED, BY_MASS = np.array([1.0, 0.0, 1.0, 0.0]), np.ones(4)
"""Entries of a policy that are learnt: log gamma and log K at 7 kg, each with its change by log mass."""


def costs(
    cell: cp.Scenario, policies: Array, masses: tuple[float, ...], seed: int, **law: float
) -> tuple[Array, Array]:
    """Return tracking in mm and cost, mm + 0.2 N of internal force, of each policy and mass."""
    runs: list[cp.Scenario] = []
    for policy in policies:
        for mass in masses:
            spring, damper = np.exp(np.clip(policy.reshape(2, 2) @ [1.0, np.log(mass / 7.0)], -3.0, 3.0))
            changes = {
                "controller.gains.pose_gain": cell.controller.gains.pose_gain * spring,
                "controller.gains.sliding_gain": tuple(damper * np.array(cell.controller.gains.sliding_gain)),
                "cell.payload.mass": mass,
                "cell.payload.inertia": tuple(mass / 11.2 * np.array(cell.cell.payload.inertia)),
                "seed": seed + len(runs) % len(masses),
            }
            runs.append(cell.override(changes | law))
    metrics = cp.compiled.simulate_batch(runs).metrics()
    names = ("moving_position_rms_m", "moving_internal_axial_rms_error_N")
    track, force = (np.array([run.get(name, np.nan) for run in metrics]) for name in names)
    track = np.minimum(np.nan_to_num(1e3 * track, nan=1e3), 1e3).reshape(len(policies), -1)
    return track, track + 0.2 * np.nan_to_num(force, nan=5e3).reshape(track.shape)


def learn(cell: cp.Scenario, mean: Array, free: Array, generations: int) -> tuple[Array, Array]:
    """Return the policy that the cross-entropy method finds from one, and each generation's least cost."""
    rng, spread, best = np.random.default_rng(0), 0.7 * free, []
    for _ in range(generations):
        policies = mean + spread * rng.standard_normal((16, 4))
        cost = costs(cell, policies, SEEN, 0)[1].mean(axis=1)
        chosen = policies[np.argsort(cost)[:4]]
        mean, spread = chosen.mean(axis=0), chosen.std(axis=0) + 0.02 * free
        best.append(cost.min())
    return mean, np.array(best)


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Learn one stiffness, then go on with it and by mass; try them and suggest's gains on unseen loads."""
    half = 2 if short else 15
    start, before = learn(cell, np.zeros(4), FIXED, half)
    policies, curves = [np.zeros(4)], []
    for label, free in {"one stiffness": FIXED, "stiffness by mass": BY_MASS}.items():
        policy, best = learn(cell, start, free, half)
        policies.append(policy)
        curves.append(Trace(label, np.arange(1.0, 2 * half + 1.0), np.concatenate([before, best])))
    track, cost = costs(cell, np.array([*policies, policies[2] * FIXED]), UNSEEN, 100)
    anchored = costs(cell, np.zeros((1, 4)), UNSEEN, 100, **INTEGRAL)[0].mean()
    part, error, paid = 100 * track / track[0], track.mean(axis=1), cost.mean(axis=1)
    tracked, price = error[2] / min(error[1], error[3]), paid[2] / min(paid[1], paid[3])
    return [
        Measured(LEARNT, "one stiffness: error, of that as set", part[1].mean(), "%", most=100.0),
        Measured(LEARNT, "as set with its integral, of that without", 100 * anchored / error[0], "%"),
        *(
            Measured(LOADS, f"{mass:g} kg, by mass: error, of that as set", part[2, k], "%", most=100.0)
            for k, mass in enumerate(UNSEEN)
        ),
        Measured(ADAPTS, "by mass: error, of the best constant's", 100 * tracked, "%"),
        Measured(ADAPTS, "by mass: cost, of the best constant's", 100 * price, "%"),
    ], curves
