"""Sweep engine: computes the missing runs of a plan and stores them; ``sweep`` is its public function."""

from __future__ import annotations

import contextlib
import functools
import itertools
import logging
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from coop_pin.arrays import require_path, require_type
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, ScenarioError, SweepInterruptedError
from coop_pin.progress_bar import ProgressBar
from coop_pin.sweeps.backend import Backend, BackendOptions
from coop_pin.sweeps.job import Job, Outcome
from coop_pin.sweeps.plan import Point, SweepPlan
from coop_pin.sweeps.record import Failure, Record
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import CodeDigest, code_digests, run_key, unresolved_key
from coop_pin.sweeps.store import SweepStore

_LOG = logging.getLogger("coop_pin.sweeps")
_TRANSIENT = ("RunTimeoutError", "WorkerDiedError", "MemoryError")
"""Failures that may not occur again."""
_WRITERS, _WAITING = 4, 32
"""Threads that write outcomes, and outcomes that may wait for them."""


class Session:
    """A locked folder and an execution backend, for one plan after the other.

    Attributes:
        store: the folder.
        bar: the progress bar.
    """

    def __init__(
        self, store: SweepStore, options: BackendOptions, bar: ProgressBar, stack: contextlib.ExitStack
    ) -> None:
        self.store, self.bar, self._options, self._stack = store, bar, options, stack

    def compute(self, plan: SweepPlan, *, retry_failed: bool = False) -> None:
        """Compute every run of a plan that the folder does not hold yet.

        Args:
            plan: the runs.
            retry_failed: repeat runs that failed for lack of time or of a worker.

        Raises:
            FieldError: the plan names code that has no file or that workers cannot import, or the scheduler's
                address is malformed.
            MissingExtraError: dask is not installed.
            CodeChangedError: the user's code was edited after it was loaded.
            FileWriteError: a file cannot be written.
            WorkersLostError: no worker is left.
        """
        with OutcomeWriter(self.store) as writer:
            sweep_run = _SweepRun(plan, self.store, self.bar, writer, retry_failed)
            jobs = sweep_run.jobs(self._options.is_distributed)
            first = next(jobs, None)
            if first is not None:  # a finished sweep does not wait for workers
                sweep_run.compute(itertools.chain([first], jobs), self._backend)

    @functools.cached_property
    def _backend(self) -> Backend:
        return self._stack.enter_context(self._options.open())


@contextlib.contextmanager
def open_session(
    folder: str | Path, options: BackendOptions, total: int, *, quiet: bool = False
) -> Iterator[Session]:
    """Yield a session that has the folder to itself.

    Args:
        folder: folder of the sweep.
        options: execution backend.
        total: number of runs that the progress bar counts to.
        quiet: no progress bar.

    Raises:
        StoreLockedError: another process works on the folder.
        SweepInterruptedError: Ctrl-C.
    """
    store = SweepStore(folder)
    with store.lock as lock:
        if lock.killed_owner:
            message = "the last sweep in %s (%s) was killed; its finished runs are kept"
            _LOG.warning(message, folder, lock.killed_owner)
        moved = store.clean_up()
        if moved:
            _LOG.warning("%d foreign files in %s were moved to quarantine", moved, folder)
        with ProgressBar("runs", total=total, quiet=quiet, keep=True) as bar:
            try:
                with contextlib.ExitStack() as stack:
                    yield Session(store, options, bar, stack)
            except KeyboardInterrupt:
                raise SweepInterruptedError(str(folder), bar.finished, total) from None


class OutcomeWriter:
    """Writes outcomes in background threads while the ``with`` block runs; leaving it waits for all of them.

    A disk takes milliseconds to confirm that a file is written.
    """

    def __init__(self, store: SweepStore) -> None:
        self._store = store
        self._pool = ThreadPoolExecutor(_WRITERS, thread_name_prefix="coop-pin-writer")
        self._slots = threading.Semaphore(_WAITING)
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
            self._check()

    def write(self, outcome: Outcome) -> None:
        """Write an outcome soon; wait if too many are waiting.

        Raises:
            FileWriteError: an earlier file could not be written.
        """
        self._check()
        self._slots.acquire()
        self._waiting[outcome.record.key] = outcome.record
        self._pool.submit(self._write, outcome)

    def waiting(self, key: str) -> Record | None:
        """Return a record that is not on the disk yet."""
        return self._waiting.get(key)

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _write(self, outcome: Outcome) -> None:
        try:
            self._store.write(outcome.record, outcome.result)
            del self._waiting[outcome.record.key]
        except BaseException as error:
            self._error = self._error or error
        finally:
            self._slots.release()


class _SweepRun:
    """One pass through a plan: which runs are still to be computed, and what becomes of their outcomes."""

    def __init__(
        self, plan: SweepPlan, store: SweepStore, bar: ProgressBar, writer: OutcomeWriter, retry_failed: bool
    ) -> None:
        self._plan, self._store, self._bar, self._writer = plan, store, bar, writer
        self._retry_failed = retry_failed
        self._under_way: dict[str, int] = {}

    def compute(self, jobs: Iterator[Job], backend: Backend) -> None:
        """Compute jobs, write their outcomes and count them."""
        with contextlib.closing(backend.outcomes(jobs)) as outcomes:
            for outcome in outcomes:
                self._writer.write(outcome)
                for _ in range(self._under_way.pop(outcome.record.key)):
                    self._bar.count(outcome.record.failure is not None)

    def jobs(self, is_distributed: bool) -> Iterator[Job]:
        """Yield the jobs still to be computed; points whose scenario has mistakes are recorded at once."""
        metrics = self._plan.metrics
        for point in self._plan.points():
            keep = self._plan.keeps(point.number)
            try:
                scenario = self._plan.scenario(point.number)
            except ScenarioError as error:
                self._write_unresolved(point, error)
                continue
            code = code_digests(scenario, metrics)
            _require_files(code, is_distributed)
            key = run_key(scenario, metrics, code)
            if key in self._under_way:
                self._under_way[key] += 1
                continue
            record = self._writer.waiting(key) or self._store.read_or_quarantine(key, with_result=keep)
            failure = record.failure if record is not None else None
            is_repeated = self._retry_failed and failure is not None and failure.kind in _TRANSIENT
            if record is not None and not is_repeated:
                self._bar.count(failure is not None, old=True)
                continue
            self._under_way[key] = 1
            yield Job(key, scenario.model_dump_json(), metrics, self._plan.time_limit_s, keep, code)

    def _write_unresolved(self, point: Point, error: ScenarioError) -> None:
        key = unresolved_key(self._plan.base[point.base], point.changes)
        if (self._writer.waiting(key) or self._store.read_or_quarantine(key)) is None:
            self._writer.write(Outcome(Record(key, "", {}, Failure.of(error))))
        self._bar.count(True, old=True)


def _require_files(codes: tuple[CodeDigest, ...], is_distributed: bool) -> None:
    """Refuse code of a script or notebook that workers cannot import, or whose edits cannot be detected."""
    for code in codes:
        if code.name.startswith("__main__:") and (is_distributed or not code.digests):
            no_file = "has no file, so that a later sweep could not detect an edit"
            reason = "workers cannot import" if is_distributed else no_file
            detail = f"names {code.name!r}, which {reason}; put it into a module (a file of its own)"
            raise FieldError(detail, "the plan")


Base = str | Path | Scenario | Sequence[str | Path | Scenario] | Mapping[str, str | Path | Scenario]


def sweep(
    base: SweepPlan | Base,
    axes: Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    quiet: bool = False,
    **plan: Any,
) -> SweepResult:
    """Return the results of many runs of a scenario; finished runs are stored in a folder and never repeated.

    ``sweep("adept-paper", {"controller.gains.sign_gain": [0.0, 0.1, 0.2]}, out="out/sign-gain")``. Runs are
    found by a key of what determines them: the same call resumes an interrupted sweep, a changed one computes
    what is new.

    Args:
        base: a SweepPlan, or the plan's ``base``: a scenario, its name or path, or several.
        axes: the values of each varied field.
        out: folder of the sweep.
        workers: number of processes; one for each processor when omitted, 0 for this process (debugging).
        scheduler: address of a dask scheduler to use instead of local processes.
        retry_failed: repeat runs that failed for lack of time or of a worker.
        quiet: no progress bar.
        plan: further fields of the SweepPlan: changes, cases, zipped, sample, metrics, time_limit_s, keep.

    Raises:
        ScenarioError: the plan has mistakes.
        FieldError: the plan names code that has no file or that workers cannot import, or the scheduler's
            address is malformed.
        MissingExtraError: dask is not installed.
        CodeChangedError: the user's code was edited after it was loaded.
        StoreLockedError: another process works on the folder.
        FileWriteError: the disk is full; every run written before is kept.
        WorkersLostError: the scheduler is gone; every finished run is kept.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
    """
    require_path("out", out)
    require_type("retry_failed", retry_failed, bool)
    require_type("quiet", quiet, bool)
    fields = plan if axes is None else {**plan, "axes": axes}
    chosen = base.replace(**fields) if isinstance(base, SweepPlan) else SweepPlan(base=base, **fields)
    with open_session(out, BackendOptions.of(workers, scheduler), len(chosen), quiet=quiet) as session:
        session.store.write_plan(chosen)
        session.compute(chosen, retry_failed=retry_failed)
    result = SweepResult(chosen, session.store)
    result.write_tables()
    return result
