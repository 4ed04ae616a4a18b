"""Execution backends of a sweep: this process, local worker processes, or a dask scheduler."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator, Iterator
from typing import NamedTuple, Protocol

from coop_pin.errors import FieldError, MissingExtraError
from coop_pin.sweeps.job import Job, Outcome, run_job


class Backend(Protocol):
    """Execution backend: computes jobs in any order, in memory that does not grow with their number."""

    def outcomes(self, jobs: Iterator[Job]) -> Generator[Outcome]:
        """Yield the outcome of every job as it finishes."""


class SerialBackend:
    """Execution backend that computes jobs one after the other in this process."""

    def outcomes(self, jobs: Iterator[Job]) -> Generator[Outcome]:
        """Yield the outcome of every job."""
        for job in jobs:
            yield run_job(job)


class BackendOptions(NamedTuple):
    """Choice of an execution backend.

    Attributes:
        workers: number of local workers; 0 for this process, where a run that hangs or crashes takes the
            sweep with it.
        scheduler: address of a dask scheduler to use instead.
    """

    workers: int
    scheduler: str | None = None

    @classmethod
    def of(cls, workers: int | None, scheduler: str | None = None) -> BackendOptions:
        """Return the options with their default: one local worker for each available processor.

        Raises:
            FieldError: the number of workers is negative.
        """
        if workers is None:
            affinity = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # not on macOS
            workers = len(affinity(0))
        if workers < 0:
            raise FieldError(f"is {workers}; it must be 0 (this process) or a number of processes", "workers")
        return cls(workers, scheduler)

    @property
    def is_distributed(self) -> bool:
        """Whether runs leave this process."""
        return bool(self.workers or self.scheduler)

    @contextlib.contextmanager
    def open(self) -> Iterator[Backend]:
        """Yield the backend, with its workers while the ``with`` block runs.

        Raises:
            MissingExtraError: dask is not installed.
            FieldError: the scheduler's address is malformed.
            WorkersLostError: there is no scheduler at that address.
        """
        if not self.is_distributed:
            yield SerialBackend()
            return
        try:
            from coop_pin.sweeps import cluster, dask_backend  # dask is an extra, and slow to load
        except ModuleNotFoundError:
            purpose = "to run a sweep on several processes"
            raise MissingExtraError("distributed", "sweep", purpose) from None
        address = self.scheduler
        opened = cluster.remote_cluster(address) if address else cluster.local_cluster(self.workers)
        with opened as client:
            yield dask_backend.DaskBackend(client)
