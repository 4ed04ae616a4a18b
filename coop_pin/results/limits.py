"""Limits of joints and drives that a run exceeded."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.results.quantities import Arrays

_SLACK = 1e-9
"""Differences below it beyond a limit are rounding."""


LimitKind: TypeAlias = Literal["position", "velocity", "torque"]


class LimitViolation(NamedTuple):
    """A limit that a run exceeded.

    Attributes:
        arm: the arm.
        joint: the joint; for a torque the drive of that number.
        kind: "position", "velocity" or "torque" (asked of the drive by controller and gravity compensation;
            what is applied never exceeds the limit).
        worst: the value furthest beyond, rad or m, rad/s or m/s, N m.
        limit: the limit that was exceeded.
        first_time: time at which it was exceeded first, s.
    """

    arm: str
    joint: str
    kind: LimitKind
    worst: float
    limit: float
    first_time: float

    def __str__(self) -> str:
        """Return it as text."""
        worst = f"{self.worst:.4g} (limit {self.limit:.4g})"
        return f"{self.kind} of {self.arm} {self.joint}, {worst}, first at t = {self.first_time:.4g} s"


def limit_violations(data: Arrays) -> tuple[LimitViolation, ...]:
    """Return the limits that were exceeded, by arm, joint and kind; the plant stops no joint at its limit."""
    violations = []
    for a, arm in enumerate(np.asarray(data["arm"])):
        for j, joint in enumerate(np.asarray(data["joint_name"])[a]):
            if not joint:
                continue
            for kind, values, lower, upper in _limited(data, a, j):
                over = np.maximum(values - upper, lower - values)  # NaN, so never exceeded, without a limit
                beyond = np.flatnonzero(over > _SLACK)
                if beyond.size:
                    worst = float(values[beyond[np.argmax(over[beyond])]])
                    limit = upper if worst > upper else lower
                    first = float(np.asarray(data["time"])[beyond[0]])
                    violations.append(LimitViolation(str(arm), str(joint), kind, worst, limit, first))
    return tuple(violations)


def _limited(data: Arrays, a: int, j: int) -> list[tuple[LimitKind, Array, float, float]]:
    """Return kind, values over time, lower and upper limit of one joint."""
    lower, upper, speed, torque = (
        float(np.asarray(data[name])[a, j])
        for name in ("position_lower", "position_upper", "velocity_limit", "torque_limit")
    )
    asked = "requested_torque" if "requested_torque" in data else "commanded_torque"
    return [
        ("position", np.asarray(data["joint_position"])[:, a, j], lower, upper),
        ("velocity", np.asarray(data["joint_velocity"])[:, a, j], -speed, speed),
        ("torque", np.asarray(data[asked])[:, a, j], -torque, torque),
    ]
