"""One run as one lane of a batch, in chunks of ticks between which it can be interrupted."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from typing import cast

import numpy as np

from coop_pin.arrays import Mask
from coop_pin.batch.preparation import Prepared
from coop_pin.batch.simulate import BatchResult, BatchSimulator, Family, require_sample_memory
from coop_pin.batch.single_runs import require_agreement_at_first
from coop_pin.batch.support import law_reason
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.results import RunResult
from coop_pin.simulation.simulate import Progress, errors_with_results
from coop_pin.tracing.llvm_machine import LlvmMachine

_CHUNK = 4096
"""Calls of kernels between two looks at Ctrl-C; one takes at most some 50 us."""
_KEPT_TICKS = 20_000
"""Of longer runs nothing is kept for later ones: their tables take 100 MB and more."""


class LaneSimulator(BatchSimulator):
    """Code for single runs. The numbers of the package's laws are inputs: other gains need no other code."""

    def __init__(self) -> None:
        """Begin without code."""
        super().__init__(machine=partial(LlvmMachine, width=1))
        self._folding = BatchSimulator(machine=self._new_machine)

    def lane(self, scenario: Scenario) -> tuple[Prepared, Family]:
        """Return a run before it runs, and its code; raises as Lane.

        The signals are part of the kind: each run has an order of kernels with its own.
        """
        if reason := law_reason(scenario.controller):
            raise TracingError(reason)
        run = self.prepare(scenario)
        signals = hashlib.sha256(run.signals[0].tobytes()).digest()
        run = run._replace(kind=(signals, *run.kind))
        try:
            family = self.family(run, run)
        except TracingError:  # a law that needs its own numbers while it is traced: they fold
            family = self._folding.family(run, run)
        self._plants.clear()  # files and functions of the user may change between runs
        if run.plants[0].run.timeline.ticks > _KEPT_TICKS:
            self.forget(family)
            self._folding.forget(family)
        return run, family

    def _inputs(self, first: Prepared, prepared: Prepared) -> Mask:
        is_law = np.arange(first.values.shape[1]) >= len(first.plants[0].values)
        return super()._inputs(first, prepared) | (is_law & (not first.is_foreign))


_simulator = LaneSimulator()
"""With the code of the last runs of a process."""


class Lane:
    """A run as one lane of a batch, with the record of a single run: every sample of every quantity."""

    def __init__(self, scenario: Scenario) -> None:
        """Prepare the run, and compile its code unless that is known.

        Raises:
            TracingError: it cannot run as compiled code.
            NotEnoughMemoryError: the samples do not fit.
            CoopPinError: it cannot start.
        """
        self._prepared, (*_, self._code, machine) = _simulator.lane(scenario)
        require_sample_memory(self._code.program, 1)
        block, _ = self._code.begin(self._prepared)
        self._block = np.ascontiguousarray(block.T)
        self._record = machine.new_record(1)
        self._call: Callable[[int, int], None] = cast(LlvmMachine, machine).bound(
            self._block, self._code.uniforms, self._record
        )
        self._timeline, self._done = self._prepared.plants[0].run.timeline, 0

    def run(self, progress: Progress | None = None) -> RunResult | None:
        """Return the result; None where the run breaks a guard, so that a single run must tell its error.

        Args:
            progress: Function that is called after every chunk of ticks.

        Raises:
            RunInterruptedError: Ctrl-C; it carries the result up to the last chunk as ``result``.
            TracingError: the law is a user's, and differs from that of the first ticks of a single run.
            CoopPinError: of ``progress``, with the result up to then.
        """
        starts, ticks = [*self._code.ticks, len(self._code.program.instructions)], self._timeline.ticks
        with errors_with_results(self._so_far, lambda: self._timeline.time(self._done)):
            while self._done <= ticks:
                first = starts[self._done]
                end = max(self._done + 1, int(np.searchsorted(starts, first + _CHUNK)) - 1)
                self._call(first, starts[end] - first)
                self._done = end
                if not self._is_valid():
                    return None
                if progress is not None:
                    progress(end - 1, ticks)
        result = self._result()
        if self._prepared.is_foreign:
            require_agreement_at_first(result)
        return result

    def _is_valid(self) -> bool:
        return bool(self._block[0, self._code.program.lanes.slots("is_valid")] == 1.0)

    def _so_far(self) -> RunResult | None:
        return self._result() if self._done else None

    def _result(self) -> RunResult:
        """Return the result of the ticks that are done."""
        every = self._prepared.scenarios[0].clock.record_every
        is_finished = self._done > self._timeline.ticks
        kept = len(self._record) if is_finished else (self._done - 1) // every + 1
        layout, valid = self._code.program.lanes, np.array([True])
        result = BatchResult(self._prepared, layout, [self._record[:kept]], valid, lambda: None).result(0)
        pose = self._prepared.plants[0].run.motion.at(result.end).X_WP_d
        if remarks := self._prepared.controller.remarks(pose, self._code.law_state(self._block[0])):
            result.data.attrs[RunResult.REMARKS] = "\n".join(remarks)
        return result
