"""Execution backends of a sweep: this process, or workers that take batches of jobs and return futures."""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, NoReturn, Protocol

from pebble import ProcessExpired

from coop_pin.base.errors import CoopPinError, RunTimeoutError, WorkerDiedError, WorkersLostError
from coop_pin.compiled.engines import Way
from coop_pin.sweeps.workers import worker_host
from coop_pin.sweeps.workers.job import CtrlC, Job, JobRecord, Outcome, run_job

BATCH_S = 0.25
"""Intended duration of a batch of short runs, s."""
_LARGEST_BATCH, _MOST_PARTS, _BATCH_TICKS = 64, 4, 50_000
"""Runs of a batch; of those that are simulated together so many times as many, up to a number of ticks."""
_START_S, _POLL_S, _GRACE_S, _TRACKER_S = 180.0, 2.0, 2.0, 0.5
"""Longest time of a start, which takes a minute on a crowded machine; interval of looks at the slots; times
that a host has to end, and its resource tracker after it; s."""
_STARTS, _DEATHS, _DELAYS = 5, 3, 2
"""Workers that may die in a row while they start; that die with a job, or are killed at its time limit,
before it has failed."""
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def _raise_ctrl_c(*_: object) -> NoReturn:
    raise CtrlC


def outcomes_here(jobs: Iterator[Job]) -> Generator[list[Outcome]]:
    """Yield the outcomes of jobs that this process computes, one after the other."""
    with contextlib.ExitStack() as stack:
        if threading.current_thread() is threading.main_thread():  # Ctrl-C does not reach others
            stack.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, _raise_ctrl_c))
        while batch := _next_batch(jobs, 1):
            if batch[0].way != "lanes":
                yield [run_job(job) for job in batch]
            else:
                yield from _batch_here(batch)


def _batch_here(batch: Sequence[Job], is_over: Callable[[], bool] = bool) -> Iterator[list[Outcome]]:
    """Yield the outcomes of a batch that this process computes; other threads work while its code runs."""
    from coop_pin.sweeps.workers.batch_job import IN_PYTHON, run_batch  # slow to load

    def run(job: Job) -> list[Outcome]:
        with IN_PYTHON:
            return [run_job(job)]

    yield from _with_singles(batch, run_batch(batch, is_over), run)


def _with_singles(
    batch: Sequence[Job], outcomes: Sequence[Outcome | Way], run: Callable[[Job], list[Outcome]]
) -> Iterator[list[Outcome]]:
    """Yield the outcomes of a batch, then one by one those of its jobs that must be run singly."""
    yield [outcome for outcome in outcomes if not isinstance(outcome, str)]
    for job, outcome in zip(batch, outcomes, strict=True):
        if isinstance(outcome, str):
            yield run(job._replace(way=outcome))


def _next_batch(jobs: Iterator[Job], size: int) -> list[Job]:
    """Return the next jobs: as many as wanted, or the most of those that are simulated together."""
    first = list(itertools.islice(jobs, 1))
    if first and first[0].way == "lanes":
        scenario = first[0].example
        ticks = _LARGEST_BATCH * scenario.clock.ticks(scenario.duration)
        size = _LARGEST_BATCH * min(max(_BATCH_TICKS // ticks, 1), _MOST_PARTS)
    return first + list(itertools.islice(jobs, size - 1))


class Backend(Protocol):
    """Execution backend with workers."""

    def slots(self) -> int:
        """Return how many batches the workers compute at once."""

    def submit(self, batch: Sequence[Job]) -> futures.Future[list[Outcome]]:
        """Send a batch, and return the future of its outcomes."""


def outcomes(backend: Backend, jobs: Iterator[Job]) -> Generator[list[Outcome]]:
    """Yield the outcomes of jobs as they finish; short ones travel in batches of a quarter of a second.

    Raises:
        WorkersLostError: workers cannot be started or run no jobs, or the scheduler is gone.
        CodeChangedError: a worker has loaded other code than a job's key covers.
    """
    under_way: set[futures.Future[list[Outcome]]] = set()
    mean_s = BATCH_S
    while True:
        with _reported():
            free = 2 * backend.slots() - len(under_way)
        for _ in range(free):
            size = max(1, min(_LARGEST_BATCH, round(BATCH_S / mean_s)))
            if batch := _next_batch(jobs, size):
                with _reported():
                    under_way.add(backend.submit(batch))
        if not under_way:
            return
        done, under_way = futures.wait(under_way, _POLL_S, futures.FIRST_COMPLETED)
        for future in done:
            with _reported():
                results = future.result()
            for outcome in results:
                mean_s += 0.2 * (outcome.record.wall_s - mean_s)
            yield results


@contextlib.contextmanager
def _reported() -> Iterator[None]:
    """Raise one error for lost workers; dask raises several, by version and state."""
    try:
        yield
    except CoopPinError:
        raise
    except Exception as error:
        reason = f"workers cannot run jobs ({type(error).__name__}: {error}), or their scheduler is gone"
        raise WorkersLostError(f"{reason}; start the same command again: finished runs are kept") from error


class Worker:
    """Worker process, used by one thread at a time; it is started when needed, and anew after its death."""

    def __init__(self) -> None:
        self._host: subprocess.Popen[bytes] | None = None
        self._is_closed = False

    def compute(self, jobs: Sequence[Job], deaths: int = 0) -> list[Outcome]:
        """Return the outcomes of jobs; if the worker dies or is late, they are tried again, each alone.

        Args:
            jobs: a batch with one time and memory limit.
            deaths: number of workers that these jobs have cost.

        Raises:
            WorkersLostError: workers die while they start.
            Exception: what ``run_job`` raises.
        """
        if self._host is None:
            self._start()
        limit_s, memory_limit = jobs[0].time_limit_s, jobs[0].memory_limit
        kill_s = limit_s + max(2.0, 0.5 * limit_s)  # most runs notice their limit by themselves
        arguments = pickle.dumps(jobs), memory_limit
        error, content = self._reply(kill_s, worker_host.run_pickled, arguments, {}, kill_s)
        if error is None:
            results = _with_singles(jobs, pickle.loads(content), lambda job: self.compute([job]))
            return list(itertools.chain.from_iterable(results))
        is_late, deaths = isinstance(error, TimeoutError), deaths + 1
        if not isinstance(error, TimeoutError | ProcessExpired | BrokenProcessPool | MemoryError | EOFError):
            raise error
        code = self._stop()
        if len(jobs) > 1 or deaths < (_DELAYS if is_late else _DEATHS):
            return [outcome for job in jobs for outcome in self.compute([job], deaths)]
        code = getattr(error, "exitcode", code)
        end = RunTimeoutError(limit_s) if is_late else WorkerDiedError(deaths, code)
        return [Outcome(JobRecord.of_failure(jobs[0].key, jobs[0].changes, end))]

    def close(self) -> None:
        """End the worker for good; called by any thread."""
        self._is_closed = True
        self._stop()

    def _start(self) -> None:
        """Start a host in a session of its own, so that Ctrl-C reaches this process only."""
        path = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)  # for user modules
        quiet = "ignore::UserWarning:multiprocessing.resource_tracker"
        settings = dict.fromkeys(_THREADS, "1") | {"PYTHONPATH": path, "PYTHONWARNINGS": quiet}
        code = 0
        for _ in range(_STARTS):
            self._pipe, theirs = multiprocessing.Pipe()
            with theirs:
                self._host = subprocess.Popen(  # -P: what lies in the working folder hides no package
                    [sys.executable, "-P", "-m", worker_host.__name__, str(theirs.fileno())],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=2,  # what user code prints
                    start_new_session=True,
                    env=os.environ | settings,
                )
            if not self._is_closed and self._reply(0.0)[0] is None:
                return
            code = self._stop()
            if self._is_closed:
                break
        reason = f"workers do not start; the last host ended with exit code {code}"
        raise WorkersLostError(f"{reason}; run with workers = 0 to see why")

    def _reply(self, limit_s: float, *call: Any) -> tuple[Any, bytes]:
        """Return the error and the value of a call in the worker; of its start without a call."""
        try:
            if call:
                self._pipe.send(call)
            return self._pipe.recv() if self._pipe.poll(limit_s + _START_S) else (TimeoutError(), b"")
        except (EOFError, OSError):  # the host has ended
            return EOFError(), b""

    def _stop(self) -> int:
        """Let the host and its worker end, kill what is left of them, and return the host's exit code."""
        if (host := self._host) is None:
            return 0
        host.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            host.wait(_GRACE_S)
        end = time.monotonic() + _TRACKER_S
        with contextlib.suppress(ProcessLookupError):
            while time.monotonic() < end:  # its children remain as zombies where init reaps them late
                os.killpg(host.pid, 0)
                time.sleep(0.01)
            os.killpg(host.pid, signal.SIGKILL)
        self._host = None
        return host.wait()


_workers: dict[int, tuple[str, Worker]] = {}
"""The sweep and the worker of each thread of this process that computes jobs."""


def run_in_thread(sweep: str, jobs: Sequence[Job]) -> list[Outcome]:
    """Return the outcomes of jobs, by the worker that the calling thread keeps for a sweep."""
    thread = threading.get_ident()
    owner, worker = _workers.get(thread, ("", Worker()))
    if owner != sweep:
        worker.close()  # other threads may still compute for the other sweep
        _, worker = _workers[thread] = sweep, Worker()
    return worker.compute(jobs)


def close_workers(sweep: str) -> None:
    """End the workers of a sweep, also those at work."""
    threads = [thread for thread, (owner, _) in list(_workers.items()) if owner == sweep]
    ended = [_workers.pop(thread)[1] for thread in threads]
    with futures.ThreadPoolExecutor(max(1, len(ended))) as pool:
        list(pool.map(Worker.close, ended))


class LocalBackend:
    """Execution backend on local workers, until it is closed.

    They are processes, but threads of this one for batches in which nothing of a user's runs: compiled code
    holds up no other thread.

    Args:
        workers: number of workers that compute at once.
    """

    def __init__(self, workers: int) -> None:
        self._count, self._name = workers, uuid.uuid4().hex
        self._threads, self._is_closed = futures.ThreadPoolExecutor(workers), threading.Event()

    def slots(self) -> int:
        """Return the number of workers."""
        return self._count

    def submit(self, batch: Sequence[Job]) -> futures.Future[list[Outcome]]:
        """Send a batch to the next free worker."""
        return self._threads.submit(run_in_thread, self._name, batch)

    def outcomes(self, jobs: Iterator[Job]) -> Generator[list[Outcome]]:
        """Yield the outcomes of jobs of one way as they finish; workers draw batches by themselves.

        Raises:
            WorkersLostError: workers cannot be started or run no jobs.
            CodeChangedError: this process or a worker has loaded other code than a job's key covers.
        """
        first = [*itertools.islice(jobs, 1)]
        jobs = itertools.chain(first, jobs)
        if not (first and first[0].way == "lanes"):
            yield from outcomes(self, jobs)
            return
        under_way = {self._threads.submit(self._drawn, jobs) for _ in range(2 * self._count)}
        while under_way:
            done, under_way = futures.wait(under_way, _POLL_S, futures.FIRST_COMPLETED)
            for future in done:
                if results := future.result():
                    under_way.add(self._threads.submit(self._drawn, jobs))
                    yield results

    def _drawn(self, jobs: Iterator[Job]) -> list[Outcome]:
        """Return the outcomes of the next batch, nothing after the last one."""
        from coop_pin.sweeps.workers.batch_job import IN_PYTHON  # slow to load

        with IN_PYTHON:
            batch = [] if self._is_closed.is_set() else _next_batch(jobs, 1)
        if not batch or self._is_closed.is_set():
            return []
        if any(job.code for job in batch):
            with _reported():
                return run_in_thread(self._name, batch)
        return [*itertools.chain.from_iterable(_batch_here(batch, self._is_closed.is_set))]

    def close(self) -> None:
        """End all workers, also those at work."""
        self._is_closed.set()
        self._threads.shutdown(wait=False, cancel_futures=True)
        close_workers(self._name)
