"""Metrics, breaches and exceeded limits of all ticks of a run that keeps every n-th, from block to block.

With n_k samples of block k in a window, rms_k over them, mean_k, and so on,

    rms^2 = sum_k n_k rms_k^2 / sum_k n_k,    mean = sum_k n_k mean_k / sum_k n_k,    max = max_k max_k
"""

from __future__ import annotations

import copy
import json
import math
from collections import ChainMap
from collections.abc import Hashable, Mapping
from typing import NamedTuple, Self, get_args

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import NameNotFoundError
from coop_pin.description.scenario import Scenario
from coop_pin.results.breaches import (
    Breach,
    LimitKind,
    LimitViolation,
    drift_breaches,
    in_time,
    joint_names,
    limit_violations,
    merged,
)
from coop_pin.results.energies import start_energy, unexplained_energy
from coop_pin.results.friction import drop_metrics, friction_metrics
from coop_pin.results.metrics import PHASE_METRICS, TOOL_METRICS, all_metrics, joint_drift
from coop_pin.results.quantity import Arrays, Samples
from coop_pin.results.task import TaskMonitor
from coop_pin.results.trust import TrustMonitor
from coop_pin.results.window import RUN_END, SETTLING_S, EventWindows, Window, phases, samples_of

_SETTLING = ("settling_time_s", "resettling_time_s")
_LARGEST = (
    "event_peak_position_error_m",
    "closure_error_max_m",
    "closure_error_max_rad",
    "torque_peak_Nm",
    "energy_balance_max_J",
    *TOOL_METRICS,
)
_LEAST = ("squeeze_reserve_min_N", "dropped_at_s")
_ROUNDING = 1e-9
"""Rounding of times, s."""
_MEAN = "internal_axial_mean_N"
"""The one of PHASE_METRICS that is a mean; the others are rms values."""
_AT_THE_END = ("time", "joint_position", "joint_velocity", "desired_twist", "payload_twist")
"""Quantities of whose last seconds the drift of the joints is taken."""


class Metrics(dict[str, float]):
    """Metrics of a run by name; one that it has not, such as a name of 0.2.0, is answered by near ones."""

    def __missing__(self, name: str) -> float:
        raise NameNotFoundError("metric", str(name), self, "the run")


class EveryTick(NamedTuple):
    """What is known of all ticks of a run that keeps some of them.

    Attributes:
        metrics: metrics by name, without the verdicts.
        breaches: breaches of the trust thresholds, in time.
        deviations: errors beyond the task limits, in time, without the error that ended the run.
        limits: limits that were exceeded.
    """

    metrics: Mapping[str, float]
    breaches: tuple[Breach, ...]
    deviations: tuple[Breach, ...]
    limits: tuple[LimitViolation, ...]

    def to_text(self) -> str:
        """Return it as JSON with NaN and Infinity."""
        return json.dumps(self._asdict())

    @classmethod
    def of_text(cls, text: str) -> Self:
        """Return what ``to_text`` wrote."""
        values, breaches, deviations, limits = json.loads(text).values()
        return cls(
            values,
            tuple(Breach(*each) for each in breaches),
            tuple(Breach(*each) for each in deviations),
            tuple(LimitViolation(*each) for each in limits),
        )


class RunningMetrics:
    """Metrics of a run whose samples come in blocks; it keeps those of the last four seconds."""

    def __init__(self, scenario: Scenario, labels: Samples) -> None:
        """Begin before the first sample.

        Args:
            scenario: scenario of the run.
            labels: names and limits of arms and joints, as ``without_time`` returns them.
        """
        self._labels, self._joints = labels, joint_names(labels)
        limits = labels["position_lower"], labels["position_upper"]
        self._monitor = TrustMonitor(scenario.trust, self._joints, *limits)
        self._task, self._deviations = TaskMonitor(self._joints), tuple[Breach, ...]()
        self._breaches, self._limits = tuple[Breach, ...](), dict[Hashable, LimitViolation]()
        self._values, self._means = dict[str, float](), dict[Hashable, tuple[int, float]]()
        self._end = dict[str, Array]()
        self._start_energy: Array  # before the first sample

    def add(self, samples: Arrays, scenario: Scenario) -> None:
        """Take the next block, which others follow.

        Args:
            samples: quantities of successive ticks, by name.
            scenario: scenario with the events added so far.
        """
        self._include(ChainMap({RUN_END: math.inf}, dict(samples)), scenario, math.inf)

    def finished(self, samples: Arrays, scenario: Scenario) -> EveryTick:
        """Return what is known if a block is the last; arguments as of add, which may follow nevertheless."""
        whole, end = copy.deepcopy(self), float(np.asarray(samples["time"])[-1])
        whole._include(samples, scenario, end)
        drift = joint_drift(whole._end, EventWindows.of(scenario, end))
        values = whole._values | {"joint_drift_rad": float(np.fmax.reduce(drift, axis=(-2, -1)))}
        drifts = drift_breaches(drift, scenario.task, whole._joints, end)
        joints = [(arm, joint) for arm, names in whole._joints for joint in names]
        order = [(*joint, kind) for joint in joints for kind in get_args(LimitKind)]
        limits = sorted(whole._limits.values(), key=lambda limit: order.index(limit[:3]))
        deviations = in_time((*whole._deviations, *drifts))
        return EveryTick(values, whole._breaches, deviations, tuple(limits))

    def _include(self, samples: Arrays, scenario: Scenario, end: float) -> None:
        """Include a block; the end is that of the run, as far as it is known."""
        data, cell, events = (
            ChainMap(dict(samples), self._labels),
            scenario.cell,
            EventWindows.of(scenario, end),
        )
        self._deviations = self._task.deviations(data, scenario, self._deviations)
        counted = self._task.after_decay
        values = self._task.largest | all_metrics(data, scenario, end, counted)
        values |= friction_metrics(data, cell) if cell.padded else {}
        values |= drop_metrics(data, scenario)
        new = {name: float(value) for name, value in values.items()}
        if not self._values:
            self._start_energy, self._values = start_energy(data), new
        new["energy_balance_max_J"] = float(np.abs(unexplained_energy(data, self._start_energy)).max())
        for phase, mask in phases(data, scenario, counted).items():
            start = events.last_end if phase == "after_event" else self._task.decayed
            count = int(mask.sum())
            new |= {f"{phase}_{name}": self._mean(phase, name, start, count, new) for name in PHASE_METRICS}
        for name, span in zip(_SETTLING, (events.before, events.after), strict=True):
            if span is not None:
                new[name] = _settled(self._values[name], new[name], data, span)
        for names, extreme in ((_LARGEST, np.fmax), (_LEAST, np.fmin)):
            new |= {name: float(extreme(self._values[name], new[name])) for name in names if name in new}
        self._values = new
        self._breaches = merged(self._breaches, self._monitor.breaches(data))
        for limit in limit_violations(data):
            earliest = self._limits.get(limit[:3], limit)
            is_worse = abs(limit.worst - limit.limit) > abs(earliest.worst - earliest.limit)
            worst = limit if is_worse else earliest
            self._limits[limit[:3]] = worst._replace(first_time=earliest.first_time)
        ending = {name: np.asarray(data[name]) for name in _AT_THE_END}  # for the drift of the joints
        if self._end:
            ending = {name: np.concatenate((self._end[name], values)) for name, values in ending.items()}
        late = ending["time"] >= ending["time"][-1] - SETTLING_S - _ROUNDING
        self._end = {name: values[late] for name, values in ending.items()}

    def _mean(self, phase: str, name: str, start: float, count: int, new: Mapping[str, float]) -> float:
        """Return a mean or rms value of all blocks over a phase, of which the newest has ``count`` samples.

        An event that is added, and the end of the start's decay, move the start of the phase: what was before
        is left out.
        """
        key, value = (phase, name, start), new[f"{phase}_{name}"]
        n, mean = self._means.get(key, (0, math.nan))
        if count:
            power = 1 if name == _MEAN else 2
            both = (n * mean**power + count * value**power) / (n + count) if n else math.nan
            n, mean = n + count, both ** (1.0 / power) if n else value
            self._means[key] = n, mean
        return mean


def _settled(before: float, new: float, data: Arrays, window: Window) -> float:
    """Return the settling time of all blocks, s.

    Args:
        before: that of the earlier blocks: inf if the last sample in the window was out of the band.
        new: that of the newest block; 0 or NaN if none of its samples in the window is out of the band.
        data: arrays of the newest block.
        window: window of the settling time.
    """
    inside = samples_of(data, window)
    if new > 0.0 or not inside.any():
        return new if new > 0.0 else before
    return float(np.asarray(data["time"])[inside][0] - window.start) if math.isinf(before) else before
