"""Windows of time over which the metrics of a run are taken."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Self

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import ArgumentError, OutOfRangeError
from coop_pin.description.scenario import Scenario
from coop_pin.results.quantity import Arrays

_OF_EVENTS = ("resettling_time_s", "event_peak_position_error_m")
"""Metrics from the first event on."""
SETTLING_S = 4.0
"""Time that a run has to settle after its start and after its last event before joints may drift, s."""
RUN_END = "run_end"
"""Name of the time at which a run ends, s, in arrays of a part of it that is not the last."""
PHASES = {
    "moving": "while the reference moves",
    "rest": "while the reference rests",
    "after_event": "after the last event",
}
"""Phases of a run, see ``phases``, and their texts."""
_SLACK = 1e-9
"""Differences of times below it are rounding, s."""


class Window(NamedTuple):
    """A span of time.

    Attributes:
        start: s.
        end: s.
    """

    start: float
    end: float

    @property
    def is_empty(self) -> bool:
        """Whether it ends before it starts, or has no length."""
        return self.start >= self.end

    def __str__(self) -> str:
        """Return it as text."""
        return f"at {self.start:g} s" if self.is_empty else f"{self.start:g} to {self.end:g} s"


def checked_window(window: tuple[float, float], end: float) -> Window:
    """Return a window that a caller asks for.

    Raises:
        ArgumentError: it is not a pair of numbers.
        OutOfRangeError: it is empty, or not within the run, which ends at ``end``.
    """
    try:
        start, stop = map(float, window)
    except (TypeError, ValueError):
        raise ArgumentError(f"window is {window!r}; it must be a pair of times in s, start and end") from None
    if not 0.0 <= start < end:
        raise OutOfRangeError("start of the window", start, f"from 0 to the end of the run, {end:g} s")
    if not start < stop <= end + _SLACK:
        raise OutOfRangeError("end of the window", stop, f"after its start {start:g} s, at most {end:g} s")
    return Window(start, stop)


def samples_of(data: Arrays, window: Window) -> Mask:
    """Return the mask of the samples with start <= t < end, shape (n,).

    The last sample of a run is in a window that reaches the end of the run.
    """
    time = np.asarray(data["time"])
    end = data[RUN_END] if RUN_END in data else time[-1]
    return np.asarray(
        (time >= window.start - _SLACK)
        & ((time < window.end - _SLACK) | (time == end) & (window.end >= end - _SLACK))
    )


def spans(time: Array, mask: Mask) -> tuple[Window, ...]:
    """Return the windows of the samples of a mask, each from its first to its last one, shapes (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return tuple(Window(float(time[i]), float(time[j - 1])) for i, j in edges.reshape(-1, 2).tolist())


class EventWindows(NamedTuple):
    """Windows of a run before and from its first event on.

    Attributes:
        before: window from the start to the first event, or to the end of a run without events.
        after: window from the first event on; None without events.
        last_end: end of the last event, s; 0 without events.
    """

    before: Window
    after: Window | None
    last_end: float

    @classmethod
    def of(cls, scenario: Scenario, end: float) -> Self:
        """Return the windows of a run of a scenario that ended at a time, s."""
        if not scenario.events:
            return cls(Window(0.0, end), None, 0.0)
        first = min(event.time for event in scenario.events)
        after = Window(first, end) if first < end else None
        return cls(Window(0.0, min(first, end)), after, max(event.end for event in scenario.events))


def phases(data: Arrays, scenario: Scenario, counted: Mask) -> dict[str, Mask]:
    """Return the samples of each of PHASES, shape (..., n).

    The reference moves where its twist is not zero. Moving and at rest are without the decay of what the run
    starts with, and without events that last and the recovery that the task limits allow after events.
    "after_event" is from the end of that of the last event on.

    Args:
        data: arrays of a run.
        scenario: scenario of the run.
        counted: mask of the samples after the decay, shape (..., n).
    """
    time, moves = np.asarray(data["time"]), np.asarray(data["desired_twist"]).any(axis=-1)
    calm = counted & ~recovering(time, scenario)
    for event in scenario.events:
        calm &= ~((time > event.time - _SLACK) & (time < event.end - _SLACK))
    last = max((event.end for event in scenario.events), default=math.inf) + scenario.task.recovery
    after = np.broadcast_to(time > last - _SLACK, calm.shape)
    return {"moving": calm & moves, "rest": calm & ~moves, "after_event": after}


def metric_windows(
    metric: str,
    data: Arrays,
    scenario: Scenario,
    masks: Mapping[str, Mask],
    since: Mapping[str, Array],
) -> tuple[Window, ...]:
    """Return the windows that a metric is taken over.

    Args:
        metric: name of the metric.
        data: arrays of a run.
        scenario: scenario of the run.
        masks: samples of its phases, as ``phases`` returns them.
        since: times from which the largest errors count, s, by metric.
    """
    time = np.asarray(data["time"])
    whole = Window(float(since.get(metric, 0.0)), float(time[-1]))
    for phase, mask in masks.items():
        if metric.startswith(phase):
            return spans(time, mask)
    events = EventWindows.of(scenario, whole.end)
    if metric == "settling_time_s":
        return (events.before,)
    return (events.after or whole if metric in _OF_EVENTS else whole,)


def recovering(time: Array, scenario: Scenario) -> Mask:
    """Return which samples are from an event to its recovery, where the task limits allow any, shape (n,)."""
    allowed, mask = scenario.task.recovery, np.zeros(len(time), dtype=bool)
    for event in scenario.events if allowed > 0.0 else ():
        mask |= (time > event.time - _SLACK) & (time < event.end + allowed + _SLACK)
    return mask
