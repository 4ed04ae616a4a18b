"""Estimated duration of a sweep, from its first run: a second of it, or a small batch."""

from __future__ import annotations

import contextlib
import datetime
import time
from typing import NamedTuple

from coop_pin.base.arrays import typed
from coop_pin.base.errors import RunTimeoutError
from coop_pin.compiled.engine_choice import EngineChoice, choose_engines
from coop_pin.description.scenario import Scenario
from coop_pin.running.run_scenario import run
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.workers.execution import Execution
from coop_pin.sweeps.workers.job import Job, deadline

_SAMPLE_S = 1.0
"""Time for which the ticks of a run are timed, s."""
_SAMPLE_RUNS = 16
"""Runs of a batch that is timed."""


class Estimate(NamedTuple):
    """Estimated duration of a sweep.

    Attributes:
        runs: number of runs.
        run_s: duration of one run, s.
        workers: number of runs computed at a time.
        engine: engine of the runs, and why it is this one.
    """

    runs: int
    run_s: float
    workers: int
    engine: EngineChoice

    @property
    def total_s(self) -> float:
        """Duration of the sweep, s."""
        return self.runs * self.run_s / self.workers

    def summary(self) -> str:
        """Return the estimate on one line."""
        total = datetime.timedelta(seconds=round(self.total_s))
        how = self.engine.summary()
        return f"about {total} h for {self.runs} runs of {self.run_s:.2g} s on {self.workers} workers; {how}"


@typed
def estimate(plan: SweepPlan, *, workers: int | None = None) -> Estimate:
    """Return the estimated duration of a sweep, from its first point: a second of it, or a small batch.

    Args:
        plan: the points.
        workers: number of processes, 0 for this process; one for each processor when omitted.

    Raises:
        FieldError: the number of workers is negative.
        CoopPinError: the first point cannot be run.
    """
    count, scenario = max(Execution(workers=workers).processes, 1), plan.scenario(0)
    (choice,) = choose_engines([scenario], plan.engine, [len(plan)])
    timed = _batch_run_s if choice.way == "lanes" else _single_run_s
    timed(scenario)  # the first run of a process also loads modules and compiles
    return Estimate(len(plan), timed(scenario), count, choice)


def _batch_run_s(scenario: Scenario) -> float:
    """Return the duration of a run of a batch, s, without tracing and compiling."""
    from coop_pin.sweeps.workers.batch_job import run_batch  # slow to load

    jobs = [Job("", scenario.replace(seed=seed), way="lanes") for seed in range(_SAMPLE_RUNS)]
    start = time.perf_counter()
    run_batch(jobs)
    return (time.perf_counter() - start) / _SAMPLE_RUNS


def _single_run_s(scenario: Scenario) -> float:
    """Return the duration of a run, s, from those ticks that end within a second."""
    ticks, start, stop = list[int](), time.perf_counter(), deadline(_SAMPLE_S)

    def note(tick: int, total: int) -> None:
        ticks.append(total)
        stop(tick, total)

    with contextlib.suppress(RunTimeoutError):
        run(scenario, progress=note, warn=False)
    return (time.perf_counter() - start) * ticks[0] / len(ticks)
