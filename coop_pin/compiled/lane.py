"""One run as one lane of a batch, in chunks of ticks between which it can be interrupted.

Of a long run, signals, schedule and record are made for some thousand ticks at a time, so that its memory is
that of the samples which it keeps.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import TracingError
from coop_pin.compiled.kind import law_reason
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.compiled.samples import RunSamples, kept_of
from coop_pin.compiled.simulate import BatchSimulator, Family, require_sample_memory
from coop_pin.description.scenario import Scenario
from coop_pin.results.quantity import Samples
from coop_pin.results.run_result import RunResult
from coop_pin.results.running_metrics import RunningMetrics
from coop_pin.simulation.simulate import Progress, errors_with_results
from coop_pin.simulation.simulation import Simulation
from coop_pin.tracing.llvm_machine import LlvmMachine

_CHUNK = 4096
"""Calls of kernels between two looks at Ctrl-C; one takes at most some 50 us."""
_LONG, _PART = 20_000, 4_096
"""Ticks of a run from which on signals, schedule and record are made in parts, and ticks of a part: of 20 000
they take some 200 MB."""


class LaneSimulator(BatchSimulator):
    """Code for single runs. The numbers of the package's laws are inputs: other gains need no other code."""

    is_alone = True

    def __init__(self, *, is_brief: bool) -> None:
        """Begin without code.

        Args:
            is_brief: whether to compile for few ticks; see LlvmMachine.
        """
        super().__init__(width=1, is_brief=is_brief)
        self._folding = BatchSimulator(width=1, is_brief=is_brief)

    def lane(self, scenario: Scenario, simulation: Simulation | None) -> tuple[Prepared, Family]:
        """Return a run before it runs, and its code; raises as Lane.

        Each run has an order of kernels with signals and times of its own.
        """
        if reason := law_reason(scenario.controller):
            raise TracingError(reason)
        plant = PreparedPlant(scenario, _PART if _is_long(scenario) else None, simulation=simulation)
        run = Prepared.of_run(scenario, plant)
        run = run._replace(kind=run.kind.alone(run.signals[0]))
        try:
            return run, self.family([run])
        except TracingError:  # a law that needs its own numbers while it is traced: they fold, as users' do
            if run.is_foreign:
                raise
            return run, self._folding.family([run])

    def _inputs(self, first: Prepared, prepared: Prepared) -> Mask:
        is_law = np.arange(first.values.shape[1]) >= len(first.plants[0].values)
        return super()._inputs(first, prepared) | (is_law & (not first.is_foreign))


def _is_long(scenario: Scenario) -> bool:
    """Return whether a run is made in parts."""
    return scenario.clock.ticks(scenario.duration) > _LONG


_simulators = {is_long: LaneSimulator(is_brief=not is_long) for is_long in (False, True)}
"""With the code of the last runs of a process, by whether they are long."""


class Lane:
    """A run as one lane of a batch, with the record of a single run: every quantity at the ticks it keeps."""

    def __init__(self, scenario: Scenario, simulation: Simulation | None = None) -> None:
        """Prepare the run, and compile its code unless that is known.

        Args:
            scenario: Scenario to run.
            simulation: run of the scenario by Pinocchio before its first tick, whose numbers are read; a new
                one when None.

        Raises:
            TracingError: it cannot run as compiled code.
            NotEnoughMemoryError: the samples do not fit.
            CoopPinError: it cannot start.
        """
        self._scenario, self._every = scenario, scenario.clock.record_every
        self._prepared, family = _simulators[_is_long(scenario)].lane(scenario, simulation)
        _, machine, self._order = family.orders[self._prepared.kind.times]
        self._code, plant = family.code, self._prepared.plants[0]
        require_sample_memory(machine, 1)
        block, _ = self._code.begin(self._prepared)
        self._block, self._record = np.ascontiguousarray(block.T), machine.new_record(1)
        self._timeline, self._done, self._first = plant.timeline, 0, 0
        self._kept, self._count, self._running = dict[str, Array](), 0, RunningMetrics(scenario, plant.labels)
        self._bind(cast(LlvmMachine, machine))

    def run(self, progress: Progress | None = None) -> RunResult | None:
        """Return the result; None where the run breaks a guard, so that a single run must tell its error.

        Args:
            progress: Function that is called after every chunk of ticks.

        Raises:
            RunInterruptedError: Ctrl-C; it carries the result up to the last chunk as ``result``.
            CoopPinError: of ``progress``, with the result up to then.
        """
        ticks = self._timeline.ticks
        with errors_with_results(
            lambda: self._result() if self._done else None, lambda: self._timeline.time(self._done)
        ):
            while self._done <= ticks:
                self._advance()
                if self._block[0, self._code.program.lanes.slots("is_valid")] != 1.0:
                    return None
                if progress is not None:
                    progress(self._done - 1, ticks)
        return self._result()

    def _bind(self, machine: LlvmMachine) -> None:
        """Let the next calls run the order that was laid out last, by a machine in any order."""
        order = self._order
        self._machine = machine.in_order(order.instructions)
        self._call = self._machine.bound(self._block, order.uniforms, self._record)
        self._starts = [*order.ticks, len(order.instructions)]

    def _advance(self) -> None:
        """Run the next chunk of ticks."""
        if self._done - self._first == len(self._starts) - 1:
            self._begin_part()
        starts, tick = self._starts, self._done - self._first
        first = starts[tick]
        end = max(tick + 1, int(np.searchsorted(starts, first + _CHUNK)) - 1)
        self._call(first, starts[end] - first)
        self._done = self._first + end

    def _begin_part(self) -> None:
        """Keep what the finished part of the run leaves, and begin the next one."""
        samples = self._samples()
        if self._every > 1:
            self._running.add(samples, self._scenario)
        self._count = self._keep(samples, is_last=False)
        self._first = self._done
        ticks = range(self._first, min(self._first + _PART, self._timeline.ticks + 1))
        plant, signals = self._prepared.plants[0].later(ticks)
        self._prepared = self._prepared._replace(plants=[plant], signals=[signals])
        self._order = self._order.later(signals)
        self._bind(self._machine)

    def _samples(self) -> Samples:
        """Return the samples of the ticks of the present part that are done."""
        records = [self._record[: self._done - self._first]]
        samples = RunSamples(self._prepared, self._code.program.lanes, records)
        table = self._prepared.plants[0].table
        return {each.name: samples[each.name][0] for each in table if each.stored or each.name == "time"}

    def _keep(self, samples: Samples, *, is_last: bool = True) -> int:
        """Keep every n-th sample of the present part, and the last one of the run; return how many."""
        kept = kept_of(len(samples["time"]), self._every, self._first)
        if not is_last and (self._done - 1) % self._every:
            kept = kept[:-1]
        count = self._count + len(kept)
        for name, values in samples.items():
            if name not in self._kept:
                most = self._timeline.ticks // self._every + 2
                self._kept[name] = np.empty((most, *values.shape[1:]), values.dtype)
            # Signals that stay fold, over a part or the run: code of either has zeros of another sign.
            self._kept[name][self._count : count] = values[kept] + 0.0
        return count

    def _result(self) -> RunResult:
        """Return the result of the ticks that are done."""
        plant, samples, attributes = self._prepared.plants[0], self._samples(), {RunResult.ENGINE: "compiled"}
        if self._every > 1:
            attributes[RunResult.EVERY_TICK] = self._running.finished(samples, self._scenario).to_text()
        count = self._keep(samples)
        kept = {name: values[:count] for name, values in self._kept.items()}
        pose = plant.source.motion.at(float(kept["time"][-1])).X_WP_d
        if remarks := self._prepared.controller().remarks(pose, self._code.law_state(self._block[0])):
            attributes[RunResult.REMARKS] = "\n".join(remarks)
        return RunResult(self._scenario, kept | plant.labels, attributes)
