"""Where runs are computed: in this process, by local workers, or by those of a dask scheduler."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

from coop_pin.errors import FieldError
from coop_pin.sweeps.job import Job, Outcome, run_job


def available_workers() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Where(NamedTuple):
    """Where runs are computed.

    Attributes:
        workers: number of local workers; 0 for this process, where a run that hangs or crashes takes the sweep with it.
        scheduler: address of a dask scheduler to use instead.
    """

    workers: int
    scheduler: str | None = None

    @classmethod
    def of(cls, workers: int | None, scheduler: str | None) -> Where:
        """Return where a caller wants it: one local worker for each processor when nothing is said.

        Raises:
            FieldError: the number of workers is negative.
        """
        if workers is not None and workers < 0:
            raise FieldError(f"is {workers}; it must be 0 (this process) or the number of processes", "workers")
        return cls(available_workers() if workers is None else workers, scheduler)

    @property
    def elsewhere(self) -> bool:
        """Whether runs leave this process."""
        return bool(self.workers or self.scheduler)

    @contextlib.contextmanager
    def open(self) -> Iterator[ThisProcess | Workers]:
        """Yield what computes there, for one batch of jobs after the other."""
        with contextlib.ExitStack() as stack:
            yield Workers(self, stack) if self.elsewhere else ThisProcess()


class ThisProcess:
    """Computes jobs one after the other, here."""

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """Yield the outcome of every job."""
        for job in jobs:
            yield run_job(job)


class Workers:
    """Computes jobs on workers, which are there from the first job on until the stack ends."""

    def __init__(self, where: Where, stack: contextlib.ExitStack) -> None:
        self._where, self._stack = where, stack

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """Yield the outcome of every job as it finishes.

        Raises:
            FieldError: the scheduler's address is none.
            WorkersLostError: no worker is left, or there is no scheduler.
        """
        first = next(jobs, None)
        if first is None:  # nothing to do: no need to wait for workers
            return
        cluster = self._cluster
        from coop_pin.sweeps.backend import ClusterExecutor

        yield from ClusterExecutor(cluster).outcomes(itertools.chain([first], jobs))

    @functools.cached_property
    def _cluster(self) -> Any:
        from coop_pin.sweeps.cluster import local_cluster, remote_cluster  # dask is an extra, and slow to load

        where = self._where
        return self._stack.enter_context(remote_cluster(where.scheduler) if where.scheduler else local_cluster(where.workers))
