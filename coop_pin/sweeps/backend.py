"""Execution backends of a sweep: this process, local worker processes, or a dask scheduler."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Generator, Iterator
from typing import Protocol

from coop_pin.errors import FieldError, MissingExtraError
from coop_pin.sweeps.job import Job, Outcome, distinct_ctrl_c, run_job
from coop_pin.sweeps.local_pool import BATCH_S, LocalPool


class Backend(Protocol):
    """Execution backend: computes jobs in any order, in memory that does not grow with their number."""

    def outcomes(self, jobs: Iterator[Job]) -> Generator[list[Outcome]]:
        """Yield the outcomes of all jobs, some at a time, as they finish."""


class SerialBackend:
    """Execution backend that computes jobs one after the other in this process."""

    def outcomes(self, jobs: Iterator[Job]) -> Generator[list[Outcome]]:
        """Yield the outcomes of all jobs, those of a quarter of a second together."""
        batch: list[Outcome] = []
        start = time.monotonic()
        with distinct_ctrl_c():
            for job in jobs:
                try:
                    batch.append(run_job(job))
                except BaseException:
                    yield batch
                    raise
                if time.monotonic() - start > BATCH_S:
                    yield batch
                    batch, start = [], time.monotonic()
        yield batch


def worker_count(workers: int | None) -> int:
    """Return the number of local workers; one for each available processor if it is None.

    Raises:
        FieldError: it is negative.
    """
    if workers is None:
        affinity = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # not on macOS
        return len(affinity(0))
    if workers < 0:
        raise FieldError(f"is {workers}; it must be 0 (this process) or a number of processes", "workers")
    return workers


@contextlib.contextmanager
def open_backend(workers: int, scheduler: str | None) -> Iterator[Backend]:
    """Yield an execution backend, with its workers while the ``with`` block runs.

    Args:
        workers: number of local workers; 0 for this process, where a run that hangs or crashes takes the
            sweep with it.
        scheduler: address of a dask scheduler to use instead.

    Raises:
        MissingExtraError: dask is not installed.
        FieldError: the scheduler's address is malformed.
        WorkersLostError: there is no scheduler at that address.
    """
    if scheduler:
        try:
            from coop_pin.sweeps.dask_backend import connected  # dask is an extra, and slow to load
        except ModuleNotFoundError:
            raise MissingExtraError("distributed", "sweep", "to run a sweep on a scheduler") from None
        with connected(scheduler) as backend:
            yield backend
    elif workers:
        with LocalPool(workers) as pool:
            yield pool
    else:
        yield SerialBackend()
