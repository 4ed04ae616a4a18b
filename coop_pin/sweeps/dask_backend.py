"""Execution backend on dask workers: batches, retries in isolation, and the functions that workers call."""

from __future__ import annotations

import faulthandler
import functools
import itertools
import os
import queue
import time
import uuid
from collections import deque
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import dask
from distributed import CancelledError, KilledWorker, get_worker

from coop_pin.errors import CodeChangedError, RunTimeoutError, WorkerDiedError, WorkersLostError
from coop_pin.sweeps.cluster import RESUME, Cluster
from coop_pin.sweeps.job import Job, Outcome, run_job
from coop_pin.sweeps.record import Failure, Record

_TASK_S = 0.25
"""Intended duration of a task, s."""
_LARGEST_BATCH = 64
"""Jobs in a task, at most."""
_DEATHS = 3
"""Worker deaths after which a job has failed."""
_POLL_S, _COUNT_S = 0.5, 2.0
"""Interval at which results are waited for, and at which workers are counted, s."""
_PATIENCE_S = 30.0
"""Time for which a scheduler may be unreachable, s."""
_STARTED = "coop-pin-started"
"""Topic under which workers report the start of an isolated job."""
_SENDING_S = 0.1
"""Time in which that report leaves the worker, s."""


class _Task(NamedTuple):
    """Jobs submitted together.

    Attributes:
        jobs: the jobs.
        deaths: workers that died with the only job; several jobs are first separated.
        name: name under which the start of an isolated job is reported.
    """

    jobs: list[Job]
    deaths: int
    name: str


class DaskBackend:
    """Execution backend on a dask cluster.

    Short runs are sent in batches of about a quarter of a second. If a worker dies, the jobs of its batch are
    repeated in isolation; a job that kills three workers, or hangs until the guard kills its worker a second
    time, is recorded as failed. Workers report the start of isolated jobs, so that a slow start of the next
    worker is not taken for a hang.
    """

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._under_way: dict[Any, _Task] = {}
        self._isolated: deque[tuple[Job, int]] = deque()
        self._mean_s = _TASK_S
        self._threads, self._counted = 1, 0.0
        self._started: dict[str, float] = {}
        cluster.listen(_STARTED, self._note_start)

    def outcomes(self, jobs: Iterator[Job]) -> Generator[Outcome]:
        """Yield the outcome of every job as it finishes.

        Raises:
            WorkersLostError: the scheduler is gone, or local workers cannot be started.
            CodeChangedError: a worker has loaded other code than a job's key covers.
        """
        while True:
            self._submit_jobs(jobs)
            if not self._under_way:
                return
            yield from self._next()

    # ------------------------------------------------------------ submitting

    def _submit_jobs(self, jobs: Iterator[Job]) -> None:
        """Keep every thread and a queue of the same length busy.

        Isolated jobs go first, and only to a free thread, never into the queue.
        """
        if time.monotonic() - self._counted > _COUNT_S:  # workers come and go
            self._threads, self._counted = self._cluster.threads(), time.monotonic()
        while self._isolated and len(self._under_way) < self._threads:
            job, deaths = self._isolated.popleft()
            self._submit([job], deaths)
        while not self._isolated and len(self._under_way) < 2 * self._threads:
            batch = list(itertools.islice(jobs, self._batch_size()))
            if not batch:
                return
            self._submit(batch, 0)

    def _batch_size(self) -> int:
        return max(1, min(_LARGEST_BATCH, round(_TASK_S / self._mean_s)))

    def _submit(self, jobs: list[Job], deaths: int) -> None:
        name = uuid.uuid4().hex
        future = self._cluster.submit(*((run_isolated, jobs[0], name) if deaths else (run_jobs, jobs)))
        self._under_way[future] = _Task(jobs, deaths, name)
        future.add_done_callback(self._finished.put)

    # ------------------------------------------------------------ receiving

    def _next(self) -> Iterator[Outcome]:
        """Wait for a task and yield its outcomes."""
        future = self._wait()
        task = self._under_way.pop(future)
        try:
            outcomes = future.result()
        except KilledWorker:
            yield from self._worker_died(task)
            return
        except CancelledError:
            raise WorkersLostError(f"the scheduler is gone; {RESUME}") from None
        except CodeChangedError:
            raise
        except Exception as error:  # errors of runs are in their records: this one is the worker's own
            reason = f"a worker cannot run jobs ({type(error).__name__}: {error})"
            advice = "it needs this version of coop_pin, and space in its temporary folder"
            raise WorkersLostError(f"{reason}; {advice}") from error
        for outcome in outcomes:
            self._mean_s += 0.2 * (outcome.record.times["wall_s"] - self._mean_s)
            yield outcome

    def _wait(self) -> Any:
        lost_since: float | None = None
        while True:
            try:
                return self._finished.get(timeout=_POLL_S)
            except queue.Empty:
                error = self._cluster.error()
            if error is not None:
                raise error
            connected = self._cluster.client.status == "running"
            lost_since = None if connected else lost_since or time.monotonic()
            if lost_since is not None and time.monotonic() - lost_since > _PATIENCE_S:
                raise WorkersLostError(f"the scheduler does not answer; {RESUME}")

    def _note_start(self, event: tuple[float, str]) -> None:
        """Note the start of an isolated job, by this process's clock."""
        self._started[event[1]] = time.monotonic()

    def _worker_died(self, task: _Task) -> Iterator[Outcome]:
        """Isolate the jobs of a dead worker, or record a single job as failed."""
        started = self._started.pop(task.name, None)
        job, deaths = task.jobs[0], task.deaths + 1
        limit = 0.5 * (job.time_limit_s + job.hard_limit_s)
        hung = started is not None and time.monotonic() - started > limit
        if hung or (len(task.jobs) == 1 and deaths >= _DEATHS):
            failure = Failure.of(RunTimeoutError(job.time_limit_s) if hung else WorkerDiedError(deaths))
            yield Outcome(Record(job.key, job.scenario, {}, failure, {"wall_s": 0.0, "cpu_s": 0.0}))
        else:
            self._isolated += [(job, deaths) for job in task.jobs]


# ---------------------------------------------------------------- on a worker


def run_jobs(jobs: list[Job]) -> list[Outcome]:
    """Return the outcomes of jobs, computed in a worker's process, which is killed if one of them hangs.

    The guard is a thread of the interpreter itself (faulthandler) and needs no lock that a hanging run could
    hold.
    """
    outcomes = []
    # with the cluster's scheduler, xarray would ask it for a lock before it writes a result
    with dask.config.set(scheduler="synchronous"):
        for job in jobs:
            faulthandler.dump_traceback_later(job.hard_limit_s, exit=True, file=_devnull())
            try:
                outcomes.append(run_job(job))
            finally:
                faulthandler.cancel_dump_traceback_later()
    return outcomes


def run_isolated(job: Job, name: str) -> list[Outcome]:
    """Return the outcome of a job whose worker died before.

    Its start is reported first, so that a hang can be told from a crash.

    Args:
        job: the job.
        name: name that is reported.
    """
    get_worker().log_event(_STARTED, name)
    time.sleep(_SENDING_S)
    return run_jobs([job])


@functools.cache
def _devnull() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8")
