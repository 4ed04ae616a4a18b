"""Unknown load: each robot adapts its own estimates of load, friction and its own place."""

from typing import Any

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.force_leader.experiment import ring
from coop_pin.zoo.reproduction import Measured, Trace, off_path

FOLLOWS, BOUNDED = "the object follows its path", "all signals stay bounded"
APART = "estimates need not become true"
K_D = np.array([25.0, 25.0, 10.0])
GAINS = np.array([60.0, 15.0, 15.0, 3.0, 0.06, 0.06])  # of mass, inertia, two frictions, place


class Agent(cp.ArmController):
    """F = Y theta - K_d s, s = V - V_r, V_r = V_d - xtilde, at an estimated place; theta' = -G Y^T s."""

    def __init__(self, cell: cp.Scenario, *, adapts: bool) -> None:
        self.gains, self.cell = GAINS * adapts, cell
        self.kept: list[Array] = []

    def init(self, measurement: Any, reference: Any) -> Any:
        """Return the estimates: nothing is known."""
        return np.zeros(6)

    def step(self, measurement: Any, reference: Any, state: Any) -> Any:
        """Return force and moment at the robot; the estimates are also kept, to be read after the run."""
        V_r = reference.twist - self.cell.cell.task_rows.pose_error(measurement.payload_pose, reference.pose)
        s, a = (
            measurement.payload_twist - V_r,
            reference.acceleration - measurement.payload_twist + reference.twist,
        )
        Y = np.array([[a[0], 0, V_r[0], 0], [a[1], 0, V_r[1], 0], [0, a[2], 0, V_r[2]]])
        F, R = Y @ state[:4] - K_D * s, measurement.payload_pose[:2, :2]
        lever = R.T @ np.array([-F[1], F[0]])  # moment of the force about P for a unit of each place, negated
        torque = np.array([F[0], F[1], F[2] + lever @ state[4:]])
        rates = -self.gains * np.concatenate([Y.T @ s, lever * s[2]])
        self.kept.append(state + self.cell.clock.period * rates)
        return cp.ArmCommand(torque, self.kept[-1])


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry the object around a circle, with adaptation and without."""
    robots, seconds, rng = *((4, 12.0) if short else (6, 40.0)), np.random.default_rng(1)
    angles, radii = 2 * np.pi * np.arange(robots) / robots, 0.6 * rng.uniform(0.6, 1.4, robots)
    places = (radii * np.array([np.cos(angles), np.sin(angles)])).T
    grasps = {"cell.grasps": {f"r{k}": cp.Pose(xyz=(*xy, 0.0)) for k, xy in enumerate(places)}}
    curves, last, agents = [], {}, [Agent(cell, adapts=True) for _ in range(robots)]
    for label, laws in {"adapts": agents, "does not adapt": [Agent(cell, adapts=False)] * robots}.items():
        data = ring(cell, laws, grasps | {"duration": seconds})
        t, off, turn = data.time.values, off_path(data), np.degrees(data.pose_error.values[:, 5])
        early, late = t < seconds / 4, t > 0.75 * seconds
        force = np.linalg.norm(data.torque.values[..., :2], axis=-1).max(axis=1)
        rms = [float(np.sqrt((x[late] ** 2).mean())) for x in (off, turn)]
        last[label] = *rms, force[late].max() / force[early].max()
        curves.append(Trace(label, t, 1e3 * off))
    theta, mass = np.array([agent.kept for agent in agents]), 10.0 + 1.02 * robots
    (off, turn, forces), (alone, untold, _) = last["adapts"], last["does not adapt"]
    whole = [mass, 2.4 + 1.02 * sum(radii**2), 4.0 * robots, 4.0 * sum(radii**2), max(radii), max(radii)]
    wrong = np.linalg.norm(theta[:, -1, 4:] - places, axis=1) / radii
    bias = abs(theta[:, -1, 0].sum() / mass - 1)
    most, largest = 50.0 if short else 5.0, (np.abs(theta) / whole).max()
    return [
        Measured(FOLLOWS, "rms off at last, of that without adapting", 100 * off / alone, "%", most=most),
        Measured(FOLLOWS, "rms turn off at last, from 11 deg", turn, "deg"),
        Measured(FOLLOWS, "the same without adapting", untold, "deg"),
        Measured(BOUNDED, "largest force at last over that at first", forces, "", most=1.0),
        Measured(BOUNDED, "largest estimate ever over the whole's", largest, "", most=1.0),
        Measured(APART, "worst place, off by a share of its radius", 100 * wrong.max(), "%", least=10.0),
        Measured(APART, "masses added up, off by", 100 * bias, "%"),
    ], curves
