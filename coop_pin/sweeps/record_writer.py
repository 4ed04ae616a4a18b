"""Writing beside computing: a disk takes milliseconds to promise that a file is there."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

from coop_pin.sweeps.job import Outcome
from coop_pin.sweeps.record import Record
from coop_pin.sweeps.store import SweepStore

_THREADS, _WAITING = 4, 32


class OutcomeWriter:
    """Writes outcomes in the background while the ``with`` block runs; leaving it waits until all are on the disk."""

    def __init__(self, store: SweepStore) -> None:
        self._store = store
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="coop-pin-writer")
        self._room = threading.Semaphore(_WAITING)
        self._error: BaseException | None = None
        self._waiting: dict[str, Record] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait.

        Raises:
            FileWriteError: a file could not be written.
        """
        self._pool.shutdown(wait=True)
        if error is None:
            self.check()

    def write(self, outcome: Outcome) -> None:
        """Write soon; waits when the disk falls behind.

        Raises:
            FileWriteError: an earlier file could not be written.
        """
        self.check()
        self._room.acquire()
        self._waiting[outcome.record.key] = outcome.record
        self._pool.submit(self._write, outcome).add_done_callback(self._written)

    def waiting(self, key: str) -> Record | None:
        """Return a record that is on its way to the disk."""
        return self._waiting.get(key)

    def check(self) -> None:
        """Raise what went wrong in the background."""
        if self._error is not None:
            raise self._error

    def _write(self, outcome: Outcome) -> None:
        self._store.write(outcome.record, outcome.result)
        del self._waiting[outcome.record.key]

    def _written(self, future: Future[None]) -> None:
        self._error = self._error or future.exception()
        self._room.release()
