"""Simulation of many runs at once: scenarios that differ in numbers, in one program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from coop_pin.arrays import Array, Mask, require_memory, require_type
from coop_pin.batch.kernel import RECORD, Layout, Machine, Program
from coop_pin.batch.llvm_machine import LlvmMachine
from coop_pin.batch.preparation import Prepared, prepare
from coop_pin.batch.run_program import RunProgram
from coop_pin.batch.run_samples import quantities_of_any, samples
from coop_pin.batch.support import require_traceable
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError
from coop_pin.results import RunResult
from coop_pin.results.dataset import without_time
from coop_pin.results.quantities import Samples, computed, quantities

LARGEST_BLOCK = 64
"""Runs that advance together; the samples of more leave the processor's caches."""

_COPIES = 3
"""Of the samples: as recorded, joined, and by names."""


class BatchResult:
    """Results of a batch.

    Attributes:
        scenarios: that were run.
        is_valid: which runs kept to the guards of a single run (finite and closed motion, regular Jacobians);
            the samples of the others mean nothing, shape (runs,).
        samples: as a single run has them, with a leading axis of runs.
    """

    def __init__(self, prepared: Prepared, layout: Layout, record: Array, is_valid: Mask) -> None:
        """Name the samples.

        Args:
            prepared: the batch.
            layout: of the record's slots.
            record: shape (samples, slots, runs).
            is_valid: see above.
        """
        self.scenarios, self.is_valid = prepared.scenarios, is_valid
        self._prepared = prepared
        self.samples = samples(prepared, layout, record)

    @cached_property
    def _values(self) -> Samples:
        """All quantities, with a leading axis of runs."""
        count, shares = len(self.scenarios), [scenario.cell.shares for scenario in self.scenarios]
        table = quantities_of_any(self.scenarios)
        if all(np.array_equal(own, shares[0]) for own in shares):  # then all runs are one row of samples
            flat = {name: values.reshape(-1, *values.shape[2:]) for name, values in self.samples.items()}
            with np.errstate(all="ignore"):  # of runs that are not valid
                found = computed(table, flat, shares[0])
            del found["load_share"]
            return {name: values.reshape(count, -1, *values.shape[1:]) for name, values in found.items()}
        runs = [
            computed(table, {name: values[index] for name, values in self.samples.items()}, own)
            for index, own in enumerate(shares)
        ]
        return {name: np.stack([run[name] for run in runs]) for name in runs[0]}

    def result(self, index: int) -> RunResult:
        """Return the result of one run, as coop_pin.run returns it."""
        scenario, recorder = self.scenarios[index], self._prepared.plants[index].run.recorder
        mine = {quantity.name: self._values[quantity.name][index] for quantity in quantities(scenario)}
        names = [joints for _, joints in recorder.joints]
        return RunResult(scenario, mine | without_time(scenario, names, recorder.limit_table()))


class BatchSimulator:
    """Simulates batches one after the other; code is compiled anew only when further numbers differ."""

    def __init__(self, *, machine: Callable[[Program], Machine] = LlvmMachine) -> None:
        """Begin without code.

        Args:
            machine: what runs programs.
        """
        self._new_machine = machine
        self._first: Prepared | None = None

    def run(self, scenarios: Sequence[Scenario]) -> BatchResult:
        """Return the results of scenarios; see simulate_batch. Those of other calls may be of other kinds."""
        if not scenarios:
            raise ArgumentError("scenarios is empty; give at least one")
        for index, scenario in enumerate(scenarios):
            require_type(f"scenarios[{index}]", scenario, Scenario)
        prepared = prepare(scenarios, None if self._first is None else self._first.plants[0])
        code = self._code(prepared)
        program, count = code.program, len(scenarios)
        needed = _COPIES * 8 * program.rows(RECORD) * program.recorded * count
        require_memory(f"samples of {count} runs", needed, "give fewer at once, or raise clock.record_every")
        block, loads = code.begin(prepared)
        parts = [slice(first, first + LARGEST_BLOCK) for first in range(0, count, LARGEST_BLOCK)]
        records = (self._machine.run(block[:, part], code.uniforms, loads[:, :, part]) for part in parts)
        record = next(records) if len(parts) == 1 else np.concatenate([own.copy() for own in records], axis=2)
        is_valid = block[program.lanes.slots("is_valid")] == 1.0
        return BatchResult(prepared, program.lanes, record, is_valid)

    def _code(self, prepared: Prepared) -> RunProgram:
        """Return a program in which every number that differs so far is an input."""
        if self._first is None or prepared.kind != self._first.kind:
            require_traceable(prepared.scenarios[0], prepared.plants[0].run, prepared.plants[0].constants)
            self._first, self._differs, self._is_loaded = prepared, np.array(False), np.array(False)
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
