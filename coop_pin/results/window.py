"""Windows of time over which the metrics of a run are taken."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from coop_pin.base.arrays import Mask
from coop_pin.base.errors import ArgumentError, OutOfRangeError
from coop_pin.description.scenario import Scenario
from coop_pin.results.quantities import Arrays

SETTLING_S = 4.0
"""Time that a run has to settle after its start and after its last event before it is called steady, s."""
RUN_END = "run_end"
"""Name of the time at which a run ends, s, in arrays of a part of it that is not the last."""
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
        return "empty window" if self.is_empty else f"{self.start:g} to {self.end:g} s"


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


class Windows(NamedTuple):
    """Windows of the metrics of a run.

    Attributes:
        steady: window of means and rms values, from 4 s to the first event.
        event: window from the first event on.
        after_event: window from 4 s after the last event ended; empty without events.
        has_events: whether there are events; they end at the end of the run otherwise.
    """

    steady: Window
    event: Window
    after_event: Window
    has_events: bool

    @classmethod
    def of(cls, scenario: Scenario, end: float) -> Self:
        """Return the windows of a run of a scenario that ended at a time, s."""
        events = scenario.events
        first = min((event.time for event in events), default=end)
        last = max((event.end for event in events), default=end)
        steady, after = Window(SETTLING_S, min(first, end)), Window(last + SETTLING_S, end)
        return cls(steady, Window(first, end), after, bool(events))
