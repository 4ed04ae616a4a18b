"""Human partner: arms that feel only their own wrists follow a person who leads the box at a handle."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.zoo.reproduction import Measured, Trace

DECIDES, BEAR = "the person decides the path", "the robots bear the load"
ALONE = "the robots need no messages"
WAITS = 0.5
"""Time before the person takes hold, in which a wrist's load is averaged, s."""


class Follower(cp.ArmController):
    """M V' + D V = F - F_0, with the wrist's mean wrench F_0 before anybody takes hold."""

    command_kind = "velocity"

    def __init__(self, damping: float, period: float, mass: float = 4.0) -> None:
        rows = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
        self.decay, self.damping = np.exp(-damping / mass * period), damping * rows

    def init(self, measurement: Any, reference: Any) -> Any:
        """Return velocity, sum of wrenches and their number."""
        return np.zeros(6), np.zeros(6), 0

    def step(self, measurement: Any, reference: Any, state: Any) -> Any:
        """Return joint velocities."""
        (V, total, count), F = state, measurement.interaction_wrench
        if measurement.time < WAITS:
            total, count = total + F, count + 1
        else:
            V = self.decay * V + (1 - self.decay) * (F - total / count) / self.damping
        velocity = np.linalg.pinv(measurement.payload_jacobian) @ V
        return cp.ArmCommand(velocity=velocity, state=(V, total, count))


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Lead the box with arms that yield, and with arms that hold."""
    numbers, curves, seconds, weight = [], [], 3.5 if short else 6.0, 9.81 * cell.cell.payload.mass
    hand, start = cell.events[0].motion, np.array(cell.start.xyz)
    led = cell.override({"duration": seconds, "events.0.duration": seconds - WAITS})
    for label, damping in (("yield", 45.0), ("hold", 1e5))[: 1 if short else 2]:
        law = cp.laws.DecentralisedController(
            {arm: Follower(damping, cell.clock.period) for arm in cell.cell.arms}
        )
        data = cp.simulate(led, law).data
        way = np.linalg.norm(data.payload_position.values - start, axis=1)
        curves.append(Trace(f"arms that {label}", data.time.values, 1e3 * way))
        goal = np.array(hand.goal.xyz)
        left = float(np.linalg.norm(data.payload_position.values[-1] - goal))
        done = 100.0 * (1.0 - left / float(np.linalg.norm(goal - start)))
        limits = {"most": 10.0} if label == "hold" else {"least": 50.0 if short else 90.0}
        numbers.append(Measured(DECIDES, f"arms {label}: done of the way", done, "%", **limits))
        if label == "yield":
            force = 100.0 * np.abs(data.external_wrench.values) / weight
            up, aside = force[:, 2].max(), np.hypot(force[:, 0], force[:, 1]).max()
            apart = 100.0 * np.linalg.norm(data.internal_wrench.values[..., :3], axis=-1).max() / weight
            numbers += [
                Measured(BEAR, f"arms {label}: person up or down", up, "% weight"),
                Measured(BEAR, f"arms {label}: person sideways", aside, "% weight"),
                Measured(ALONE, f"arms {label}: internal force", apart, "% weight", most=10.0),
            ]
    path = [1e3 * np.linalg.norm(hand.at(t).X_WP_d[:3, 3] - start) for t in curves[0].x]
    return numbers, [*curves, Trace("the person's hand", curves[0].x, np.array(path), dashed=True)]
