"""Estimated duration of a sweep, from some ticks of its first run."""

from __future__ import annotations

import contextlib
import datetime
import time
from typing import NamedTuple

from coop_pin.description.scenario import Scenario
from coop_pin.errors import RunTimeoutError
from coop_pin.run_scenario import run
from coop_pin.sweeps.execution import Execution
from coop_pin.sweeps.job import deadline
from coop_pin.sweeps.plan import SweepPlan

_SAMPLE_S = 1.0
"""Time for which the ticks of a run are timed, s."""


class Estimate(NamedTuple):
    """Estimated duration of a sweep.

    Attributes:
        runs: number of runs.
        run_s: duration of one run, s.
        workers: number of runs computed at a time.
    """

    runs: int
    run_s: float
    workers: int

    @property
    def total_s(self) -> float:
        """Duration of the sweep, s."""
        return self.runs * self.run_s / self.workers

    def summary(self) -> str:
        """Return the estimate on one line."""
        total = datetime.timedelta(seconds=round(self.total_s))
        return f"about {total} h for {self.runs} runs of {self.run_s:.2g} s on {self.workers} workers"


def estimate(plan: SweepPlan, *, workers: int | None = None) -> Estimate:
    """Return the estimated duration of a sweep, from at most a second of its first point's ticks.

    Args:
        plan: the points.
        workers: number of processes, 0 for this process; one for each processor when omitted.

    Raises:
        FieldError: the number of workers is negative.
        CoopPinError: the first point cannot be run.
    """
    count, scenario = max(Execution(workers=workers).processes, 1), plan.scenario(0)
    _run_s(scenario)  # the first run of a process also loads modules
    return Estimate(len(plan), _run_s(scenario), count)


def _run_s(scenario: Scenario) -> float:
    """Return the duration of a run, s, from those ticks that end within a second."""
    ticks, start, stop = list[int](), time.perf_counter(), deadline(_SAMPLE_S)

    def note(tick: int, total: int) -> None:
        ticks.append(total)
        stop(tick, total)

    with contextlib.suppress(RunTimeoutError):
        run(scenario, progress=note, warn=False)
    return (time.perf_counter() - start) * ticks[0] / len(ticks)
