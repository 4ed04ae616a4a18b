"""Program of the runs of a batch: kernels, the order of their calls, and what each run begins with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.batch.block import RunBlock, SignalSplit
from coop_pin.batch.preparation import Prepared
from coop_pin.batch.tick import sample_name
from coop_pin.batch.traced_code import traced_code
from coop_pin.simulation import Simulation
from coop_pin.simulation.timeline import Timeline
from coop_pin.tracing.kernel import LOAD, RECORD, Instruction, Program
from coop_pin.tracing.tree import valued


class Scheduled(NamedTuple):
    """Order of the kernels at some ticks of a run; rows of loads and of the record begin with the first.

    Attributes:
        instructions: instructions in order.
        uniforms: numbers that all runs share, to which they refer, shape (rows, uniforms).
        ticks: index of the first instruction of each tick.
    """

    instructions: Sequence[Instruction]
    uniforms: Array
    ticks: list[int]


class RunProgram:
    """Program of runs that differ from a first one in chosen numbers.

    Attributes:
        block: slots of the runs.
        program: program for a machine, of the first ticks of which ``first`` has the signals.
        uniforms: numbers that all runs share, shape (rows, uniforms).
        ticks: index of the first instruction of each tick.
    """

    def __init__(
        self,
        first: Prepared,
        differs: Mask,
        is_loaded: Mask,
        width: int | None = None,
        others: Sequence[Prepared] = (),
    ) -> None:
        """Trace and order the kernels.

        Args:
            first: Batch whose first run has the numbers that fold.
            differs: Leaves of the constants that are inputs.
            is_loaded: Entries of the signals that are inputs.
            width: Number of lanes of LLVM's registers, as of traced_code.
            others: Runs with other times and signals that have the code, too.
        """
        plant, signals = first.plants[0], first.signals[0]
        is_whole = len(signals) > plant.run.timeline.ticks  # else any may change later
        is_uniform = ~is_loaded & (varying([first, *others]) | (not is_whole))
        split = SignalSplit(plant.example, signals[0], is_uniform, is_loaded)
        self.block = RunBlock(first.constants, plant.start, differs, split, plant.read)
        self._differs, block = differs, self.block
        code = traced_code(block, first, differs, width)
        self._law, self._names = code.law, code.names
        self._schedule = Schedule(plant.run, block, code.names)
        instructions, self.uniforms, self.ticks = self.next_ticks(signals)
        self.program = Program(
            code.kernels, code.lanes, block.recorded, block.loaded, instructions, code.text
        )

    def next_ticks(self, signals: Array) -> Scheduled:
        """Return the order of the kernels at the ticks that come next.

        Args:
            signals: Signals at them, shape (n, entries).
        """
        return self._schedule.next_ticks(signals[:, self.block.signals.is_uniform])

    def order(self, run: Prepared) -> Scheduled:
        """Return the order of the kernels of another run, from its first tick on."""
        schedule = Schedule(run.plants[0].run, self.block, self._names)
        return schedule.next_ticks(run.signals[0][:, self.block.signals.is_uniform])

    def begin(self, prepared: Prepared) -> tuple[Array, Array]:
        """Return the initial block, shape (slots, runs), and the loads, shape (ticks + 1, loaded, runs)."""
        lanes, is_loaded = self.program.lanes, self.block.signals.is_loaded
        plants, count = prepared.plants, len(prepared.plants)
        block = np.zeros((lanes.size, count))
        for name, values in (
            *((name, [plant.begins[name] for plant in plants]) for name in plants[0].begins),
            ("constants", prepared.values[:, self._differs]),
            ("is_valid", np.ones((count, 1))),
        ):
            numbers = np.array(values, dtype=np.float64).reshape(count, -1).T
            block[lanes.filled(name, len(numbers))] = numbers
        if not is_loaded.any():
            return block, np.zeros((1, 0, count))
        return block, np.stack([signals[:, is_loaded] for signals in prepared.signals], axis=2)

    def law_state(self, slots: Array) -> Any:
        """Return the state of the law in the slots of a run, shape (slots,)."""
        return valued(self._law, iter(slots[self.program.lanes.slots("law")].tolist()))


def varying(runs: Sequence[Prepared]) -> Mask:
    """Return which signals of runs change in time, or from one of the runs to the next, shape (entries,)."""
    first = runs[0].signals[0][:1]
    return np.any([(run.signals[0] != first).any(axis=0) for run in runs], axis=0)


class Schedule:
    """Order of the kernels of a run, for some of its ticks after the other."""

    def __init__(self, run: Simulation, block: RunBlock, kernels: Sequence[str]) -> None:
        """Begin before the first tick.

        Args:
            run: Simulation of one of the runs, for its timeline.
            block: Block of the runs.
            kernels: Names of the kernels of the block.
        """
        self._index = {name: index for index, name in enumerate(kernels)}
        self._tick, self._events, self._block = 0, 0, block
        self._slots = {name: block.uniforms.slots(name) for name in block.uniforms.names}
        self._timeline, self._actuation = run.timeline, run.actuation
        self._target = 0.0  # time of the last command, or sample of a servo

    def next_ticks(self, signals: Array) -> Scheduled:
        """Return the order of the kernels at the ticks that come next.

        Args:
            signals: Signals at them that are uniform, shape (n, ...).
        """
        self._instructions, self._rows = list[Instruction](), list[Array]()
        self._steps, ticks = dict[float, int](), list[int]()
        timeline, block = self._timeline, self._block
        for index, uniform in enumerate(signals):
            tick, self._tick = self._tick, self._tick + 1
            time = timeline.time(tick)
            ticks.append(len(self._instructions))
            since, self._target = time - self._target, time
            row = self._row(s=since, gives=self._actuation.gives(time), signals=uniform)
            if block.loaded:
                self._instructions.append(Instruction(LOAD, index))
            if not tick:
                self._call("start", row)
            elif block.constants.sensors.needs_wrenches:
                self._call("weigh", row)
            self._call("tick", row)
            self._happen(timeline, time)  # measured and computed before: the law sees it a tick later
            self._call("observe", row)
            self._instructions.append(Instruction(RECORD, index))
            if tick < timeline.ticks:
                self._advance(timeline, tick)
        return Scheduled(self._instructions, np.array(self._rows), ticks)

    def _advance(self, timeline: Timeline, tick: int) -> None:
        """Add the plant steps of a tick."""
        time, varies, row = timeline.time(tick), not self._actuation.is_held, 0
        drives = self._actuation.drives
        gives = self._actuation.gives(time)
        for index, (start, length) in enumerate(timeline.steps(tick)):
            if index > 0:
                self._happen(timeline, start)
                if due := drives.due((start - time) / timeline.period):
                    since, self._target = start - self._target, start
                    self._call(sample_name(due), self._row(s=since, gives=self._actuation.gives(start)))
            if varies:
                gives = self._actuation.gives(start)
                row = self._row(h=length, s=start - self._target, gives=gives)
                self._call("drive", row)
            elif length in self._steps:
                row = self._steps[length]
            else:
                row = self._steps[length] = self._row(h=length)
            if varies or index > 0:  # else the observation has left them
                self._call("rates", row)
            self._call("step", row)
        if varies:
            self._call("release", self._row(s=timeline.time(tick + 1) - self._target, gives=gives))

    def _row(self, **fields: Any) -> int:
        """Return the index of a new row of uniforms."""
        values = np.zeros(self._block.uniforms.size)
        for name, value in fields.items():
            values[self._slots[name]] = value
        self._rows.append(values)
        return len(self._rows) - 1

    def _call(self, kernel: str, row: int) -> None:
        self._instructions.append(Instruction(self._index[kernel], row))

    def _happen(self, timeline: Timeline, time: float) -> None:
        """Add the kernel of the events at a time, if there are any."""
        if timeline.happens_at(time):
            self._call(f"event_{self._events}", 0)
            self._events += 1
