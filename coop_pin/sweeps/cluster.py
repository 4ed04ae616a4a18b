"""A dask client: of a scheduler of our own with local workers, or of one that is there already."""

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
from types import TracebackType
from typing import Any, NamedTuple, Self

from coop_pin.errors import FieldError, MissingExtraError, WorkersLostError

_TRIES, _SHORT_LIFE_S, _GRACE_S = 3, 10.0, 3.0


class LocalWorkers:
    """Workers on this machine while the ``with`` block runs.

    Attributes:
        error: why there are no workers any more, once it is hopeless.
    """

    def __init__(self, address: str, count: int) -> None:
        self._command = [sys.executable, "-m", "coop_pin.sweeps.worker_host", address, str(count)]
        self._closing = threading.Event()
        self._process = self._start()
        self._keeper = threading.Thread(target=self._keep, name="coop-pin-workers", daemon=True)
        self.error: WorkersLostError | None = None

    def __enter__(self) -> Self:
        self._keeper.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._end(self._process)
        self._keeper.join(timeout=10.0)
        self._end(self._process)  # the keeper may have started another one meanwhile

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        """Ask the process to end, and after a moment end it and its workers together."""
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=_GRACE_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the process, in a session of its own: Ctrl-C on a terminal is for us to handle."""
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),  # noqa: PTH109 the user's own modules are found
            "DASK_LOGGING__DISTRIBUTED": "critical",  # workers that die are reported in records
            "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",  # workers need not watch themselves
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
        }
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, start_new_session=True, env=environment)

    def _keep(self) -> None:
        """Start the process again when it dies, unless it keeps dying at once."""
        short_lives = 0
        while True:
            started = time.monotonic()
            code = self._process.wait()
            if self._closing.is_set():
                return
            self._end(self._process)  # its workers may live on
            short_lives = short_lives + 1 if time.monotonic() - started < _SHORT_LIFE_S else 0
            if short_lives >= _TRIES:
                ended = f"local workers ended {_TRIES} times at once, the last time with exit code {code}"
                self.error = WorkersLostError(f"{ended}; run with workers = 0 to see why")
                return
            self._process = self._start()


try:
    import dask
    import distributed
    from distributed.comm.addressing import resolve_address
except ImportError:
    raise MissingExtraError("distributed", "sweep", "to run a sweep on several processes") from None

from coop_pin.sweeps.quiet import QuietScheduler

# Dask's own names carry no types.
_SCHEDULER: Any = distributed.SpecCluster
_CLIENT: Any = distributed.Client
# One task on a worker at a time, and none tried twice by the scheduler: whose run killed a worker is then
# beyond doubt.
# Its self-observation every 20 ms would cost 2 % of a processor in each process. It remembers messages, which
# hold scenarios: few are
# enough.
_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.low-level-log-length": 10,
}


class Cluster(NamedTuple):
    """Where runs are computed.

    Attributes:
        client: dask's.
        error: says why no worker will ever answer again, or None.
    """

    client: Any
    error: Callable[[], WorkersLostError | None]

    def threads(self) -> int:
        """Return how many runs the workers can do at once; at least one, since workers may still be on their way.

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
        """Say in our words that a scheduler is gone; dask says it in several, by its version and by how far it has noticed."""
        try:
            yield
        except Exception as error:
            if self.client.status == "running" and not isinstance(error, OSError):
                raise
            reason = f"the scheduler does not answer ({error}); start the same command again: finished runs are kept"
            raise WorkersLostError(reason) from error


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep dask's own reports of lost connections and workers from the terminal: they arrive as errors and as records."""
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
    """Yield a scheduler with so many workers of one thread each. It listens on the loopback device only and serves no web page."""
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
    """Yield a scheduler that is there already, with the workers it has and gets.

    Raises:
        FieldError: it is not an address.
        WorkersLostError: there is no scheduler at that address.
    """
    with dask.config.set(_SETTINGS), _quiet():
        try:
            _require_address(address)
            client = _CLIENT(address, set_as_default=False, timeout="5s")
        except OSError as error:
            raise WorkersLostError(
                f"there is no dask scheduler at {address!r} ({error}); start one with: dask scheduler"
            ) from None
        with client:
            yield Cluster(client, lambda: None)


def _require_address(address: str) -> None:
    """Refuse what is no address before a client is made of it, which would wait ten seconds for itself to close."""
    try:
        resolve_address(address)
    except ValueError as error:
        raise FieldError(
            f"is {address!r} ({error}); it must be an address such as tcp://127.0.0.1:8786", "scheduler"
        ) from None
