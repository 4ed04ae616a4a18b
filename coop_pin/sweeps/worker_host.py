"""Host process of local workers: ``python -m coop_pin.sweeps.worker_host COUNT FD``, fed over a pipe.

Workers are children of this process and not of the user's, whose script they would import: a script without
``if __name__ == "__main__"`` would start its sweep in every worker. The host and its workers end with their
parent, and listen nowhere. Each worker has a pool of its own: whose run killed a worker is then certain, and
one that is stopped while it holds its pool's lock holds up no other.
"""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import pickle
import queue
import resource
import signal
import sys
import threading
import time
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection, wait
from typing import Any

from pebble import ProcessExpired, ProcessPool

_START_S, _STARTS, _POLL_S, _PAUSE_S = 60.0, 5, 0.2, 0.1
"""Time of a start, workers that may die in a row while they start, interval of looks, pause at the end; s."""
_TRIES = {"died": 3, "late": 2}
"""Workers that die with a job, or are killed at its time limit, before it has failed."""


def compute(jobs: list[bytes], memory_limit: int) -> bytes:
    """Return the pickled outcomes of pickled jobs; called in a worker."""
    from coop_pin.sweeps.job import run_job

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (memory_limit, hard))
    return pickle.dumps([run_job(pickle.loads(job)) for job in jobs])


def start_worker() -> None:
    """Let a thread end this worker as soon as the host is gone, however that ended, and load the package."""
    host: Any = multiprocessing.parent_process()
    threading.Thread(target=lambda: os._exit(bool(wait([host.sentinel]))), daemon=True).start()
    importlib.import_module("coop_pin.sweeps.job")  # loads Pinocchio, which the host does without


class _Slot(threading.Thread):
    """Place of one worker, for one batch of jobs at a time."""

    def __init__(self, tasks: queue.SimpleQueue[Any], parent: Connection, sending: threading.Lock) -> None:
        super().__init__(daemon=True)
        self._tasks, self._parent, self._sending = tasks, parent, sending
        self._new_pool()

    def run(self) -> None:
        """Compute batches and send what became of their parts, or the worker's own error."""
        with contextlib.suppress(OSError):  # whoever sent them has ended
            while True:
                number, jobs, *self._limits = self._tasks.get()
                try:
                    reply: Any = self._parts(jobs, 0, 0)
                except Exception as error:
                    reply = error
                with self._sending:
                    self._parent.send((number, reply))

    def _new_pool(self) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.pool: Any = ProcessPool(1, initializer=start_worker, context=spawn)

    def _parts(self, jobs: list[bytes], first: int, deaths: int) -> list[Any]:
        """Return pickled outcomes, or the number, the end, the tries and the exit code of a failed job.

        If a worker dies, or is killed at the time limit, the jobs of its batch are tried again, each alone.
        """
        end, content = self._attempt(jobs)
        if end == "failed":
            raise content
        if end == "done":
            return [content]
        if len(jobs) == 1 and deaths + 1 >= _TRIES[end]:
            return [(first, end, deaths + 1, content)]
        alone = enumerate(jobs, first)
        return [part for number, job in alone for part in self._parts([job], number, deaths + 1)]

    def _attempt(self, jobs: list[bytes]) -> tuple[str, Any]:
        """Return how an attempt ended, and pickled outcomes, an exit code or an error."""
        limit_s, memory_limit = self._limits
        for _ in range(_STARTS):
            with contextlib.suppress(RuntimeError):  # the pool broke: its worker died before it took jobs
                future = self.pool.schedule(compute, (jobs, memory_limit), timeout=limit_s)
                end = time.monotonic() + limit_s + _START_S
                while not (done := futures.wait([future], _POLL_S).done) and self.pool.active:
                    if time.monotonic() > end:  # stopped before it took the jobs, or holding its pool's lock
                        self._replace_pool()
                        return "died", -signal.SIGKILL
                error = future.exception() if done else None
                if isinstance(error, ProcessExpired | MemoryError):
                    return "died", getattr(error, "exitcode", 0)
                if isinstance(error, TimeoutError):
                    return "late", -signal.SIGKILL
                if error is not None and not isinstance(error, BrokenProcessPool):
                    return "failed", error
                if done and error is None:
                    return "done", future.result()
            self._replace_pool()
        raise RuntimeError(f"{_STARTS} workers in a row died while they started")

    def _replace_pool(self) -> None:
        self.pool.stop()
        self.pool.join()
        self._new_pool()


def main(count: int, fd: int) -> None:
    """Compute the batches that a connection brings until it closes."""
    parent, sending = Connection(fd), threading.Lock()
    tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
    slots = [_Slot(tasks, parent, sending) for _ in range(count)]
    for slot in slots:
        slot.start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            tasks.put(parent.recv())
    for slot in slots:
        slot.pool.stop()
    time.sleep(_PAUSE_S)  # a worker that is just being started would report that it lost its parent
    for worker in multiprocessing.active_children():
        os.kill(worker.pid or 0, signal.SIGKILL)
    os._exit(0)  # the resource tracker then removes the pools' semaphores


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
