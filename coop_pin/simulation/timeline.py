"""Timeline of a run: ticks, plant steps within them, and events at their exact times."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from coop_pin.description.events import PayloadEvent
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
        self, clock: Clock, duration: float, events: Sequence[PayloadEvent], instants: Iterable[float] = ()
    ) -> None:
        self.ticks = clock.ticks(duration)
        self.period = clock.period
        self._step = clock.period / clock.steps_per_tick
        self._per_tick = clock.steps_per_tick
        times = (time for event in events for time in (event.time, event.end))
        self._instants = sorted({*times, *instants})

    def time(self, tick: int) -> float:
        """Return t_k, s."""
        return tick * self.period

    def steps(self, tick: int) -> Iterator[PlantStep]:
        """Yield the plant steps of a tick, cut at event times."""
        start, end, step = self.time(tick), self.time(tick + 1), self._step
        ends: Iterable[float] = (start + index * step for index in range(1, self._per_tick))
        ends = itertools.chain(ends, (end,))
        if self._instants and (cuts := self._cuts(start, end)):
            ends = heapq.merge(ends, cuts)
        left = start
        for right in ends:
            yield PlantStep(left, right - left)
            left = right

    def happens_at(self, time: float) -> bool:
        """Return whether any event starts or ends at this time."""
        instants, tolerance = self._instants, _SAME * self._step
        if not instants or not instants[0] - tolerance <= time <= instants[-1] + tolerance:
            return False
        return any(abs(time - instant) <= tolerance for instant in instants)

    def event_times(self) -> list[float]:
        """Return the times at which events act: at ticks before the controller, and between plant steps."""
        nearest, times = {round(instant / self.period) for instant in self._instants}, list[float]()
        for tick in sorted({tick for near in nearest for tick in range(near - 1, near + 2)}):
            if 0 <= tick < self.ticks:
                times += [step.start for step in self.steps(tick)]
            elif tick == self.ticks:
                times.append(self.time(tick))
        return list(filter(self.happens_at, times))

    def just_after(self, time: float) -> float:
        """Return the latest time that counts as the same instant, s."""
        return time + _SAME * self._step

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
