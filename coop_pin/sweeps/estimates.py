"""How long a sweep will take, from a moment of its first run."""

from __future__ import annotations

import contextlib
import time
from typing import NamedTuple

from coop_pin.errors import CoopPinError
from coop_pin.run_scenario import run
from coop_pin.sweeps.plan import SweepPlan

_SAMPLE_S = 1.0


class Estimate(NamedTuple):
    """How long a sweep will take.

    Attributes:
        runs: number of runs.
        run_s: time of one run, s.
        workers: number of workers.
    """

    runs: int
    run_s: float
    workers: int

    @property
    def total_s(self) -> float:
        """Time of the sweep, s."""
        return self.runs * self.run_s / max(self.workers, 1)

    def __str__(self) -> str:
        minutes, seconds = divmod(round(self.total_s), 60)
        hours, minutes = divmod(minutes, 60)
        return f"about {hours}:{minutes:02}:{seconds:02} h for {self.runs} runs of {self.run_s:.2g} s on {max(self.workers, 1)} workers"


class _EnoughError(CoopPinError):
    """The run has been watched long enough."""


class _Watch:
    """A progress callback that times ticks and stops the run after a second."""

    def __init__(self) -> None:
        self.ticks, self.total = 0, 1
        self.first = self.last = time.perf_counter()

    def __call__(self, done: int, total: int) -> None:
        self.last = time.perf_counter()
        if done == 0:
            self.first = self.last
        self.ticks, self.total = done, total
        if self.last - self.first > _SAMPLE_S:
            raise _EnoughError("enough")


def estimate(plan: SweepPlan, workers: int) -> Estimate:
    """Run the first point for at most a second of its ticks and say how long all points will take.

    Args:
        plan: the points.
        workers: how many of them run at a time.

    Raises:
        CoopPinError: the first point cannot be run.
    """
    scenario = plan.scenario(0)
    with contextlib.suppress(_EnoughError):
        run(scenario, progress=_Watch())  # the first run of a process loads what later ones have
    start, watch = time.perf_counter(), _Watch()
    with contextlib.suppress(_EnoughError):
        run(scenario, progress=watch)
    setup, ticks = watch.first - start, max(watch.ticks, 1)
    return Estimate(len(plan), setup + (watch.last - watch.first) / ticks * watch.total, workers)
