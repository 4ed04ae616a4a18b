"""Timeline of a run: ticks, the stages of each in their order, and events at their exact times.

Loop, lanes, environments and replays of a run go through the same stages. What a stage does is the runner's:
``Simulation`` acts on a plant, ``Schedule`` (coop_pin.compiled) calls kernels of compiled code.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple, TypeAlias

from coop_pin.description.events import PayloadEvent
from coop_pin.description.plant import Clock
from coop_pin.simulation.devices.drives import CellDrives

# Two times closer than this part of a plant step are the same instant.
_SAME = 1e-9

StageKind: TypeAlias = Literal[
    "measure", "happen", "command", "record", "sample", "drive", "advance", "release"
]
"""Kind of a stage.

measure: sensors and references, and what they need of the plant;
happen: events at the time, after what was measured: the law notices them a tick later;
command: messages, law and drives, whose torques are held from then on;
record: state, forces and wrenches under these torques;
sample: servos within a tick;
drive: mean torques over a plant step, where drives lag or lose their torque;
advance: plant step;
release: torques at the end of the tick, where drives lag or lose their torque.
"""
Stage: TypeAlias = tuple[StageKind, float, float, tuple[int, ...]]
"""Kind, time, s, length of a plant step, s, or zero, and arms whose servos sample, by index."""


class PlantStep(NamedTuple):
    """One plant step.

    Attributes:
        start: s.
        length: s.
    """

    start: float
    length: float


class Timeline:
    """Ticks and events of a run with the stages of its ticks, and further instants at which steps are cut.

    Attributes:
        ticks: number of control periods; the run has ticks + 1 samples.
        period: T, s.
    """

    def __init__(
        self,
        clock: Clock,
        duration: float,
        events: Sequence[PayloadEvent],
        instants: Iterable[float] = (),
        drives: CellDrives | None = None,
    ) -> None:
        """Lay out the times.

        Args:
            clock: Rate of the ticks, and plant steps in each.
            duration: Duration of the run, s.
            events: Events.
            instants: Further instants at which plant steps are cut, s.
            drives: Drives of the cell; without servos and lag when omitted.
        """
        self.ticks = clock.ticks(duration)
        self.period = clock.period
        self._step = clock.period / clock.steps_per_tick
        self._per_tick = clock.steps_per_tick
        times = (time for event in events for time in (event.time, event.end))
        self._instants = sorted({*times, *instants})
        self._varies = drives is not None and drives.response is not None
        self._due = drives.due if drives is not None and drives.samples() else None

    def time(self, tick: int) -> float:
        """Return t_k, s."""
        return tick * self.period

    def stages(self, tick: int) -> Iterator[Stage]:
        """Yield the stages of a tick in their order."""
        yield from self.before_command(tick)
        yield from self.from_command(tick)

    def before_command(self, tick: int) -> Iterator[Stage]:
        """Yield the stages of a tick before its command."""
        time = self.time(tick)
        yield "measure", time, 0.0, ()
        if self.happens_at(time):
            yield "happen", time, 0.0, ()

    def from_command(self, tick: int) -> Iterator[Stage]:
        """Yield the stages of a tick from its command on; the last tick has no plant steps."""
        time = self.time(tick)
        yield "command", time, 0.0, ()
        yield "record", time, 0.0, ()
        if tick == self.ticks:
            return
        for start, length in self.steps(tick):
            if start > time:
                if self.happens_at(start):
                    yield "happen", start, 0.0, ()
                if self._due and (due := self._due((start - time) / self.period)):
                    yield "sample", start, 0.0, due
            if self._varies:
                yield "drive", start, length, ()
            yield "advance", start, length, ()
        if self._varies:
            yield "release", self.time(tick + 1), 0.0, ()

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
        """Return the times at which events act."""
        nearest = {round(instant / self.period) for instant in self._instants}
        ticks = sorted({tick for near in nearest for tick in range(near - 1, near + 2)})
        stages = itertools.chain(*(self.stages(tick) for tick in ticks if 0 <= tick <= self.ticks))
        return [time for kind, time, *_ in stages if kind == "happen"]

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
