"""Execution backends of a sweep: this process, or local workers of a host process that is fed over a pipe."""

from __future__ import annotations

import abc
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
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NoReturn

from coop_pin.errors import CoopPinError, RunTimeoutError, WorkerDiedError, WorkersLostError
from coop_pin.sweeps.job import CtrlC, Failure, Job, Outcome, Record, run_job

BATCH_S = 0.25
"""Intended duration of a batch of short runs, s."""
_LARGEST_BATCH = 64
_LIVES, _SHORT_LIFE_S, _GRACE_S = 3, 10.0, 2.0
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def _raise_ctrl_c(*_: object) -> NoReturn:
    raise CtrlC


def outcomes_here(jobs: Iterator[Job]) -> Generator[list[Outcome]]:
    """Yield the outcomes of jobs that this process computes, one after the other."""
    with contextlib.ExitStack() as stack:
        if threading.current_thread() is threading.main_thread():  # Ctrl-C does not reach others
            stack.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, _raise_ctrl_c))
        for job in jobs:
            yield [run_job(job)]


class BatchingBackend(abc.ABC):
    """Execution backend that sends short runs to workers in batches of about a quarter of a second."""

    def __init__(self) -> None:
        self.under_way: dict[int, list[Job]] = {}
        self._numbers = itertools.count()
        self._mean_s = BATCH_S

    def outcomes(self, jobs: Iterator[Job]) -> Generator[list[Outcome]]:
        """Yield the outcomes of all jobs, a batch at a time, as they finish.

        Raises:
            WorkersLostError: workers cannot be started or run no jobs, or the scheduler is gone.
            CodeChangedError: a worker has loaded other code than a job's key covers.
        """
        while True:
            while len(self.under_way) < 2 * self.slots():
                size = max(1, min(_LARGEST_BATCH, round(BATCH_S / self._mean_s)))
                if not (batch := list(itertools.islice(jobs, size))):
                    break
                number = next(self._numbers)
                self.under_way[number] = batch
                self.submit(number, batch)
            if not self.under_way:
                return
            number, outcomes = self.wait()
            del self.under_way[number]
            for outcome in outcomes:
                self._mean_s += 0.2 * (outcome.record.times["wall_s"] - self._mean_s)
            yield outcomes

    @abc.abstractmethod
    def slots(self) -> int:
        """Return how many batches the workers compute at once."""

    @abc.abstractmethod
    def submit(self, number: int, batch: list[Job]) -> None:
        """Send a batch."""

    @abc.abstractmethod
    def wait(self) -> tuple[int, list[Outcome]]:
        """Wait for the next finished batch, and return its number and outcomes."""


class LocalPool(BatchingBackend):
    """Execution backend on local workers, until it is closed.

    Args:
        workers: how many processes compute at once.
    """

    def __init__(self, workers: int) -> None:
        super().__init__()
        self._workers, self._short_lives = workers, 0
        self._start()

    def _start(self) -> None:
        """Start the host in a session of its own, so that Ctrl-C reaches this process only."""
        path = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)  # for user modules
        quiet = "ignore::UserWarning:multiprocessing.resource_tracker"
        self._connection, theirs = multiprocessing.Pipe()
        with theirs:
            self._host = subprocess.Popen(
                [
                    *(sys.executable, "-m", "coop_pin.sweeps.worker_host"),
                    *(str(self._workers), str(theirs.fileno())),
                ],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what user code prints
                start_new_session=True,
                env=os.environ | dict.fromkeys(_THREADS, "1") | {"PYTHONPATH": path, "PYTHONWARNINGS": quiet},
            )
        self._started = time.monotonic()

    def close(self) -> int:
        """Let the host and its workers end, kill what is left of them, and return the host's exit code."""
        self._connection.close()
        end = time.monotonic() + _GRACE_S
        with contextlib.suppress(ProcessLookupError):
            while time.monotonic() < end:
                self._host.poll()
                os.killpg(self._host.pid, 0)
                time.sleep(0.01)
            os.killpg(self._host.pid, signal.SIGKILL)
        return self._host.wait()

    def slots(self) -> int:
        """Return the number of workers."""
        return self._workers

    def submit(self, number: int, batch: list[Job]) -> None:
        """Send a batch to the host."""
        limit_s = batch[0].time_limit_s + max(2.0, 0.5 * batch[0].time_limit_s)  # then the worker is killed
        with contextlib.suppress(OSError):  # of a host that died, which wait notices
            self._connection.send((number, [*map(pickle.dumps, batch)], limit_s, batch[0].memory_limit))

    def wait(self) -> tuple[int, list[Outcome]]:
        """Wait for the next reply; a host that died is replaced, and all batches are sent again."""
        while True:
            try:
                number, parts = self._connection.recv()
                break
            except (EOFError, OSError):
                self._restart()
        if isinstance(parts, CoopPinError):
            raise parts
        if isinstance(parts, Exception):
            raise WorkersLostError(f"a worker cannot run jobs ({type(parts).__name__}: {parts})") from parts
        batch = self.under_way[number]
        return number, [outcome for part in parts for outcome in _outcomes(part, batch)]

    def _restart(self) -> None:
        code, is_short = self.close(), time.monotonic() - self._started < _SHORT_LIFE_S
        self._short_lives = self._short_lives + 1 if is_short else 0
        if self._short_lives == _LIVES:
            reason = f"the host of local workers ended {_LIVES} times at once, at last with exit code {code}"
            raise WorkersLostError(f"{reason}; run with workers = 0 to see why")
        self._start()
        for number, batch in self.under_way.items():
            self.submit(number, batch)


def _outcomes(part: Any, batch: list[Job]) -> list[Outcome]:
    """Return the outcomes that the host sent, or that of a job that no worker finished."""
    if isinstance(part, bytes):
        return pickle.loads(part)
    number, end, tries, code = part
    job = batch[number]
    error = RunTimeoutError(job.time_limit_s) if end == "late" else WorkerDiedError(tries, code)
    times = {"wall_s": 0.0, "cpu_s": 0.0}
    return [Outcome(Record(job.key, dict(job.changes), failure=Failure.of(error), times=times))]
