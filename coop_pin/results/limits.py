"""The limits of a cell's joints and drives, and where a run went beyond them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array

_SLACK = 1e-9


class LimitTable(NamedTuple):
    """Limits of m arms with at most k joints each; NaN where there is none, and beyond an arm's joints.

    Attributes:
        joints: names of each arm's joints.
        position_lower: rad or m, shape (m, k).
        position_upper: rad or m, shape (m, k).
        velocity_limit: rad/s or m/s, shape (m, k).
        torque_limit: of the drives, N m, shape (m, k).
    """

    joints: tuple[tuple[str, ...], ...]
    position_lower: Array
    position_upper: Array
    velocity_limit: Array
    torque_limit: Array


class LimitViolation(NamedTuple):
    """One limit that a run went beyond.

    Attributes:
        arm: the arm.
        joint: the joint; for a torque the drive of that number.
        kind: "position", "velocity" or "torque" (commanded; what is applied never exceeds the limit).
        worst: the value furthest beyond, rad or m, rad/s or m/s, N m.
        limit: the limit it went beyond.
        first_time: when it was first beyond, s.
    """

    arm: str
    joint: str
    kind: Literal["position", "velocity", "torque"]
    worst: float
    limit: float
    first_time: float


def limit_violations(data: xr.Dataset) -> tuple[LimitViolation, ...]:
    """Return every limit that was exceeded, by arm, joint and kind. Joints are not stopped at their limits, only judged."""
    found = []
    for a, arm in enumerate(data["arm"].values):
        for j, joint in enumerate(data["joint_name"].values[a]):
            if not joint:
                continue
            for kind, values, lower, upper in _watched(data, a, j):
                over = np.maximum(values - upper, lower - values)  # NaN where there is no limit: then nothing is over it
                beyond = np.flatnonzero(over > _SLACK)
                if beyond.size:
                    worst = int(beyond[np.argmax(over[beyond])])
                    limit = upper if values[worst] > upper else lower
                    first = float(data["time"].values[beyond[0]])
                    found.append(LimitViolation(str(arm), str(joint), kind, float(values[worst]), float(limit), first))
    return tuple(found)


def _watched(data: xr.Dataset, a: int, j: int) -> list[tuple[Literal["position", "velocity", "torque"], Array, float, float]]:
    """Return kind, values over time, lower and upper limit of one joint."""
    speed, torque = float(data["velocity_limit"].values[a, j]), float(data["torque_limit"].values[a, j])
    lower, upper = float(data["position_lower"].values[a, j]), float(data["position_upper"].values[a, j])
    return [
        ("position", data["joint_position"].values[:, a, j], lower, upper),
        ("velocity", data["joint_velocity"].values[:, a, j], -speed, speed),
        ("torque", data["commanded_torque"].values[:, a, j], -torque, torque),
    ]
