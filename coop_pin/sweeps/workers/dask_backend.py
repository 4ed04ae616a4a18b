"""Execution backend on a dask scheduler, whose workers hand runs to worker processes of their own."""

from __future__ import annotations

import contextlib
import logging
import pickle
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from typing import Any

import distributed
from distributed.comm.addressing import resolve_address

from coop_pin.base.errors import FieldError, WorkersLostError
from coop_pin.sweeps.workers import backend
from coop_pin.sweeps.workers.job import Job, Outcome

_CLIENT: Any = distributed.Client  # without types
_PATIENCE_S = 30.0
"""Time for which a scheduler may be unreachable, s."""
_LOG = logging.getLogger("coop_pin.sweeps")


class DaskBackend:
    """Execution backend on the workers of a dask scheduler.

    Each of their threads keeps one worker process for this sweep: a run that hangs or ends its process harms
    no dask worker, and user code is loaded anew for every sweep.
    """

    def __init__(self, client: Any) -> None:
        self._client, self._executor = client, client.get_executor(pure=False)
        self._name, self._answered, self._slots = uuid.uuid4().hex, time.monotonic(), 1

    def slots(self) -> int:
        """Return the number of threads of all dask workers, which come and go; at least one."""
        try:
            self._slots = max(1, sum(self._client.nthreads().values()))
            self._answered = time.monotonic()
        except OSError:
            if time.monotonic() - self._answered > _PATIENCE_S:
                raise
        return self._slots

    def submit(self, batch: Sequence[Job]) -> Future[list[Outcome]]:
        """Send a batch to the scheduler."""
        return self._executor.submit(run_pickled, self._name, pickle.dumps(batch))

    def close(self) -> None:
        """Let the dask workers end the worker processes of this sweep."""
        with contextlib.suppress(Exception):  # the scheduler may be gone; another sweep ends them as well
            self._client.run(backend.close_workers, self._name)


def run_pickled(sweep: str, jobs: bytes) -> list[Outcome]:
    """Return the outcomes of pickled jobs, in which dask does not look for its own keys."""
    return backend.run_in_thread(sweep, pickle.loads(jobs))


def _close(client: Any) -> None:
    """Close a client; one whose scheduler is gone may fail in dask, with errors of its own."""
    with contextlib.suppress(Exception):
        client.close()


@contextlib.contextmanager
def connected(address: str) -> Iterator[DaskBackend]:
    """Yield the backend on an existing scheduler, with the workers that it has and gets.

    Certificates and keys for a tls:// address are those of dask's own configuration.

    Raises:
        FieldError: the address is malformed.
        WorkersLostError: there is no scheduler at that address.
    """
    with contextlib.ExitStack() as stack:
        for logger in map(logging.getLogger, ("distributed", "distributed.client", "tornado.application")):
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)  # what is lost arrives as errors and records
        try:
            resolve_address(address)  # a client with a malformed address would take ten seconds to close
            client = _CLIENT(address, set_as_default=False, timeout="5s")
            stack.callback(_close, client)
        except (ValueError, TypeError) as error:
            form = "an address such as tls://192.0.2.1:8786, with certificates in dask's configuration"
            raise FieldError(f"is {address!r} ({error}); it must be {form}", "scheduler") from None
        except OSError as error:
            text = f"there is no dask scheduler at {address!r} ({error})"
            raise WorkersLostError(f"{text}; start one with: dask scheduler") from None
        if not address.startswith("tls://"):
            _LOG.warning("%s has no TLS: whoever reaches it can read the runs and run code as you", address)
        yield stack.enter_context(contextlib.closing(DaskBackend(client)))
