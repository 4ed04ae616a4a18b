"""Simulation of many runs at once: scenarios that differ in numbers, in one program."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np

from coop_pin.arrays import Array, Mask, require_memory, require_type
from coop_pin.batch.preparation import Prepared, PreparedPlant, prepare
from coop_pin.batch.samples import RunSamples
from coop_pin.batch.schedule import RunProgram
from coop_pin.batch.support import require_traceable
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError
from coop_pin.results import RunResult
from coop_pin.results.metrics import all_metrics
from coop_pin.results.trust import TrustMonitor
from coop_pin.results.window import Windows
from coop_pin.tracing.kernel import RECORD, Layout, Machine, Program
from coop_pin.tracing.llvm_machine import LlvmMachine

LARGEST_BLOCK = 64
"""Runs that advance together; the samples of more leave the processor's caches."""

_COPIES = 3
"""Of the samples: as recorded, by names, and those of single results."""
_KEPT = 8
"""Plants of a batch that are kept for the next one."""


class RecordMemory:
    """Memory of released records, for later ones: new memory takes the time of the runs to be cleared."""

    def __init__(self) -> None:
        self._free: list[Array] = []

    def take(self, size: int) -> Array:
        """Return memory for ``size`` numbers or more, which is the caller's until it is given back."""
        try:
            memory = self._free.pop()
        except IndexError:
            return np.empty(size)
        return memory if memory.size >= size else np.empty(size)

    def give_back(self, parts: list[Array]) -> None:
        """Take the parts out of a list, for later records."""
        self._free += parts
        parts.clear()


class BatchResult:
    """Results of a batch.

    Attributes:
        scenarios: that were run.
        is_valid: which runs kept to the guards of a single run (finite and closed motion, regular Jacobians);
            the samples of the others mean nothing, shape (runs,).
        samples: quantities as a single run has them, with a leading axis of runs.
    """

    def __init__(
        self,
        prepared: Prepared,
        layout: Layout,
        records: Sequence[Array],
        is_valid: Mask,
        give_back: Callable[[], None],
    ) -> None:
        """Hold the records.

        Args:
            prepared: Scenarios, plants and numbers of the batch.
            layout: Slots of the records.
            records: Records of blocks of the runs, as a Machine returns them.
            is_valid: Which runs are valid, shape (runs,).
            give_back: Function that gives the memory of the records back.
        """
        self.scenarios, self.is_valid = prepared.scenarios, is_valid
        self._plants, self.samples = prepared.plants, RunSamples(prepared, layout, records)
        self._give_back = give_back

    def release(self) -> None:
        """Give the memory of the records to later batches.

        Samples, results and metrics that were returned before are copies and stay as they are. From now on,
        asking for others raises InvalidStateError.
        """
        self.samples.release()
        self._give_back()

    def result(self, index: int) -> RunResult:
        """Return the result of one run, as coop_pin.run returns it."""
        plant = self._plants[index]
        mine = {each.name: self.samples[each.name][index].copy() for each in plant.table}
        return RunResult(self.scenarios[index], mine | plant.labels)

    def metrics(self) -> list[dict[str, float]]:
        """Return the metrics of every run, as those of its result, without making the results."""
        first, labels = self.scenarios[0], [plant.labels for plant in self._plants]
        lower, upper = (np.stack([own[f"position_{side}"] for own in labels]) for side in ("lower", "upper"))
        time, extremes = self.samples["time"][0], self.samples.extremes(first.trust.jacobian_condition)
        data = ChainMap({"time": time, "arm": labels[0]["arm"], **extremes}, cast(Any, self.samples))
        with np.errstate(all="ignore"):  # of runs that are not valid
            trustworthy = ~TrustMonitor(first.trust, (), lower, upper).exceeded(data)
            found = all_metrics(data, Windows.of(first, float(time[-1])))
        for index, scenario in enumerate(self.scenarios):
            if scenario.trust != first.trust:
                trustworthy[index] = self.result(index).trustworthy
        columns = {"trustworthy": trustworthy} | found
        rows = np.stack(np.broadcast_arrays(*columns.values(), subok=False)).astype(float).T.tolist()
        return [dict(zip(columns, row, strict=True)) for row in rows]


class BatchSimulator:
    """Simulates batches one after the other; code is compiled anew only when further numbers differ."""

    def __init__(
        self, *, machine: Callable[[Program], Machine] = LlvmMachine, memory: RecordMemory | None = None
    ) -> None:
        """Begin without code.

        Args:
            machine: Class of the machine that runs programs.
            memory: Memory that several simulators share; of its own when omitted.
        """
        self._new_machine, self._memory = machine, memory or RecordMemory()
        self._first: Prepared | None = None
        self._plants = list[PreparedPlant]()

    def run(self, scenarios: Sequence[Scenario]) -> BatchResult:
        """Return the results of scenarios; see simulate_batch. Those of other calls may be of other kinds."""
        if not scenarios:
            raise ArgumentError("scenarios is empty; give at least one")
        for index, scenario in enumerate(scenarios):
            require_type(f"scenarios[{index}]", scenario, Scenario)
        prepared = prepare(scenarios, self._plants)
        code = self._code(prepared)
        self._plants = list(dict.fromkeys(prepared.plants))[-_KEPT:]
        program, count = code.program, len(scenarios)
        needed = _COPIES * 8 * program.rows(RECORD) * program.recorded * count
        require_memory(f"samples of {count} runs", needed, "give fewer at once, or raise clock.record_every")
        block, loads = code.begin(prepared)
        parts = [slice(first, first + LARGEST_BLOCK) for first in range(0, count, LARGEST_BLOCK)]
        taken, records = list[Array](), list[Array]()
        for part in parts:
            lanes = block[:, part]
            taken.append(self._memory.take(self._machine.record_size(lanes.shape[1])))
            records.append(self._machine.run(lanes, code.uniforms, loads[:, :, part], taken[-1]))
        is_valid = block[program.lanes.slots("is_valid")] == 1.0
        give_back = partial(self._memory.give_back, taken)
        return BatchResult(prepared, program.lanes, records, is_valid, give_back)

    def _code(self, prepared: Prepared) -> RunProgram:
        """Return a program in which every number that differs so far is an input."""
        if self._first is None or prepared.kind != self._first.kind:
            require_traceable(prepared.scenarios[0], prepared.plants[0].run, prepared.plants[0].constants)
            runs, plants, ticks, numbers, kind = prepared
            self._first = Prepared(runs[:1], plants[:1], ticks[:1], numbers[:1], kind)
            self._differs, self._is_loaded = np.array(False), np.array(False)
        folded, signals = self._first.values[:1], self._first.signals[0]
        same = (prepared.values == folded) | (np.isnan(prepared.values) & np.isnan(folded))
        differs = self._differs | ~same.all(axis=0)
        is_loaded = self._is_loaded
        for other in {id(other): other for other in prepared.signals}.values():
            is_loaded = is_loaded | (other != signals).any(axis=0)
        if not (np.array_equal(differs, self._differs) and np.array_equal(is_loaded, self._is_loaded)):
            self._differs, self._is_loaded = differs, is_loaded
            self._program = RunProgram(self._first, differs, is_loaded)
            self._machine = self._new_machine(self._program.program)
        return self._program


def simulate_batch(
    scenarios: Sequence[Scenario], *, machine: Callable[[Program], Machine] = LlvmMachine
) -> BatchResult:
    """Return the results of scenarios that differ in numbers only.

    Numbers in which they differ become inputs of the traced code, all others fold into it.

    Args:
        scenarios: with equal kinds of everything, equal times of ticks and events.
        machine: what runs the program.

    Raises:
        ArgumentError: there are none.
        TracingError: one cannot run in a batch, or they differ in more than numbers.
        MissingExtraError: llvmlite is not installed.
        NotEnoughMemoryError: the samples do not fit.
        CoopPinError: a run cannot start.
    """
    return BatchSimulator(machine=machine).run(scenarios)
