"""Host of a worker: ``python -m coop_pin.sweeps.workers.worker_host FD``, fed over a pipe, a call at a time.

The worker is a child of this process and not of the user's, whose script it would import: a script without
``if __name__ == "__main__"`` would start its sweep in every worker. Host and worker end with their parent,
and listen nowhere. Each worker has a host: whose run killed a worker is then certain, and one that is stopped
while it holds its pool's lock holds up no other.
"""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import pickle
import resource
import signal
import sys
import threading
import time
from concurrent import futures
from multiprocessing.connection import Connection, wait
from typing import Any

from pebble import ProcessPool

_POLL_S, _PAUSE_S = 0.2, 0.1
"""Interval of looks at the parent and at the pool, and pause at the end, s."""


def run_pickled(jobs: bytes, memory_limit: int) -> bytes:
    """Return the pickled outcomes of pickled jobs; called in a worker."""
    from coop_pin.sweeps.workers.batch_job import run_jobs

    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (memory_limit, hard))
    return pickle.dumps(run_jobs(pickle.loads(jobs)))


def start_worker() -> None:
    """Let a thread end this worker as soon as the host is gone, however that ended, and load the package."""
    host: Any = multiprocessing.parent_process()
    threading.Thread(target=lambda: os._exit(bool(wait([host.sentinel]))), daemon=True).start()
    importlib.import_module("coop_pin.sweeps.workers.job")  # loads Pinocchio, which the host does without


def main(fd: int) -> None:
    """Send the error and the value of every call that a connection brings, the first as the worker starts."""
    parent, spawn = Connection(fd), multiprocessing.get_context("spawn")
    pool: Any = ProcessPool(1, initializer=start_worker, context=spawn)
    call: tuple[Any, ...] = (os.getpid,)
    with contextlib.suppress(EOFError, OSError, RuntimeError, KeyboardInterrupt):  # no parent, a broken pool
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        while True:
            future = pool.schedule(*call)
            while not futures.wait([future], _POLL_S).done and pool.active and not parent.poll():
                pass
            error = future.exception(0.0)
            parent.send((error, None if error else future.result()))
            call = parent.recv()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # of a parent that does not know that this is the end
    pool.stop()
    time.sleep(_PAUSE_S)  # a worker that is just being started would report that it lost its parent
    for worker in multiprocessing.active_children():
        worker.kill()
    os._exit(0)  # the resource tracker then removes the pool's semaphores


if __name__ == "__main__":
    main(int(sys.argv[1]))
