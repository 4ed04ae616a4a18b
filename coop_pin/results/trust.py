"""Trust in a run: breaches of its trust thresholds, in samples or while it is recorded; exceeded limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from coop_pin.base.arrays import Array, Mask
from coop_pin.description.trust import TrustThresholds
from coop_pin.results.energies import energies, start_energy, unexplained_energy
from coop_pin.results.metrics import DRIFT_S
from coop_pin.results.quantities import Arrays

Cause = Literal[
    "joint limit", "jacobian condition", "torque cut", "closure error", "energy", "joint drift", "error"
]
"""What was breached. Of breaches at the same time, causes come before what usually follows from them."""

_TEXTS: dict[Cause, str] = {
    "joint limit": "{who} at its stop from {time:.4g} s (reaches {value:.4g}, limit {allowed:.4g})",
    "jacobian condition": "{who} near a singular pose from {time:.4g} s"
    " (condition number {value:.3g}, allowed {allowed:.3g})",
    "torque cut": "{who} torque at its limit from {time:.4g} s"
    " ({value:.3g} s at a stretch, allowed {allowed:.3g} s)",
    "closure error": "{who} grasp open from {time:.4g} s (by {value:.2g} m or rad, allowed {allowed:.2g})",
    "energy": "energy not explained by work from {time:.4g} s (by {value:.2g} J, allowed {allowed:.2g} J)",
    "joint drift": "{who} drifts while the payload rests, from {time:.4g} s on"
    " (by {value:.3g} in 1 s, allowed {allowed:.3g}): hold spare joints with a stiffer posture",
    "error": "ended by an error at {time:.4g} s of {allowed:.4g} s",
}


class Breach(NamedTuple):
    """Trust threshold that a run exceeded.

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


def joint_names(labels: Mapping[Any, Any]) -> list[tuple[str, list[str]]]:
    """Return the name of each arm and the names of its joints, of arrays of a run."""
    names = [[name for name in row if name] for row in np.asarray(labels["joint_name"]).tolist()]
    return list(zip(map(str, np.asarray(labels["arm"])), names, strict=True))


def drift_breaches(
    drift: Array, thresholds: TrustThresholds, joints: Sequence[tuple[str, Sequence[str]]], end: float
) -> tuple[Breach, ...]:
    """Return the joints that drift in the last second of a run.

    Args:
        drift: drift of all joints, rad or m, shape (m, k); see metrics.joint_drift.
        thresholds: thresholds of the scenario.
        joints: name of each arm, and names of its joints.
        end: time of the last sample, s.
    """
    allowed = thresholds.joint_drift
    return tuple(
        Breach("joint drift", joints[a][0], joints[a][1][j], end - DRIFT_S, float(drift[a, j]), allowed)
        for a, j in np.argwhere(drift > allowed).tolist()
    )


class _Series(NamedTuple):
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


class TrustMonitor:
    """Search for breaches in successive samples: those of a whole run at once, or of each tick as it is done.

    It keeps the gross work and the starts of torque cuts from one call to the next.
    """

    def __init__(
        self,
        thresholds: TrustThresholds,
        joints: Sequence[tuple[str, Sequence[str]]],
        lower: Array,
        upper: Array,
    ) -> None:
        """Start before the first sample.

        Args:
            thresholds: thresholds of the scenario.
            joints: name of each arm, and names of its joints.
            lower: smallest joint positions, shape (..., m, k); NaN where there is no limit.
            upper: largest joint positions, likewise.
        """
        self._allowed, self._joints = thresholds, joints
        self._lower, self._upper = lower[..., None, :, :], upper[..., None, :, :]
        self._gross: Array | float = 0.0
        self._cut_start = np.full(lower.shape, np.nan)
        self._last: list[Array] | None = None
        self._start_energy: Array  # before the first sample

    def breaches(self, samples: Mapping[str, NDArray[Any]]) -> tuple[Breach, ...]:
        """Return the breaches in the next samples of a run, in the order of their first times.

        Args:
            samples: quantities by name, n samples that follow those of the last call.
        """
        return in_time(
            [breach for series in self._series(samples) for breach in self._breaches_of(series, samples)]
        )

    def exceeded(self, samples: Mapping[str, NDArray[Any]], unexplained: Array) -> Mask:
        """Return which runs have a breach, shape (...), from all their samples.

        Args:
            samples: quantities by name, with axes before that of time.
            unexplained: largest energy minus work of each run, J, up to rounding; see energy_balance.
        """
        runs, energies_too = self._lower.shape[:-3], ~(unexplained <= 0.5 * self._allowed.energy_floor)
        series = self._series(samples, bool(energies_too.any()))
        return np.any([each.beyond.reshape(*runs, -1).any(axis=-1) for each in series], axis=0)

    def _breaches_of(self, series: _Series, samples: Mapping[str, NDArray[Any]]) -> Iterator[Breach]:
        """Yield the breaches of a series of one run."""
        for column in np.argwhere(series.beyond.any(axis=0)).tolist():
            entry: Any = (slice(None), *column)
            beyond, values, allowed, excess = (part[entry] for part in series[1:])
            first, worst = int(np.argmax(beyond)), int(np.argmax(np.where(beyond, excess, -np.inf)))
            time = samples["time"][first] - (values[first] if series.cause == "torque cut" else 0.0)
            arm, joints = self._joints[column[0]] if column else ("", ())
            joint = joints[column[1]] if len(column) > 1 else ""
            yield Breach(series.cause, arm, joint, float(time), float(values[worst]), float(allowed[worst]))

    def _series(self, samples: Mapping[str, NDArray[Any]], energies_too: bool = True) -> list[_Series]:
        """Return the series of all thresholds; samples may have axes before that of time."""
        allowed, positions = self._allowed, samples["joint_position"]
        excess = np.fmax(positions - self._upper, self._lower - positions)  # NaN without a limit
        limits = np.where(positions > self._upper, self._upper, self._lower)
        lengths, errors = (
            self._torque_cuts(samples),
            np.maximum(samples["closure_distance"], samples["closure_angle"]),
        )
        longest = np.full(lengths.shape, allowed.torque_cut)
        return [
            _Series("joint limit", excess > allowed.joint_slack, positions, limits, excess),
            _at_most("jacobian condition", samples["jacobian_condition"], allowed.jacobian_condition),
            _Series("torque cut", lengths > longest * (1.0 + 1e-9), lengths, longest, lengths),
            _at_most("closure error", errors, allowed.closure_error),
            *([self._energy(samples)] if energies_too else []),
        ]

    def _torque_cuts(self, samples: Mapping[str, NDArray[Any]]) -> Array:
        """Return how long each torque has been at its limit without a break, s."""
        saturated, time = np.moveaxis(samples["saturated"].astype(bool), -3, 0), samples["time"]
        is_cut, lengths = saturated.any(axis=0), np.zeros(saturated.shape)
        if not is_cut.any():
            self._cut_start = np.full(is_cut.shape, np.nan)
            return np.moveaxis(lengths, 0, -3)
        saturated, places = saturated[:, is_cut], np.arange(1, len(time) + 1)[:, None]
        after_free = np.maximum.accumulate(np.where(saturated, 0, places), axis=0)
        earlier = np.fmin(self._cut_start[is_cut], time[0])  # of a cut that the first sample is in
        starts = np.where(after_free, np.append(time, np.nan)[after_free], earlier)
        self._cut_start = np.full(is_cut.shape, np.nan)
        self._cut_start[is_cut] = np.where(saturated[-1], starts[-1], np.nan)
        lengths[:, is_cut] = np.where(saturated, time[:, None] - starts, 0.0)
        return np.moveaxis(lengths, 0, -3)

    def _energy(self, samples: Mapping[str, NDArray[Any]]) -> _Series:
        works = [*energies(samples)[1], samples["potential_energy"]]
        if self._last is None:
            self._last, self._start_energy = [work[..., :1] for work in works], start_energy(samples)
        pairs = zip(works, self._last, strict=True)
        steps = sum(np.abs(np.diff(work, prepend=last)) for work, last in pairs)
        gross = self._gross + np.cumsum(steps, axis=-1)
        self._last, self._gross = [work[..., -1:] for work in works], gross[..., -1:]
        values = np.abs(unexplained_energy(samples, self._start_energy))
        allowed = self._allowed.energy_floor + self._allowed.energy_share * gross
        return _at_most("energy", values, allowed, values - allowed)


def _at_most(cause: Cause, values: Array, allowed: Array | float, excess: Array | None = None) -> _Series:
    """Return the series of values that may be as large as what is allowed; NaN is beyond it."""
    bounds, excess = np.broadcast_to(allowed, values.shape), values if excess is None else excess
    return _Series(cause, ~(values <= bounds), values, bounds, excess)


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
