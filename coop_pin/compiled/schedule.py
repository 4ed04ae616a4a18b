"""Program of the runs of a batch: traced code, the order of its kernels, and what each run begins with.

Traced code is kept on disk: another process need not trace it again.
"""

from __future__ import annotations

import copy
import hashlib
import pickle
import zlib
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.disk_cache import keep, kept, package_digest
from coop_pin.compiled.block import RunBlock
from coop_pin.compiled.laws.law_code import as_tracing_errors
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.compiled.tick import TickCode, sample_name
from coop_pin.tracing.kernel import LOAD, RECORD, Program
from coop_pin.tracing.llvm_emitter import llvm_text
from coop_pin.tracing.tree import leaves, structure, valued


class RunProgram:
    """Program of runs that differ from a first one in chosen numbers.

    Attributes:
        block: slots of the runs.
        program: kernels, or their text, without an order.
    """

    @as_tracing_errors()
    def __init__(
        self,
        first: Prepared,
        differs: Mask,
        is_loaded: Mask,
        width: int | None = None,
        others: Sequence[Prepared] = (),
    ) -> None:
        """Trace the kernels, or read their text from disk.

        Args:
            first: Batch whose first run has the numbers that fold.
            differs: Leaves of the constants that are inputs.
            is_loaded: Entries of the signals that are inputs.
            width: Number of lanes of LLVM's registers, for a text; None keeps the kernels themselves.
            others: Runs with other times and signals that have the code, too.

        Raises:
            TracingError: The runs cannot be traced.
        """
        is_whole = len(first.signals[0]) > first.plants[0].timeline.ticks  # else any may change later
        is_uniform = ~is_loaded & (varying([first, *others]) | (not is_whole))
        self.block = RunBlock(first, differs, is_uniform, is_loaded)
        self.program, self._names, self._law = _traced(self.block, first, width)

    def order(self, run: Prepared, *, is_recorded: bool = True) -> Schedule:
        """Return the order of the kernels of a run, from its first tick on; with or without its record."""
        schedule = Schedule(run.plants[0], self.block, self._names, is_recorded=is_recorded)
        return schedule.later(run.signals[0])

    def begin(self, prepared: Prepared) -> tuple[Array, Array]:
        """Return the initial block, shape (slots, runs), and the loads, shape (ticks + 1, loaded, runs)."""
        lanes, is_loaded = self.program.lanes, self.block.is_loaded
        plants, count = prepared.plants, len(prepared.plants)
        block = np.zeros((lanes.size, count))
        for name, values in (
            *((name, [plant.begins[name] for plant in plants]) for name in plants[0].begins),
            ("constants", prepared.values[:, self.block.differs]),
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


def _traced(block: RunBlock, first: Prepared, width: int | None) -> tuple[Program, list[str], Any]:
    """Return the program, the names of its kernels, and a tree like the state of the law; see RunProgram."""
    is_kept = width is not None and not first.is_foreign  # users' modules may change
    key = _key(block, first, width) if is_kept else b""
    if is_kept and (content := kept(key)):
        return pickle.loads(zlib.decompress(content))
    code = TickCode(block, exact=first.is_foreign)
    program = Program(code.kernels(), block.lanes, block.recorded, block.loaded)
    names, law = [kernel.name for kernel in program.kernels], [0.0] * len(leaves(code.law))
    if width is not None:
        program = program._replace(text=llvm_text(program, width), width=width, kernels=())
    traced = program, names, valued(code.law, iter(law))
    if is_kept:
        keep(key, zlib.compress(pickle.dumps(traced), 1))
    return traced


def _key(block: RunBlock, first: Prepared, width: int | None) -> bytes:
    """Return the digest of what the code depends on: the package, structure and numbers of the runs."""
    plant, masks = first.plants[0], (block.differs, block.is_uniform, block.is_loaded)
    folded = first.values[0][~block.differs], first.signals[0][0][~(block.is_uniform | block.is_loaded)]
    shape = first.kind[:3], structure(plant.example), structure(plant.drives)
    digest = hashlib.sha256(repr((package_digest(), np.__version__, width, shape)).encode())
    for part in (*folded, *masks):
        digest.update(part.tobytes())
    return digest.digest()


class Schedule:
    """Order of the kernels of a run at some of its ticks; rows of loads and record begin with the first.

    Attributes:
        instructions: instructions in order, as of Program.
        uniforms: numbers that all runs share, to which they refer, shape (rows, uniforms).
        ticks: index of the first instruction of each tick.
    """

    def __init__(
        self, plant: PreparedPlant, block: RunBlock, kernels: Sequence[str], *, is_recorded: bool
    ) -> None:
        """Begin before the first tick, without instructions.

        Args:
            plant: Plant of one of the runs, for the order of its stages.
            block: Block of the runs.
            kernels: Names of the kernels of the block.
            is_recorded: Whether ticks are recorded.
        """
        self._index = {name: index for index, name in enumerate(kernels)}
        self._tick, self._events, self._block, self._is_recorded = 0, 0, block, is_recorded
        self._slots = {name: block.uniforms.slots(name) for name in block.uniforms.names}
        self._timeline, self._gives = plant.timeline, plant.actuation.gives
        self._target = 0.0  # time of the last command, or sample of a servo

    def later(self, signals: Array) -> Self:
        """Return the order at the ticks that come next.

        Args:
            signals: Signals at them, shape (n, entries).
        """
        other = copy.copy(self)
        other._lay_out(signals[:, self._block.is_uniform])
        return other

    def _lay_out(self, signals: Array) -> None:
        """Lay out ticks, given the signals at them that are uniform.

        Calls and torques are plain numbers: thousands of tuples would be searched for garbage.
        """
        self._calls, self.ticks = list[int](), list[int]()
        self._rows, self._steps = list[Array](), dict[float, int]()
        self._tick_rows, self._since, self._given = len(signals), list[float](), list[float]()
        for row in range(len(signals)):
            self.ticks.append(len(self._calls) // 2)
            self._lay_out_tick(row)
            self._tick += 1
        self.instructions = np.array(self._calls, dtype=np.int64).reshape(-1, 2)
        self.uniforms = np.zeros((self._tick_rows + len(self._rows), self._block.uniforms.size))
        self.uniforms[self._tick_rows :] = self._rows or 0.0
        for name, values in (("s", self._since), ("gives", self._given), ("signals", signals)):
            slots = self._slots[name]
            self.uniforms[: self._tick_rows, slots] = np.reshape(values, (-1, *slots.shape))
        del self._calls, self._rows, self._steps, self._since, self._given

    def _lay_out_tick(self, row: int) -> None:
        """Add the kernels of the next tick, whose uniforms are in a row."""
        has_rates = False
        for kind, time, length, due in self._timeline.stages(self._tick):
            match kind:
                case "advance":
                    if (step := self._steps.get(length, -1)) < 0:
                        step = self._steps[length] = self._row(h=length)
                    if not has_rates:  # else the observation has left them
                        self._call("rates", step)
                    self._call("step", step)
                    has_rates = False
                case "measure":
                    if self._block.loaded:
                        self._calls += LOAD, row
                    if not self._tick:
                        self._call("start", row)
                    elif self._block.constants.sensors.needs_wrenches:
                        self._call("weigh", row)
                case "command":
                    commands = self._gives(time)
                    self._since.append(time - self._target)
                    self._given += [*commands.torques, *commands.commands]
                    self._target = time
                    self._call("tick", row)
                case "record":
                    self._call("observe", row)
                    self._calls += (RECORD, row) * self._is_recorded
                    has_rates = True
                case "happen":
                    self._call(f"event_{self._events}", 0)
                    self._events += 1
                case "sample":
                    self._call(sample_name(due), self._row(s=time - self._target, gives=self._gives(time)))
                    self._target = time
                case "drive":
                    last, has_rates = self._gives(time), False
                    self._call("drive", self._row(h=length, s=time - self._target, gives=last))
                case "release":
                    self._call("release", self._row(s=time - self._target, gives=last))

    def _row(self, **fields: Any) -> int:
        """Return the index of a new row of uniforms."""
        values = np.zeros(self._block.uniforms.size)
        for name, value in fields.items():
            values[self._slots[name]] = value
        self._rows.append(values)
        return self._tick_rows + len(self._rows) - 1

    def _call(self, kernel: str, row: int) -> None:
        self._calls += self._index[kernel], row
