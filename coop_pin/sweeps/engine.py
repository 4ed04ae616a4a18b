"""From a plan to a folder of runs."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import NamedTuple

from coop_pin.errors import FieldError, ScenarioError, SweepInterruptedError
from coop_pin.sweeps.job import Job, Outcome, run_job
from coop_pin.sweeps.key import run_key, unresolved_key
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.progress import SweepBar
from coop_pin.sweeps.record import Failure, Record
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.writer import OutcomeWriter

_LOG = logging.getLogger("coop_pin.sweeps")
_OF_THE_MACHINE = ("RunTimeoutError", "WorkerDiedError", "MemoryError")
"""Failures that another try may not repeat."""


class Where(NamedTuple):
    """Where runs are computed.

    Attributes:
        workers: number of local workers; 0 for this process, where a run that hangs or crashes takes the sweep with it.
        scheduler: address of a dask scheduler to use instead.
    """

    workers: int
    scheduler: str | None = None


def available_workers() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_plan(plan: SweepPlan, folder: str | Path, where: Where, *, retry_failed: bool = False, quiet: bool = False) -> None:
    """Compute every run of a plan that the folder does not hold yet.

    Args:
        plan: what to run.
        folder: where runs are kept.
        where: where they are computed.
        retry_failed: run again what failed for want of time or of a worker.
        quiet: no progress bar.

    Raises:
        StoreLockedError: another process works on the folder.
        StoreWriteError: a file cannot be written.
        WorkersLostError: no worker is left.
        SweepInterruptedError: Ctrl-C.
    """
    if where.workers or where.scheduler:
        _require_importable(plan)
    store = SweepStore(folder)
    with store.lock as lock:
        if lock.left_by:
            _LOG.warning("the last sweep in %s (%s) ended without leaving; its finished runs are kept", folder, lock.left_by)
        aside = store.tidy()
        if aside:
            _LOG.warning("%d files in %s that no sweep wrote were moved to set-aside", aside, folder)
        store.write_plan(plan)
        with SweepBar(len(plan), quiet) as bar:
            try:
                _Sweep(plan, store, bar, retry_failed).run(where)
            except KeyboardInterrupt:
                raise SweepInterruptedError(str(folder), bar.finished, len(plan)) from None


class _Sweep:
    """One session of a sweep."""

    def __init__(self, plan: SweepPlan, store: SweepStore, bar: SweepBar, retry_failed: bool) -> None:
        self._plan, self._store, self._bar, self._retry_failed = plan, store, bar, retry_failed
        self._under_way: dict[str, int] = {}

    def run(self, where: Where) -> None:
        """Compute, write and count."""
        with OutcomeWriter(self._store) as writer, contextlib.closing(self._outcomes(where, writer)) as outcomes:
            for outcome in outcomes:
                writer.write(outcome)
                for _ in range(self._under_way.pop(outcome.record.key)):
                    self._bar.count(outcome.record.failure is not None)

    def _outcomes(self, where: Where, writer: OutcomeWriter) -> Generator[Outcome]:
        jobs = self._jobs(writer)
        if not (where.workers or where.scheduler):
            yield from map(run_job, jobs)
            return
        first = next(jobs, None)
        if first is None:  # nothing to do: no need to wait for workers
            return
        from coop_pin.sweeps.cluster import local_cluster, remote_cluster  # dask is an extra, and slow to load
        from coop_pin.sweeps.executors import ClusterExecutor

        with remote_cluster(where.scheduler) if where.scheduler else local_cluster(where.workers) as cluster:
            yield from ClusterExecutor(cluster).outcomes(itertools.chain([first], jobs))

    def _jobs(self, writer: OutcomeWriter) -> Iterator[Job]:
        """Yield what is still to be done; what cannot be done is written down at once."""
        for point in self._plan.points():
            keep = self._plan.keeps(point.number)
            try:
                scenario = self._plan.scenario(point.number)
            except ScenarioError as error:
                self._write_unresolved(point.number, error, writer)
                continue
            key = run_key(scenario, self._plan.metrics)
            if key in self._under_way:
                self._under_way[key] += 1
                continue
            record = writer.waiting(key) or self._store.read_or_set_aside(key, with_result=keep)
            if record is not None and not self._again(record):
                self._bar.count(record.failure is not None, old=True)
                continue
            self._under_way[key] = 1
            yield Job(key, scenario.model_dump_json(), self._plan.metrics, self._plan.time_limit_s, keep)

    def _again(self, record: Record) -> bool:
        return self._retry_failed and record.failure is not None and record.failure.kind in _OF_THE_MACHINE

    def _write_unresolved(self, index: int, error: ScenarioError, writer: OutcomeWriter) -> None:
        point = self._plan[index]
        key = unresolved_key(self._plan.base[point.base], point.changes)
        if (writer.waiting(key) or self._store.read_or_set_aside(key)) is None:
            writer.write(Outcome(Record(key, "", {}, Failure.of(error))))
        self._bar.count(True, old=True)


def _require_importable(plan: SweepPlan) -> None:
    """Refuse code of the user's own that only this script or notebook can see."""
    parts = [part for scenario in plan.base.values() for part in (scenario.controller, scenario.motion, scenario.squeeze)]
    for name in (*plan.metrics, *(getattr(part, "target", "") for part in parts)):
        if name.startswith("__main__:"):
            detail = f"names {name!r}, which workers cannot import; put it into a module (a file of its own), or sweep with workers = 0"
            raise FieldError(detail, "metrics" if name in plan.metrics else "base")
