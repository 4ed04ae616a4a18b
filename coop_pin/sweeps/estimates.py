"""Estimated duration of a sweep, measured on its first run."""

from __future__ import annotations

import contextlib
import time
from typing import NamedTuple

from coop_pin.description.scenario import Scenario
from coop_pin.errors import CoopPinError
from coop_pin.run_scenario import run
from coop_pin.sweeps.backend import worker_count
from coop_pin.sweeps.plan import SweepPlan

_SAMPLE_S = 1.0


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
        minutes, seconds = divmod(round(self.total_s), 60)
        hours, minutes = divmod(minutes, 60)
        each = f"{self.runs} runs of {self.run_s:.2g} s on {self.workers} workers"
        return f"about {hours}:{minutes:02}:{seconds:02} h for {each}"


class _EnoughError(CoopPinError):
    """Ends a run whose ticks have been timed long enough."""


def estimate(plan: SweepPlan, *, workers: int | None = None) -> Estimate:
    """Return the estimated duration of a sweep, from at most a second of its first point's ticks.

    Args:
        plan: the points.
        workers: number of processes, 0 for this process; one for each processor when omitted.

    Raises:
        FieldError: the number of workers is negative.
        CoopPinError: the first point cannot be run.
    """
    count = max(worker_count(workers), 1)
    _tick_times(plan.scenario(0))  # the first run of a process also loads modules
    start = time.perf_counter()
    ticks = _tick_times(plan.scenario(0))
    (first, total), (last, _) = ticks[0], ticks[-1]
    run_s = first - start + (last - first) / max(len(ticks) - 1, 1) * total
    return Estimate(len(plan), run_s, count)


def _tick_times(scenario: Scenario) -> list[tuple[float, int]]:
    """Run at most a second of a scenario's ticks; return the time of each, s, and their number in all."""
    ticks: list[tuple[float, int]] = []

    def note(_done: int, total: int) -> None:
        ticks.append((time.perf_counter(), total))
        if ticks[-1][0] - ticks[0][0] > _SAMPLE_S:
            raise _EnoughError("the ticks are timed")

    with contextlib.suppress(_EnoughError):
        run(scenario, progress=note)
    return ticks
