"""Load by capacity: shares of a heavy box that are equal, constant, or follow what each arm can bear."""

from __future__ import annotations

import numpy as np

import coop_pin as cp
from coop_pin.base.arrays import Array
from coop_pin.zoo.reproduction import Measured, Trace

MASS = 19.9
WITHIN = "each arm stays within its capacity"
FOLLOWED = "capacities that change are followed"
UNNOTICED = "the object does not notice"


def moved_load(time: float, times: list[float], shares: list[list[float]], weight: float) -> Array:
    """Return the internal wrench that adds a share of a weight to each arm, between those of stated times."""
    return np.outer([np.interp(time, times, arm) for arm in shares], -weight * np.eye(6)[2])


def by_shares(start: cp.Scenario) -> dict[str, cp.Scenario]:
    """Return the scenarios; what is constant stays with the cell, and the rest is an internal wrench."""
    arms, shares = cp.feasibility.static_torques(start, poses=41).arms, np.array([start.cell.shares]).T
    free = [(one.limit - np.sign(one.load) * one.weight) / np.maximum(np.abs(one.load), 1e-9) for one in arms]
    capacities = shares * [part.min(axis=1) for part in free]  # arm by time, parts of the payload's weight
    moved = (capacities / capacities.sum(axis=0) - shares).tolist()
    squeeze = {"times": arms[0].times.tolist(), "shares": moved, "weight": 9.81 * start.cell.payload.mass}
    least = dict(zip(start.cell.arms, capacities.min(axis=1) / capacities.min(axis=1).sum(), strict=True))
    follow = cp.squeezes.FunctionSqueeze(target=moved_load, options=squeeze)
    return {
        "equal": start.override({"cell.load_shares": dict.fromkeys(least, 0.5)}),
        "constant": start,
        "best constant": start.override({"cell.load_shares": least}),
        "following": start.override({"squeeze": follow}),
    }


def reproduce(cell: cp.Scenario, *, short: bool) -> tuple[list[Measured], list[Trace]]:
    """Carry half of the load by each kind of shares, then all of it."""
    ends = {"duration": 1.2, "motion.duration": 0.6} if short else {}
    numbers, curves, used, paths = [], [], {}, {}
    for load in (0.5, 1.0):
        box = {"cell.payload": {"kind": "box", "mass": load * MASS, "size": [0.2, 0.2, 0.2]}}
        for label, scenario in by_shares(cell.override(ends | box)).items():
            data = cp.run(scenario, warn=False).data
            part = 100 * (np.abs(data.commanded_torque) / data.torque_limit).max(("arm", "joint"))
            used[label, load], paths[label, load] = part.max().item(), 1e3 * data.payload_position.values
            curves += [Trace(f"{label} shares", data.time.values, part.values)] * (load == 1.0)
    most = used["following", 1.0]
    numbers.append(Measured(WITHIN, "most of a limit, shares that follow", most, "%", most=100.0))
    numbers.append(Measured(WITHIN, "the same, equal shares", used["equal", 1.0], "%", least=100.0))
    for label in ("constant", "best constant"):
        gain = used[label, 0.5] - used["following", 0.5]
        numbers.append(Measured(FOLLOWED, f"less of a limit than {label} shares", gain, "%", least=0.0))
    for label in ("equal", "constant"):
        off = np.abs(paths[label, 0.5] - paths["following", 0.5]).max().round(3)
        numbers.append(Measured(UNNOTICED, f"path off that of {label} shares", off, "mm"))
    return numbers, curves
