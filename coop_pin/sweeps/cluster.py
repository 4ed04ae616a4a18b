"""Dask clusters: local workers with a scheduler of their own, or an existing scheduler."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import dask
import distributed
from distributed.comm.addressing import resolve_address

from coop_pin.errors import FieldError, WorkersLostError

# Names of dask without types.
_SCHEDULER: Any = distributed.SpecCluster
_CLIENT: Any = distributed.Client
# One task on a worker at a time, and none repeated by the scheduler: it is then certain whose run killed a
# worker. Observing itself every 20 ms would cost 2 % of a processor in each process. Dask stores past
# messages, which hold scenarios: few are enough.
_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.low-level-log-length": 10,
}
_TRIES, _SHORT_LIFE_S, _GRACE_S = 3, 10.0, 3.0
RESUME = "start the same command again: finished runs are kept"
"""Advice of every error that ends a sweep on workers."""


class QuietScheduler(distributed.Scheduler):
    """Dask scheduler without its web server."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open nothing: ``dashboard=False`` leaves a server for health checks and statistics on port 8787."""


class QuietWorker(distributed.Worker):
    """Dask worker without its web server."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open nothing."""


class LocalWorkers:
    """Workers on this machine, while the ``with`` block runs.

    Attributes:
        error: why the workers cannot be started again, once that is certain.
    """

    def __init__(self, address: str, count: int) -> None:
        self._command = [sys.executable, "-m", "coop_pin.sweeps.worker_host", address, str(count)]
        self._closing = threading.Event()
        self._process = self._start()
        self._supervisor = threading.Thread(target=self._supervise, name="coop-pin-workers", daemon=True)
        self.error: WorkersLostError | None = None

    def __enter__(self) -> Self:
        self._supervisor.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._end(self._process)
        self._supervisor.join(timeout=10.0)
        self._end(self._process)  # the thread may have started another one meanwhile

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        """Ask the process to end, and kill it and its workers together if it takes too long."""
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=_GRACE_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the process in a session of its own, so that Ctrl-C reaches this process only."""
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path),  # for user modules
            "DASK_LOGGING__DISTRIBUTED": "critical",  # deaths of workers are reported in records
            "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
        }
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, start_new_session=True, env=environment)

    def _supervise(self) -> None:
        """Restart the process when it dies, unless it repeatedly dies at once."""
        short_lives = 0
        while True:
            started = time.monotonic()
            code = self._process.wait()
            if self._closing.is_set():
                return
            self._end(self._process)  # its workers may live on
            short_lives = short_lives + 1 if time.monotonic() - started < _SHORT_LIFE_S else 0
            if short_lives >= _TRIES:
                reason = f"local workers ended {_TRIES} times at once, the last time with exit code {code}"
                self.error = WorkersLostError(f"{reason}; run with workers = 0 to see why")
                return
            self._process = self._start()


class Cluster(NamedTuple):
    """A connected dask cluster.

    Attributes:
        client: dask's client.
        error: returns why its workers are lost for good, or None.
    """

    client: Any
    error: Callable[[], WorkersLostError | None]

    def threads(self) -> int:
        """Return how many runs the workers compute at once; at least one, since workers may be starting.

        Raises:
            WorkersLostError: the scheduler is gone.
        """
        with self._answering():
            return max(1, sum(self.client.nthreads().values()))

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the future of a call on a worker.

        Raises:
            WorkersLostError: the scheduler is gone.
        """
        with self._answering():
            return self.client.submit(function, *arguments, pure=False)

    def listen(self, topic: str, handler: Callable[[tuple[float, Any]], None]) -> None:
        """Call a function with the time and the content of every event that workers report under a topic.

        Raises:
            WorkersLostError: the scheduler is gone.
        """
        with self._answering():
            self.client.subscribe_topic(topic, handler)

    @contextlib.contextmanager
    def _answering(self) -> Iterator[None]:
        """Raise one error for a lost scheduler; dask raises several, depending on version and state."""
        try:
            yield
        except Exception as error:
            if self.client.status == "running" and not isinstance(error, OSError):
                raise
            raise WorkersLostError(f"the scheduler does not answer ({error}); {RESUME}") from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silence dask's logs of lost connections and workers, which arrive as errors and records."""
    loggers = [
        logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.scheduler")
    ]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextlib.contextmanager
def local_cluster(workers: int) -> Iterator[Cluster]:
    """Yield a scheduler with local workers of one thread each; it listens on the loopback device only."""
    options = {"host": "127.0.0.1", "port": 0, "protocol": "tcp://", "dashboard": False}
    spec = {"cls": QuietScheduler, "options": options}
    with (
        dask.config.set(_SETTINGS),
        _quiet(),
        _SCHEDULER(scheduler=spec, workers={}, silence_logs=logging.CRITICAL) as scheduler,
        LocalWorkers(scheduler.scheduler_address, workers) as local,
        _CLIENT(scheduler, set_as_default=False) as client,
    ):
        yield Cluster(client, lambda: local.error)


@contextlib.contextmanager
def remote_cluster(address: str) -> Iterator[Cluster]:
    """Yield an existing scheduler, with the workers that it has and gets.

    Raises:
        FieldError: the address is malformed.
        WorkersLostError: there is no scheduler at that address.
    """
    with dask.config.set(_SETTINGS), _quiet():
        try:
            resolve_address(address)  # a client with a malformed address would take ten seconds to close
            client = _CLIENT(address, set_as_default=False, timeout="5s")
        except ValueError as error:
            wanted = "an address such as tcp://127.0.0.1:8786"
            raise FieldError(f"is {address!r} ({error}); it must be {wanted}", "scheduler") from None
        except OSError as error:
            advice = "start one with: dask scheduler"
            raise WorkersLostError(f"there is no dask scheduler at {address!r} ({error}); {advice}") from None
        with client:
            yield Cluster(client, lambda: None)
