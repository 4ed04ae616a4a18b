"""Execution backend on a dask scheduler, whose workers compute runs in local pools of their own."""

from __future__ import annotations

import contextlib
import logging
import pickle
import queue
import threading
import time
import uuid
from collections.abc import Iterator
from typing import Any

import distributed
from distributed.comm.addressing import resolve_address

from coop_pin.errors import CoopPinError, FieldError, WorkersLostError
from coop_pin.sweeps.backend import BatchingBackend, LocalPool
from coop_pin.sweeps.job import Job, Outcome

_CLIENT: Any = distributed.Client  # without types
_POLL_S, _PATIENCE_S = 2.0, 30.0
"""Interval of looks, and time for which a scheduler may be unreachable, s."""
_RESUME = "start the same command again: finished runs are kept"
_LOG = logging.getLogger("coop_pin.sweeps")


class DaskBackend(BatchingBackend):
    """Execution backend on the workers of a dask scheduler.

    Each of their threads keeps one local worker process for this sweep: a run that hangs or ends its process
    harms no dask worker, and user code is loaded anew for every sweep.
    """

    def __init__(self, client: Any) -> None:
        super().__init__()
        self._client, self._name = client, uuid.uuid4().hex
        self._finished: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def slots(self) -> int:
        """Return the number of threads of all workers, which come and go; at least one."""
        with self._answering():
            return max(1, sum(self._client.nthreads().values()))

    def submit(self, number: int, batch: list[Job]) -> None:
        """Send a batch to the scheduler."""
        with self._answering():
            future = self._client.submit(compute, self._name, pickle.dumps(batch), pure=False)
        future.add_done_callback(lambda done: self._finished.put((number, done)))

    def wait(self) -> tuple[int, list[Outcome]]:
        """Wait for the next finished batch."""
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            with contextlib.suppress(queue.Empty):
                number, future = self._finished.get(timeout=_POLL_S)
                with self._answering():
                    return number, pickle.loads(future.result())
            if self._client.status == "running":
                end = time.monotonic() + _PATIENCE_S
        raise WorkersLostError(f"the scheduler does not answer; {_RESUME}")

    @contextlib.contextmanager
    def _answering(self) -> Iterator[None]:
        """Raise one error for a lost scheduler or worker; dask raises several, by version and state."""
        try:
            yield
        except CoopPinError:
            raise
        except Exception as error:
            is_lost = isinstance(error, OSError | distributed.CancelledError)
            reason = (
                f"a worker cannot run jobs ({type(error).__name__}: {error}): another version of coop_pin?"
            )
            if is_lost or self._client.status != "running":
                reason = f"the scheduler does not answer ({error}); {_RESUME}"
            raise WorkersLostError(reason) from error

    def close(self) -> None:
        """Let the dask workers end the processes of this sweep."""
        with contextlib.suppress(Exception):  # the scheduler may be gone; another sweep ends them as well
            self._client.run(close_pools, self._name)


_pools: dict[int, tuple[str, LocalPool]] = {}
"""In a dask worker: the sweep and the local worker of each of its threads."""


def compute(name: str, jobs: bytes) -> bytes:
    """Return the outcomes of jobs, both pickled; called in a thread of a dask worker, for a sweep."""
    thread = threading.get_ident()
    if (known := _pools.get(thread, ("",))[0]) != name:
        close_pools(known)
        _pools[thread] = name, LocalPool(1)
    batches = _pools[thread][1].outcomes(iter(pickle.loads(jobs)))
    return pickle.dumps([outcome for batch in batches for outcome in batch])


def close_pools(name: str) -> None:
    """End the local workers of a sweep."""
    for thread in [thread for thread, (sweep, _) in _pools.items() if sweep == name]:
        _pools.pop(thread)[1].close()


@contextlib.contextmanager
def connected(address: str) -> Iterator[DaskBackend]:
    """Yield the backend on an existing scheduler, with the workers that it has and gets.

    Certificates and keys for a tls:// address are those of dask's own configuration.

    Raises:
        FieldError: the address is malformed.
        WorkersLostError: there is no scheduler at that address.
    """
    with contextlib.ExitStack() as stack:
        for logger in map(logging.getLogger, ("distributed", "distributed.client")):
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)  # what is lost arrives as errors and records
        try:
            resolve_address(address)  # a client with a malformed address would take ten seconds to close
            client = stack.enter_context(_CLIENT(address, set_as_default=False, timeout="5s"))
        except (ValueError, TypeError) as error:
            wanted = "an address such as tls://192.0.2.1:8786, with certificates in dask's configuration"
            raise FieldError(f"is {address!r} ({error}); it must be {wanted}", "scheduler") from None
        except OSError as error:
            said = f"there is no dask scheduler at {address!r} ({error})"
            raise WorkersLostError(f"{said}; start one with: dask scheduler") from None
        if not address.startswith("tls://"):
            _LOG.warning("%s has no TLS: whoever reaches it can read the runs and run code as you", address)
        yield stack.enter_context(contextlib.closing(DaskBackend(client)))
