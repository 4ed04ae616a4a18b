"""Timeline of a run: ticks, plant steps within them, and events at their exact times."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.events import Event
from coop_pin.description.plant import Clock

# Two times closer than this part of a plant step are the same instant.
_SAME = 1e-9


class PlantStep(NamedTuple):
    """One plant step.

    Attributes:
        start: s.
        length: s.
    """

    start: float
    length: float


class Timeline:
    """Ticks and events of a run, and further instants at which plant steps are cut.

    Attributes:
        ticks: number of control periods; the run has ticks + 1 samples.
        period: T, s.
    """

    def __init__(
        self, clock: Clock, duration: float, events: Sequence[Event], instants: Iterable[float] = ()
    ) -> None:
        self.ticks = clock.ticks(duration)
        self.period = clock.period
        self._step = clock.period / clock.steps_per_tick
        self._per_tick = clock.steps_per_tick
        self._events = events
        self._instants = sorted({time for event in events for time in event.instants} | {*instants})

    def time(self, tick: int) -> float:
        """Return t_k, s."""
        return tick * self.period

    def steps(self, tick: int) -> Iterator[PlantStep]:
        """Yield the plant steps of a tick, cut at event times."""
        start, end, step = self.time(tick), self.time(tick + 1), self._step
        edges: Iterable[float] = (start + index * step for index in range(self._per_tick))
        edges = itertools.chain(edges, (end,))
        if self._instants and (cuts := self._cuts(start, end)):
            edges = heapq.merge(edges, cuts)
        for left, right in itertools.pairwise(edges):
            yield PlantStep(left, right - left)

    def happens_at(self, time: float) -> bool:
        """Return whether any event starts or ends at this time."""
        instants, tolerance = self._instants, _SAME * self._step
        if not instants or not instants[0] - tolerance <= time <= instants[-1] + tolerance:
            return False
        return any(self._same(time, instant) for instant in instants)

    def event_times(self) -> list[float]:
        """Return the times at which events act: at ticks before the controller, and between plant steps."""
        nearest, times = {round(instant / self.period) for instant in self._instants}, list[float]()
        for tick in sorted({tick for near in nearest for tick in range(near - 1, near + 2)}):
            if 0 <= tick < self.ticks:
                times += [step.start for step in self.steps(tick)]
            elif tick == self.ticks:
                times.append(self.time(tick))
        return list(filter(self.happens_at, times))

    def events_at(self, time: float) -> list[Event]:
        """Return the events whose time this is, the earliest first."""
        events = [event for event in self._events if self._same(time, event.time)]
        return sorted(events, key=lambda event: event.time)

    def push_at(self, time: float) -> Array:
        """Return the sum of the wrenches that push from this time on, N and N m, shape (6,)."""
        pushes = [event.push_at(time + _SAME * self._step) for event in self._events]
        active = [wrench for wrench in pushes if wrench is not None]
        return np.array(active).sum(axis=0) if active else np.zeros(6)

    def _cuts(self, start: float, end: float) -> list[float]:
        """Return the event times within a tick at which no plant step ends, in order, s."""
        tolerance = _SAME * self._step
        cuts: list[float] = []
        for time in self._instants:
            if start + tolerance < time < end - tolerance:
                nearest = round((time - start) / self._step)
                edge = start + nearest * self._step if nearest < self._per_tick else end
                if min(abs(time - other) for other in (edge, *cuts[-1:])) > tolerance:
                    cuts.append(time)
        return cuts

    def _same(self, time: float, instant: float) -> bool:
        return abs(time - instant) <= _SAME * self._step
