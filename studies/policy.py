"""A learned policy against PD on the internal force: both change the squeeze of a law without a force sensor.

The law of ``adept-anchored`` without anchor and force path, with a kinematic bias of each lane of up to 1 mm,
is asked for another squeeze every 4 ticks by what observes the true internal wrench. PD has a gain of error
and of its change for each task row, 6 numbers; the policy is a network of 9 inputs, 8 tanh units and 3
outputs, 107 numbers, which sees the same and the payload's pose error. Both are found by the cross-entropy
method with the same budget: 64 candidates of 16 lanes, 40 generations, runs of 3 s. The cost is the weighted
error of the second half of a run, of 64 other biases.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import coop_pin as cp
from coop_pin.gym import Task, VectorCellEnv

CELL, CANDIDATES, LANES, GENERATIONS, DURATION, BIAS = "adept-anchored", 64, 16, 40, 3.0, 1e-3
UNSEEN, SEEDS, ELITE = 64, (0, 1, 2), 8
TASK = Task(
    "squeeze",
    scale=20.0,
    ticks=4,
    rewards={"internal_axial_error_N": 1.0, "internal_shear_error_N": 1.0, "internal_moment_error_Nm": 10.0},
)
ROWS = [0, 1, 5]
Law = Callable[[np.ndarray, np.ndarray], np.ndarray]
TABLE = Path(__file__).parent / "policy.csv"


def scenario(bias: np.ndarray) -> cp.Scenario:
    """Return the cell with a displacement of the left arm's own kinematics, m, shape (2,)."""
    changes = {
        "controller.force_path": {"kind": "none"},
        "controller.gains.anchor_gain": 0.0,
        "cell.arms.left.calibration_error.base.xyz": (*bias.tolist(), 0.0),
        "events": (),
        "duration": DURATION,
    }
    return cp.Scenario.load(CELL, changes)


def biases(count: int, seed: int) -> np.ndarray:
    """Return displacements of any direction and of up to BIAS, m, shape (count, 2)."""
    rng = np.random.default_rng(seed)
    angle, size = rng.uniform(0.0, 2.0 * np.pi, count), BIAS * np.sqrt(rng.uniform(0.0, 1.0, count))
    return np.column_stack((size * np.cos(angle), size * np.sin(angle)))


def nothing(_numbers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return no action."""
    return np.zeros((len(seen), 3))


def pd(numbers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return actions of PD, numbers of shape (lanes, 6)."""
    return -numbers[:, :3] * seen[:, :3] - numbers[:, 3:] * seen[:, 3:6]


def policy(numbers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return actions of the network, numbers of shape (lanes, 107)."""
    W, b = numbers[:, :72].reshape(-1, 8, 9), numbers[:, 72:80]
    V, c = numbers[:, 80:104].reshape(-1, 3, 8), numbers[:, 104:]
    hidden = np.tanh(np.einsum("lij,lj->li", W, seen) + b)
    return np.einsum("lij,lj->li", V, hidden) + c


SIZES = {nothing: 0, pd: 6, policy: 107}


def scores(env: VectorCellEnv, act: Law, numbers: np.ndarray) -> np.ndarray:
    """Return the mean reward of the second half of the actions of each lane."""
    observation, _ = env.reset()
    before, rewards, is_last = np.zeros((env.num_envs, 3)), list[np.ndarray](), False
    while not is_last:
        error = observation[:, -12:-6][:, ROWS] / TASK.scale
        pose = 1e3 * observation[:, 12:18][:, ROWS]
        action = act(numbers, np.column_stack((error, error - before, pose)))
        observation, reward, _, truncated, _ = env.step(action)
        before = error
        rewards.append(reward)
        is_last = truncated.any()
    return np.mean(rewards[len(rewards) // 2 :], axis=0)


def search(env: VectorCellEnv, act: Law, seed: int) -> np.ndarray:
    """Return the numbers that the cross-entropy method ends with, its mean."""
    rng, size = np.random.default_rng(seed), SIZES[act]
    mean, spread = np.zeros(size), np.full(size, 0.3)
    for _ in range(GENERATIONS):
        candidates = mean + spread * rng.normal(size=(CANDIDATES, size))
        score = scores(env, act, candidates.repeat(LANES, axis=0)).reshape(CANDIDATES, LANES).mean(axis=1)
        best = candidates[np.argsort(-score)[:ELITE]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.01
    return mean


def main() -> None:
    """Search, score and write the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    cells = [scenario(bias) for bias in biases(LANES, 0)]
    train = VectorCellEnv(cells * CANDIDATES, TASK)
    test = VectorCellEnv([scenario(bias) for bias in biases(UNSEEN, 1)], TASK)
    rows = []
    for act in SIZES:
        for seed in SEEDS if SIZES[act] else (0,):
            began = time.process_time()
            numbers = search(train, act, seed) if SIZES[act] else np.zeros(0)
            cost = -scores(test, act, np.tile(numbers, (UNSEEN, 1)))
            seconds = time.process_time() - began
            rows.append((act.__name__, seed, SIZES[act], cost.mean(), cost.max(), seconds))
            print(
                "{:8} seed {}  {:3} numbers  cost {:8.3f} mean {:8.3f} worst  {:.0f} s".format(*rows[-1]),
                flush=True,
            )
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("law", "seed", "numbers", "mean_cost", "worst_cost", "seconds"))
        table.writerows((*row[:3], *(f"{value:.4g}" for value in row[3:])) for row in rows)


if __name__ == "__main__":
    main()
