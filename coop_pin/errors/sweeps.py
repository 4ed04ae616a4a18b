"""Sweeps that stop, and stores that cannot be read or written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from coop_pin.errors.root import CoopPinError


class RunTimeoutError(CoopPinError, TimeoutError):
    """A run took longer than its limit.

    Attributes:
        limit: the limit, s of wall time.
    """

    def __init__(self, limit: float) -> None:
        self.limit = limit
        super().__init__(f"the run took longer than its limit of {limit:g} s; raise time_limit_s, shorten the run or lower steps_per_tick")


class WorkerDiedError(CoopPinError, RuntimeError):
    """A run ended its worker's process again and again: a crash in native code, an exit, or too little memory.

    Attributes:
        deaths: how many workers died with it.
    """

    def __init__(self, deaths: int) -> None:
        self.deaths = deaths
        super().__init__(f"{deaths} workers died while running it; run it alone (workers = 0) to see why")


class WorkersLostError(CoopPinError, ConnectionError):
    """No worker is left, or the scheduler is gone; every finished run is kept."""


class CodeChangedError(CoopPinError, RuntimeError):
    """A process that runs the user's own code loaded it before an edit, or has another version of it.

    Attributes:
        name: the code, "module:function".
    """

    def __init__(self, name: str) -> None:
        self.name = name
        again = "start the same command again (in a notebook restart the kernel, elsewhere the workers): finished runs are kept"
        super().__init__(f"{name} is not as this process loaded it: it was edited since, or a worker has another version; {again}")


class SweepStoreError(CoopPinError, ValueError):
    """A folder is not that of a sweep, or its plan is damaged."""


class StoreLockedError(CoopPinError, RuntimeError):
    """Another process works on the folder of a sweep.

    Attributes:
        owner: who holds it, as far as it said.
    """

    def __init__(self, folder: str, owner: str) -> None:
        self.owner = owner
        super().__init__(f"{folder} is in use by {owner}; wait until it ends, or choose another folder")


class StoreWriteError(CoopPinError, OSError):
    """A file of a sweep cannot be written; every run written before is kept.

    Attributes:
        path: the file.
        reason: what the system said.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"{path} cannot be written: {reason}; make room, then run the same command again: finished runs are kept")


class UnfinishedSweepError(CoopPinError, ValueError):
    """A question needs every run of a sweep, and some are missing or failed.

    Attributes:
        unfinished: how many.
    """

    def __init__(self, question: str, unfinished: int, total: int) -> None:
        self.unfinished = unfinished
        super().__init__(f"{question} needs all {total} runs, but {unfinished} of them failed or are missing; look at result.failures")


class NothingFeasibleError(CoopPinError, ValueError):
    """Tuning found no run within all bounds.

    Attributes:
        tried: number of runs.
        failed: how many of them failed.
        folder: where they are kept.
    """

    def __init__(self, tried: int, failed: int, bounds: Sequence[str], folder: str, complaint: str = "") -> None:
        self.tried, self.failed, self.folder = tried, failed, folder
        wanted = "keeps " + ", ".join(bounds) if bounds else "has a finite metric"
        said = f"; the first that failed said: {complaint}" if complaint else ""
        super().__init__(
            f"none of {tried} runs ({failed} failed), kept in {folder}, {wanted};"
            f" change the ranges, loosen the bounds or search longer{said}"
        )


class SweepInterruptedError(KeyboardInterrupt):
    """Ctrl-C during a sweep; every finished run is kept. A KeyboardInterrupt, so that ``except Exception`` lets it pass.

    Attributes:
        folder: the folder of the sweep.
        finished: number of runs it holds.
        total: number of runs of the plan.
    """

    def __init__(self, folder: str, finished: int, total: int) -> None:
        self.folder, self.finished, self.total = folder, finished, total
        super().__init__(f"interrupted with {finished} of {total} runs kept in {folder}; run the same command again to go on")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by fields, not by message."""
        return type(self), (self.folder, self.finished, self.total)
