"""Trust in a run: breaches of its trust thresholds, found in recorded samples or while they are recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.description.trust import TrustThresholds
from coop_pin.results.quantities import WORK, Samples

Cause = Literal["joint limit", "jacobian condition", "torque cut", "closure error", "energy", "error"]
"""What was breached. Of breaches at the same time, causes come before what usually follows from them."""

_TEXTS: dict[Cause, str] = {
    "joint limit": "{who} at its stop from {time:.4g} s (reaches {value:.4g}, limit {allowed:.4g})",
    "jacobian condition": "{who} near a singular pose from {time:.4g} s"
    " (condition number {value:.3g}, allowed {allowed:.3g})",
    "torque cut": "{who} torque at its limit from {time:.4g} s (for {value:.3g} s, allowed {allowed:.3g} s)",
    "closure error": "{who} grasp open from {time:.4g} s (by {value:.2g} m or rad, allowed {allowed:.2g})",
    "energy": "energy not explained by work from {time:.4g} s (by {value:.2g} J, allowed {allowed:.2g} J)",
    "error": "ended by an error at {time:.4g} s of {allowed:.4g} s",
}


class Breach(NamedTuple):
    """Trust threshold that a run exceeded.

    Attributes:
        cause: what exceeded it.
        arm: the arm; empty for the energy and for an error.
        joint: the joint or the drive of that number; empty where the arm as a whole is concerned.
        time: when it was exceeded first, s; of a torque cut its start.
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


class TrustMonitor:
    """Search for breaches in successive samples: those of a whole run at once, or of each tick as it is done.

    It keeps the gross work and the starts of torque cuts from one call of ``breaches`` to the next.
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
            thresholds: of the scenario.
            joints: name of each arm, and names of its joints.
            lower: smallest joint positions, shape (m, k); NaN where there is no limit.
            upper: largest joint positions, likewise.
        """
        self._allowed, self._joints = thresholds, joints
        self._lower, self._upper = lower, upper
        self._gross, self._cut_start = 0.0, np.full(lower.shape, np.nan)
        self._last: Array | None = None
        self._start_energy: float  # of the first sample

    def breaches(self, samples: Samples) -> tuple[Breach, ...]:
        """Return the breaches in the next samples, in the order of their first times.

        Args:
            samples: of the quantities by name, n samples that follow those of the last call.
        """
        return in_time(
            [
                *self._joint_limits(samples),
                *self._conditions(samples),
                *self._torque_cuts(samples),
                *self._closure_errors(samples),
                *self._energy(samples),
            ]
        )

    def _joint_limits(self, samples: Samples) -> Iterator[Breach]:
        time, positions = samples["time"], samples["joint_position"]
        excess = np.fmax(positions - self._upper, self._lower - positions)  # NaN without a limit
        for a, j, first, worst in _columns(excess > self._allowed.joint_slack, excess):
            value = float(positions[worst, a, j])
            limit = float((self._upper if value > self._upper[a, j] else self._lower)[a, j])
            yield Breach("joint limit", *self._names(a, j), float(time[first]), value, limit)

    def _conditions(self, samples: Samples) -> Iterator[Breach]:
        values, allowed = samples["jacobian_condition"], self._allowed.jacobian_condition
        for a, first, worst in _columns(~(values <= allowed), values):
            time, value = float(samples["time"][first]), float(values[worst, a])
            yield Breach("jacobian condition", self._joints[a][0], "", time, value, allowed)

    def _torque_cuts(self, samples: Samples) -> Iterator[Breach]:
        saturated, allowed = samples["saturated"].astype(bool), self._allowed.torque_cut
        time, places = samples["time"], np.arange(1, len(saturated) + 1)
        after_free = np.maximum.accumulate(np.where(saturated, 0, places[:, None, None]), axis=0)
        earlier = np.fmin(self._cut_start, time[0])  # of a cut that the first sample is in
        starts = np.where(after_free, np.append(time, np.nan)[after_free], earlier)
        self._cut_start = np.where(saturated[-1], starts[-1], np.nan)
        lengths = np.where(saturated, time[:, None, None] - starts, 0.0)
        for a, j, first, worst in _columns(lengths > allowed * (1.0 + 1e-9), lengths):
            start = float(samples["time"][first] - lengths[first, a, j])
            yield Breach("torque cut", *self._names(a, j), start, float(lengths[worst, a, j]), allowed)

    def _closure_errors(self, samples: Samples) -> Iterator[Breach]:
        values = np.maximum(samples["closure_distance"], samples["closure_angle"])
        allowed = self._allowed.closure_error
        for a, first, worst in _columns(~(values <= allowed), values):
            time, value = float(samples["time"][first]), float(values[worst, a])
            yield Breach("closure error", self._joints[a][0], "", time, value, allowed)

    def _energy(self, samples: Samples) -> Iterator[Breach]:
        works = np.stack([samples[name] for name in (*WORK, "potential_energy")], axis=1)
        energy = samples["kinetic_energy"] + samples["potential_energy"] - works[:, :-1].sum(axis=1)
        if self._last is None:
            self._last, self._start_energy = works[0], float(energy[0])
        steps = np.abs(np.diff(works, axis=0, prepend=self._last[None])).sum(axis=1)
        gross = self._gross + np.cumsum(steps)
        self._last, self._gross = works[-1], float(gross[-1])
        values = np.abs(energy - self._start_energy)
        allowed = self._allowed.energy_floor + self._allowed.energy_share * gross
        for first, worst in _columns(~(values <= allowed), values - allowed):
            time = float(samples["time"][first])
            yield Breach("energy", "", "", time, float(values[worst]), float(allowed[worst]))

    def _names(self, a: int, j: int) -> tuple[str, str]:
        arm, joints = self._joints[a]
        return arm, joints[j]


def _columns(beyond: Mask, excess: Array) -> Iterator[tuple[int, ...]]:
    """Yield the column of every series that is beyond, with its first sample beyond and its worst one.

    Args:
        beyond: samples along the first axis.
        excess: what the worst sample has most of; NaN counts as most.
    """
    for column in np.argwhere(beyond.any(axis=0)):
        place = (slice(None), *column)
        first = int(np.argmax(beyond[place]))
        yield *map(int, column), first, int(np.argmax(np.where(beyond[place], excess[place], -np.inf)))
