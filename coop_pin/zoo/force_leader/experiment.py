"""Leader and followers by motion alone: the object's motion tells each robot the sum of all forces."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace

K, GOAL = 0.5, (2.0, 1.0)
ALIGN, GROWS = "forces align by the object's motion alone", "the rate grows in proportion to the robots"
STEERS = "a small force of a leader steers the group"


class ForceFollower(cp.ArmController):
    """F <- F + T k (M vdot + b v - N F), by the object's motion; a leader's F is bounded PD to the goal."""

    def __init__(
        self, T: float, N: int, force: Any = (0.0, 0.0), *, k: float = K, leads: bool = False
    ) -> None:
        self.T, self.N, self.force, self.k, self.leads = T, N, np.array(force), k, leads

    def init(self, measurement: Any, reference: Any) -> Any:
        """Return the force and the velocity before."""
        return self.force, measurement.payload_twist[:2]

    def step(self, measurement: Any, reference: Any, state: Any) -> Any:
        """Return the forces of the slides."""
        (force, before), v, N, T = state, measurement.payload_twist[:2], self.N, self.T
        if self.leads:
            force = np.clip(GOAL - measurement.payload_pose[:2, 3] - 2.0 * v, -2.0, 2.0)
        elif measurement.time > 0.0:
            total = (10.0 + 1.02 * N) * (v - before) / T + 4.0 * N * (v + before) / 2
            force = force + T * self.k * (total - N * force)
        return cp.ArmCommand(np.append(force, 0.0), (force, v))


def ring(cell: Any, laws: list[Any], changes: dict[str, Any]) -> Any:
    """Return the record of a run of robots around an object, each a copy of the cell's first."""
    turns = 2 * np.pi * np.arange(len(laws)) / len(laws)
    grasps = {f"r{k}": cp.Pose(xyz=(0.6 * np.cos(a), 0.6 * np.sin(a), 0.0)) for k, a in enumerate(turns)}
    parts = {"cell.arms": dict.fromkeys(grasps, cell.cell.arms["r0"]), "cell.grasps": grasps}
    law = cp.laws.DecentralisedController(dict(zip(grasps, laws, strict=True)))
    return cp.simulate(cell.override(parts | changes), law).data


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Let forces align in rings of robots, then let one robot lead three, and push alone."""
    numbers, curves, rng, T = [], [], np.random.default_rng(0), cell.clock.period
    for n in (4, 8) if short else (4, 8, 16):
        laws, rate = [ForceFollower(T, n, force) for force in rng.normal(0.0, 5.0, (n, 2))], n * K
        data = ring(cell, laws, {"duration": 4.0 / rate})
        t, F = data.time.values, data.torque.values[..., :2]
        mean = F.mean(axis=1, keepdims=True)
        apart = np.linalg.norm(F - mean, axis=-1)
        angle = np.degrees(np.arcsin(apart[-1] / np.linalg.norm(F[-1], axis=-1)).max())
        moved = 100 * np.linalg.norm(mean - mean[0], axis=-1).max() / np.linalg.norm(mean[0])
        measured = -np.polyfit(t, np.log(np.linalg.norm(apart, axis=1)), 1)[0]
        numbers += [
            Measured(ALIGN, f"{n} robots: worst angle at N k t = 4", angle, "deg", most=10.0),
            Measured(ALIGN, f"{n} robots: mean force moved by", moved, "%", most=5.0),
            Measured(GROWS, f"{n} robots: rate over N k", measured / rate, "", 0.9, 1.1),
        ]
        y = np.linalg.norm(apart, axis=1) / np.linalg.norm(apart[0])
        curves += [Trace(f"{n} robots", t, y), Trace(f"exp(-{rate:g} t)", t, np.exp(-rate * t), dashed=True)]
    seconds, most = (12.0, 0.5) if short else (30.0, 0.05)
    for label, k, limits in (("with three", K, (3.6, 4.0)), ("alone", 0.0, ())):
        data = ring(cell, [ForceFollower(T, 4, k=k, leads=not i) for i in range(4)], {"duration": seconds})
        F, left = data.torque.values[..., :2].sum(axis=0), data.payload_position.values[-1, :2] - GOAL
        gain = float(np.linalg.norm(F.sum(axis=0)) / np.linalg.norm(F[0]))
        bound, off = most if limits else np.inf, float(np.linalg.norm(left))
        numbers += [
            Measured(STEERS, f"{label}: impulse of all over the leader's", gain, "", *limits),
            Measured(STEERS, f"{label}: left of 2.24 m", off, "m", most=bound),
        ]
    return numbers, curves
