"""Execution of many runs: where they are computed, by which engine, and what is taken over."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from coop_pin.base.errors import FieldError
from coop_pin.compiled.engines import Engine, engine_named


@dataclasses.dataclass(frozen=True)
class Execution:
    """Execution of the runs of a sweep, a search or a comparison.

    Attributes:
        workers: number of processes, 0 for this process; one for each processor when omitted.
            Compiled runs of laws of the package are computed by as many threads.
        scheduler: address of a dask scheduler to use instead of local processes, for example
            ``tcp://127.0.0.1:8786``.
        engine: pinocchio, each run alone; compiled, runs of one kind together; auto decides by the number of
            runs; the plan's when omitted, auto without a plan. A comparison decides for each kind of runs by
            itself.
        merge: folder of another sweep, search or comparison, whose runs are taken over where they are the
            same; once for each.
        recompute: number of runs of each such folder, drawn at random, that are computed here, too; if one
            differs, nothing of the folder is taken over.
        quiet: no progress bar, and no summary of a command.

    Raises:
        FieldError: there is no such engine.
        WrongTypeError: a value has another type.
    """

    workers: int | None = None
    scheduler: str | None = None
    engine: Engine | None = None
    merge: tuple[str | Path, ...] = ()
    recompute: int = 0
    quiet: bool = False

    def __post_init__(self) -> None:
        if (self.workers, self.scheduler, self.merge, self.recompute, self.quiet) != (None, None, (), 0, 0):
            self._require_types()
        if self.engine is not None:
            engine_named(self.engine, "engine")

    def _require_types(self) -> None:
        from coop_pin.base.arrays import as_count, require_path, require_type  # loads numpy: not for help

        kinds = {"workers": (int, type(None)), "scheduler": (str, type(None)), "merge": (list, tuple)}
        for name, allowed in (kinds | {"quiet": (bool,)}).items():
            require_type(name, getattr(self, name), *allowed)
        as_count("recompute", self.recompute)
        for folder in self.merge:
            require_path("merge", folder)

    @property
    def processes(self) -> int:
        """Number of local workers; one for each available processor if it is omitted.

        Raises:
            FieldError: it is negative.
        """
        if self.workers is not None and self.workers < 0:  # here, so that a command tells it on one line
            expected = "0 (this process) or a number of processes"
            raise FieldError(f"is {self.workers}; it must be {expected}", "workers")
        if self.workers is not None:
            return self.workers
        affinity = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # not on macOS
        return len(affinity(0))


HERE = Execution()
"""A worker for each processor, and the engine of the plan."""
