"""A dask client: of a scheduler of our own with local workers, or of one that is there already."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from coop_pin.errors import FieldError, MissingExtraError, WorkersLostError
from coop_pin.sweeps.workers import LocalWorkers

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
# One task on a worker at a time, and none tried twice by the scheduler: whose run killed a worker is then beyond doubt.
# Its self-observation every 20 ms would cost 2 % of a processor in each process. It remembers messages, which hold scenarios: few are
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
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.scheduler")]
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
            raise WorkersLostError(f"there is no dask scheduler at {address!r} ({error}); start one with: dask scheduler") from None
        with client:
            yield Cluster(client, lambda: None)


def _require_address(address: str) -> None:
    """Refuse what is no address before a client is made of it, which would wait ten seconds for itself to close."""
    try:
        resolve_address(address)
    except ValueError as error:
        raise FieldError(f"is {address!r} ({error}); it must be an address such as tcp://127.0.0.1:8786", "scheduler") from None
