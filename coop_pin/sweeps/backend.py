"""Jobs in, outcomes out, in whatever order they finish; memory does not grow with the number of jobs."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import queue
import time
import uuid
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from distributed import CancelledError, KilledWorker

from coop_pin.errors import CodeChangedError, FieldError, RunTimeoutError, WorkerDiedError, WorkersLostError
from coop_pin.sweeps.cluster import Cluster
from coop_pin.sweeps.job import BEGUN, Job, Outcome, run_isolated, run_job, run_jobs
from coop_pin.sweeps.record import Failure, Record


def available_workers() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Where(NamedTuple):
    """Where runs are computed.

    Attributes:
        workers: number of local workers; 0 for this process, where a run that hangs or crashes takes the
            sweep with it.
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
            raise FieldError(
                f"is {workers}; it must be 0 (this process) or the number of processes", "workers"
            )
        return cls(available_workers() if workers is None else workers, scheduler)

    @property
    def elsewhere(self) -> bool:
        """Whether runs leave this process."""
        return bool(self.workers or self.scheduler)

    @contextlib.contextmanager
    def open(self) -> Iterator[SerialBackend | DaskBackend]:
        """Yield what computes there, for one batch of jobs after the other."""
        with contextlib.ExitStack() as stack:
            yield DaskBackend(self, stack) if self.elsewhere else SerialBackend()


class SerialBackend:
    """Computes jobs one after the other, here."""

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """Yield the outcome of every job."""
        for job in jobs:
            yield run_job(job)


class DaskBackend:
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
        from coop_pin.sweeps.cluster import (
            local_cluster,
            remote_cluster,
        )  # dask is an extra, and slow to load

        where = self._where
        return self._stack.enter_context(
            remote_cluster(where.scheduler) if where.scheduler else local_cluster(where.workers)
        )


_TASK_S = 0.25
_LARGEST_BATCH = 64
_DEATHS = 3
_POLL_S, _LOOK_S = 0.5, 2.0
_PATIENCE_S = 30.0
"""What a task should take, s; jobs in a task; deaths after which a job is given up; how often answers and the cluster are looked at, s."""


class _Task(NamedTuple):
    """Jobs under way together.

    Attributes:
        jobs: the jobs.
        deaths: workers that died with the one job there is; several jobs are first taken apart.
        ticket: under which a suspect reports that it begins.
    """

    jobs: list[Job]
    deaths: int
    ticket: str


class ClusterExecutor:
    """Runs jobs on a dask cluster.

    Short runs travel in batches of about a quarter of a second. A batch whose worker dies is taken apart, and
    its jobs are tried one by one; a job that ends three workers, or hangs until the guard ends its worker a
    second time, is recorded as failed. The beginning of such suspects is reported, so that a slow start of
    the next worker is not taken for a hang.
    """

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._under_way: dict[Any, _Task] = {}
        self._suspects: deque[tuple[Job, int]] = deque()
        self._mean_s = _TASK_S
        self._threads, self._looked = 1, 0.0
        self._begun: dict[str, float] = {}

    def outcomes(self, jobs: Iterator[Job]) -> Iterator[Outcome]:
        """Yield the outcome of every job as it finishes.

        Raises:
            WorkersLostError: the scheduler is gone, or local workers cannot be started.
            CodeChangedError: a worker runs other code than a job's key stands for.
        """
        self._cluster.listen(BEGUN, self._note_begun)
        while True:
            self._fill(jobs)
            if not self._under_way:
                return
            yield from self._next()

    # ------------------------------------------------------------ out

    def _fill(self, jobs: Iterator[Job]) -> None:
        """Keep every thread and a queue of the same length busy. Suspects go first, and wait for a free thread, not in the queue."""
        self._look()
        while self._suspects and len(self._under_way) < self._threads:
            job, deaths = self._suspects.popleft()
            self._submit([job], deaths)
        while not self._suspects and len(self._under_way) < 2 * self._threads:
            batch = list(itertools.islice(jobs, self._batch_size()))
            if not batch:
                return
            self._submit(batch, 0)

    def _batch_size(self) -> int:
        return max(1, min(_LARGEST_BATCH, round(_TASK_S / self._mean_s)))

    def _submit(self, jobs: list[Job], deaths: int) -> None:
        ticket = uuid.uuid4().hex
        future = (
            self._cluster.submit(run_isolated, jobs[0], ticket)
            if deaths
            else self._cluster.submit(run_jobs, jobs)
        )
        self._under_way[future] = _Task(jobs, deaths, ticket)
        future.add_done_callback(self._done.put)

    def _look(self) -> None:
        """Count threads now and then: workers come and go."""
        if time.monotonic() - self._looked > _LOOK_S:
            self._threads, self._looked = self._cluster.threads(), time.monotonic()

    # ------------------------------------------------------------ in

    def _next(self) -> Iterator[Outcome]:
        """Wait for a task and yield what it brought."""
        future = self._wait()
        task = self._under_way.pop(future)
        try:
            outcomes = future.result()
        except KilledWorker:
            yield from self._worker_died(task)
            return
        except CancelledError:
            raise WorkersLostError(
                "the scheduler is gone; start the same command again: finished runs are kept"
            ) from None
        except CodeChangedError:
            raise
        except Exception as error:  # not of the run, whose errors are in its record: of the worker itself
            said = f"a worker cannot work ({type(error).__name__}: {error})"
            raise WorkersLostError(
                f"{said}; it needs the coop_pin that is here, and room in its temporary folder"
            ) from error
        for outcome in outcomes:
            self._mean_s += 0.2 * (outcome.record.times["wall_s"] - self._mean_s)
            yield outcome

    def _wait(self) -> Any:
        lost_since: float | None = None
        while True:
            try:
                return self._done.get(timeout=_POLL_S)
            except queue.Empty:
                error = self._cluster.error()
            if error is not None:
                raise error
            connected = self._cluster.client.status == "running"
            lost_since = None if connected else lost_since or time.monotonic()
            if lost_since is not None and time.monotonic() - lost_since > _PATIENCE_S:
                raise WorkersLostError(
                    "the scheduler does not answer; start the same command again: finished runs are kept"
                )

    def _note_begun(self, event: tuple[float, str]) -> None:
        """Note when a suspect begins, by our own clock."""
        self._begun[event[1]] = time.monotonic()

    def _worker_died(self, task: _Task) -> Iterator[Outcome]:
        """Try the jobs of a dead worker alone, or give the only one up."""
        begun = self._begun.pop(task.ticket, None)
        job, deaths = task.jobs[0], task.deaths + 1
        hung = begun is not None and time.monotonic() - begun > 0.5 * (job.time_limit_s + job.hard_limit_s)
        if hung or (len(task.jobs) == 1 and deaths >= _DEATHS):
            failure = Failure.of(RunTimeoutError(job.time_limit_s) if hung else WorkerDiedError(deaths))
            yield Outcome(Record(job.key, job.scenario, {}, failure, {"wall_s": 0.0, "cpu_s": 0.0}))
        else:
            self._suspects += [(job, deaths) for job in task.jobs]
