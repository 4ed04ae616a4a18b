"""Breaches of the thresholds of a run, and joint and drive limits that it exceeded."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Self, TypeAlias, get_args

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.description.thresholds import TaskLimits
from coop_pin.results.metrics import DRIFT_S
from coop_pin.results.quantity import Arrays

Cause = Literal[
    "end stop",
    "joint limit",
    "jacobian condition",
    "torque cut",
    "slip",
    "friction",
    "wheel slip",
    "closure error",
    "energy",
    "position",
    "orientation",
    "internal force",
    "internal moment",
    "joint drift",
    "error",
]
"""What was breached. Of breaches at the same time, causes come before what usually follows from them."""

_TEXTS: dict[Cause, str] = {
    "end stop": "{who} hits its end stop from {time:.4g} s (it pushes back with up to {value:.4g} N m or N)",
    "joint limit": "{who} at its stop from {time:.4g} s (reaches {value:.4g}, limit {allowed:.4g})",
    "jacobian condition": "{who} near a singular pose from {time:.4g} s"
    " (condition number {value:.3g}, allowed {allowed:.3g})",
    "torque cut": "{who} torque at its limit from {time:.4g} s"
    " ({value:.3g} s at a stretch, allowed {allowed:.3g} s)",
    "slip": "{who} patch slides from {time:.4g} s (by {value:.2g} m, allowed {allowed:.2g} m)",
    "friction": "{who} pad would slip from {time:.4g} s (needs {value:.3g} of its friction)",
    "wheel slip": "{who} wheels would slide from {time:.4g} s (the ground holds them with {value:.4g} N,"
    " their friction bears {allowed:.4g} N)",
    "closure error": "{who} grasp open from {time:.4g} s (by {value:.2g} m or rad, allowed {allowed:.2g})",
    "energy": "energy not explained by work from {time:.4g} s (by {value:.2g} J, allowed {allowed:.2g} J)",
    "position": "position off from {time:.4g} s (by {value:.3g} m, allowed {allowed:.3g} m)",
    "orientation": "orientation off from {time:.4g} s (by {value:.3g} rad, allowed {allowed:.3g} rad)",
    "internal force": "{who} internal force off from {time:.4g} s"
    " (by {value:.3g} N, allowed {allowed:.3g} N)",
    "internal moment": "{who} internal moment off from {time:.4g} s"
    " (by {value:.3g} N m, allowed {allowed:.3g} N m)",
    "joint drift": "{who} drifts while the payload rests, from {time:.4g} s on"
    " (by {value:.3g} in 1 s, allowed {allowed:.3g}): hold spare joints with a stiffer posture",
    "error": "ended by an error at {time:.4g} s of {allowed:.4g} s",
}


class Breach(NamedTuple):
    """Threshold of a run that it exceeded: of the simulation or of the task.

    Attributes:
        cause: name of what exceeded it.
        arm: the arm; empty for the energy and for an error.
        joint: the joint or the drive of that number; empty where the arm as a whole is concerned.
        time: time at which it was exceeded first, s; of a torque cut its start.
        value: the value furthest beyond: rad or m, s, J, or a number; of an error the time of the end, s.
        allowed: the threshold at that value, or the joint limit; of an error the scenario's duration, s.
    """

    cause: Cause
    arm: str
    joint: str
    time: float
    value: float
    allowed: float

    def __str__(self) -> str:
        """Return the breach as one line of text."""
        who = f"{self.arm} {self.joint}".strip()
        return _TEXTS[self.cause].format(who=who, time=self.time, value=self.value, allowed=self.allowed)


def in_time(breaches: Sequence[Breach]) -> tuple[Breach, ...]:
    """Return breaches in the order of their first times."""
    return tuple(sorted(breaches, key=lambda breach: (breach.time, get_args(Cause).index(breach.cause))))


def merged(earlier: Iterable[Breach], later: Iterable[Breach]) -> tuple[Breach, ...]:
    """Return the breaches of two parts of a run: each with its first time and its worst value."""
    breaches = dict[Hashable, Breach]()
    for breach in (*earlier, *later):
        first = breaches.get(breach[:3], breach)
        is_worse = not abs(breach.value - breach.allowed) <= abs(first.value - first.allowed)
        breaches[breach[:3]] = (breach if is_worse else first)._replace(time=first.time)
    return in_time(list(breaches.values()))


def joint_names(labels: Mapping[Any, Any]) -> list[tuple[str, list[str]]]:
    """Return the name of each arm and the names of its joints, of arrays of a run."""
    names = [[name for name in row if name] for row in np.asarray(labels["joint_name"]).tolist()]
    return list(zip(map(str, np.asarray(labels["arm"])), names, strict=True))


def drift_breaches(
    drift: Array, limits: TaskLimits, joints: Sequence[tuple[str, Sequence[str]]], end: float
) -> tuple[Breach, ...]:
    """Return the joints that drift in the last second of a run.

    Args:
        drift: drift of all joints, rad or m, shape (m, k); see metrics.joint_drift.
        limits: task limits of the scenario.
        joints: name of each arm, and names of its joints.
        end: time of the last sample, s.
    """
    allowed = limits.joint_drift
    return tuple(
        Breach("joint drift", joints[a][0], joints[a][1][j], end - DRIFT_S, float(drift[a, j]), allowed)
        for a, j in np.argwhere(drift > allowed).tolist()
    )


class Series(NamedTuple):
    """Samples of what a threshold bounds, shape (..., n) and those of the arms and joints.

    Attributes:
        cause: cause of a breach.
        beyond: mask of the samples that exceed the threshold.
        values: values of the quantity.
        allowed: the threshold at each sample.
        excess: measure that the worst sample has most of; NaN counts as most.
    """

    cause: Cause
    beyond: Mask
    values: Array
    allowed: Array
    excess: Array

    @classmethod
    def at_most(
        cls, cause: Cause, values: Array, allowed: Array | float, excess: Array | None = None
    ) -> Self:
        """Return the series of values that may be as large as what is allowed; NaN is beyond it."""
        bounds, excess = np.broadcast_to(allowed, values.shape), values if excess is None else excess
        return cls(cause, ~(values <= bounds), values, bounds, excess)

    def breaches(self, time: Array, joints: Sequence[tuple[str, Sequence[str]]]) -> Iterator[Breach]:
        """Yield the breaches of a series of one run.

        Args:
            time: times of the samples, s, shape (n,).
            joints: name of each arm, and names of its joints.
        """
        for column in np.argwhere(self.beyond.any(axis=0)).tolist():
            entry: Any = (slice(None), *column)
            beyond, values, allowed, excess = (part[entry] for part in self[1:])
            first, worst = int(np.argmax(beyond)), int(np.argmax(np.where(beyond, excess, -np.inf)))
            start = time[first] - (values[first] if self.cause == "torque cut" else 0.0)
            arm, names = joints[column[0]] if column else ("", ())
            joint = names[column[1]] if len(column) > 1 else ""
            yield Breach(self.cause, arm, joint, float(start), float(values[worst]), float(allowed[worst]))


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
        kind = "commanded torque" if self.kind == "torque" else self.kind
        worst = f"at worst {self.worst:.4g} (limit {self.limit:.4g})"
        return f"{kind} of {self.arm} {self.joint}, {worst}, first at t = {self.first_time:.4g} s"


def limit_violations(data: Arrays) -> tuple[LimitViolation, ...]:
    """Return the limits that were exceeded, by arm, joint and kind; in an end stop a joint is beyond one."""
    violations = []
    for a, arm in enumerate(np.asarray(data["arm"])):
        for j, joint in enumerate(np.asarray(data["joint_name"])[a]):
            if not joint:
                continue
            lower, upper, speed, torque = (
                float(np.asarray(data[name])[a, j])
                for name in ("position_lower", "position_upper", "velocity_limit", "torque_limit")
            )
            requested = "requested_torque" if "requested_torque" in data else "commanded_torque"
            series: list[tuple[LimitKind, str, float, float]] = [
                ("position", "joint_position", lower, upper),
                ("velocity", "joint_velocity", -speed, speed),
                ("torque", requested, -torque, torque),
            ]
            for kind, name, least, most in series:
                values = np.asarray(data[name])[:, a, j]
                over = np.maximum(values - most, least - values)  # NaN, so never exceeded, without a limit
                beyond = np.flatnonzero(over > _SLACK)
                if beyond.size:
                    worst = float(values[beyond[np.argmax(over[beyond])]])
                    limit = most if worst > most else least
                    first = float(np.asarray(data["time"])[beyond[0]])
                    violations.append(LimitViolation(str(arm), str(joint), kind, worst, limit, first))
    return tuple(violations)
