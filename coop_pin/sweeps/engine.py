"""From a plan to a folder of runs."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tqdm import tqdm

from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, ScenarioError, SweepInterruptedError
from coop_pin.sweeps.backend import DaskBackend, SerialBackend, Where
from coop_pin.sweeps.job import Job, Outcome
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.record import Failure, Record
from coop_pin.sweeps.record_writer import OutcomeWriter
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import UserCode, run_key, unresolved_key, user_code
from coop_pin.sweeps.store import SweepStore


class SweepBar:
    """A progress bar on a terminal's stderr, nowhere else.

    Attributes:
        finished: runs done, those of earlier sessions included.
        failed: runs of these that failed.
    """

    def __init__(self, total: int, quiet: bool) -> None:
        self.finished, self.failed = 0, 0
        # disable=None: tqdm shows itself on terminals only. smoothing near 0: the rate of the whole session.
        self._bar = tqdm(
            total=total, unit=" runs", disable=True if quiet else None, smoothing=0.05, dynamic_ncols=True
        )

    def count(self, failed: bool, *, old: bool = False) -> None:
        """Count a run; old ones do not count as speed."""
        self.finished += 1
        self.failed += failed
        if old and not self._bar.disable:
            self._bar.initial += 1
        self._bar.set_postfix_str(f"{self.failed} failed" if self.failed else "", refresh=False)
        self._bar.update(1)

    def say(self, text: str) -> None:
        """Show a text before the bar."""
        self._bar.set_description_str(text, refresh=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()


_LOG = logging.getLogger("coop_pin.sweeps")
_OF_THE_MACHINE = ("RunTimeoutError", "WorkerDiedError", "MemoryError")
"""Failures that another try may not repeat."""


class Session:
    """A folder that is ours, and somebody who computes: for one plan after the other.

    Attributes:
        store: the folder.
        bar: how far it is.
    """

    def __init__(self, store: SweepStore, computer: SerialBackend | DaskBackend, bar: SweepBar) -> None:
        self.store, self.bar, self._computer = store, bar, computer

    def compute(self, plan: SweepPlan, *, retry_failed: bool = False) -> None:
        """Compute every run of a plan that the folder does not hold yet.

        Args:
            plan: what to run.
            retry_failed: run again what failed for want of time or of a worker.

        Raises:
            FieldError: it names code of the user's own that stands in no file or that workers cannot import,
                or the scheduler's address is none.
            CodeChangedError: code of the user's own was edited after it was loaded.
            FileWriteError: a file cannot be written.
            WorkersLostError: no worker is left.
        """
        _Pass(plan, self.store, self.bar, retry_failed).run(self._computer)


@contextlib.contextmanager
def open_session(folder: str | Path, where: Where, total: int, *, quiet: bool = False) -> Iterator[Session]:
    """Yield a session while it has the folder to itself.

    Args:
        folder: where runs are kept.
        where: where they are computed.
        total: number of runs that the progress bar counts to.
        quiet: no progress bar.

    Raises:
        StoreLockedError: another process works on the folder.
        SweepInterruptedError: Ctrl-C.
    """
    store = SweepStore(folder)
    with store.lock as lock:
        if lock.left_by:
            _LOG.warning(
                "the last sweep in %s (%s) ended without leaving; its finished runs are kept",
                folder,
                lock.left_by,
            )
        aside = store.tidy()
        if aside:
            _LOG.warning("%d files in %s that no sweep wrote were moved to quarantine", aside, folder)
        with SweepBar(total, quiet) as bar:
            try:
                with where.open() as computer:
                    yield Session(store, computer, bar)
            except KeyboardInterrupt:
                raise SweepInterruptedError(str(folder), bar.finished, total) from None


def run_plan(
    plan: SweepPlan, folder: str | Path, where: Where, *, retry_failed: bool = False, quiet: bool = False
) -> None:
    """Compute every run of a plan that the folder does not hold yet, in a session of its own.

    Args:
        plan: what to run.
        folder: where runs are kept.
        where: where they are computed.
        retry_failed: run again what failed for want of time or of a worker.
        quiet: no progress bar.

    Raises:
        CoopPinError: whatever ``open_session`` and ``Session.compute`` raise.
    """
    with open_session(folder, where, len(plan), quiet=quiet) as session:
        session.store.write_plan(plan)
        session.compute(plan, retry_failed=retry_failed)


class _Pass:
    """One pass through a plan."""

    def __init__(self, plan: SweepPlan, store: SweepStore, bar: SweepBar, retry_failed: bool) -> None:
        self._plan, self._store, self._bar, self._retry_failed = plan, store, bar, retry_failed
        self._under_way: dict[str, int] = {}

    def run(self, computer: SerialBackend | DaskBackend) -> None:
        """Compute, write and count."""
        with (
            OutcomeWriter(self._store) as writer,
            contextlib.closing(self._outcomes(computer, writer)) as outcomes,
        ):
            for outcome in outcomes:
                writer.write(outcome)
                for _ in range(self._under_way.pop(outcome.record.key)):
                    self._bar.count(outcome.record.failure is not None)

    def _outcomes(self, computer: SerialBackend | DaskBackend, writer: OutcomeWriter) -> Generator[Outcome]:
        yield from computer.outcomes(self._jobs(writer, isinstance(computer, DaskBackend)))

    def _jobs(self, writer: OutcomeWriter, elsewhere: bool) -> Iterator[Job]:
        """Yield what is still to be done; what cannot be done is written down at once."""
        for point in self._plan.points():
            keep = self._plan.keeps(point.number)
            try:
                scenario = self._plan.scenario(point.number)
            except ScenarioError as error:
                self._write_unresolved(point.number, error, writer)
                continue
            code = user_code(scenario, self._plan.metrics)
            _require_in_a_file(code, elsewhere)
            key = run_key(scenario, self._plan.metrics, code)
            if key in self._under_way:
                self._under_way[key] += 1
                continue
            record = writer.waiting(key) or self._store.read_or_set_aside(key, with_result=keep)
            if record is not None and not self._again(record):
                self._bar.count(record.failure is not None, old=True)
                continue
            self._under_way[key] = 1
            yield Job(
                key, scenario.model_dump_json(), self._plan.metrics, self._plan.time_limit_s, keep, code
            )

    def _again(self, record: Record) -> bool:
        return self._retry_failed and record.failure is not None and record.failure.kind in _OF_THE_MACHINE

    def _write_unresolved(self, index: int, error: ScenarioError, writer: OutcomeWriter) -> None:
        point = self._plan[index]
        key = unresolved_key(self._plan.base[point.base], point.changes)
        if (writer.waiting(key) or self._store.read_or_set_aside(key)) is None:
            writer.write(Outcome(Record(key, "", {}, Failure.of(error))))
        self._bar.count(True, old=True)


def _require_in_a_file(codes: tuple[UserCode, ...], elsewhere: bool) -> None:
    """Refuse code of the user's own that only this script or notebook can see: workers, or the key that tells an edit."""
    for code in codes:
        if code.name.startswith("__main__:") and (elsewhere or not code.digests):
            reason = (
                "workers cannot import"
                if elsewhere
                else "stands in no file, so that a later sweep could not tell that it was edited"
            )
            raise FieldError(
                f"names {code.name!r}, which {reason}; put it into a module (a file of its own)", "the plan"
            )


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
    """Run a scenario many times and return a table of the results; finished runs are kept in a folder and never run again.

    ``sweep("adept-paper", {"controller.gains.sign_gain": [0.0, 0.1, 0.2]}, out="out/sign-gain")``. Runs are
    keyed by what determines
    them: the same call resumes, a changed one computes what is new.

    Args:
        base: a SweepPlan, or the plan's ``base``: a scenario, its name or path, or several.
        axes: the values of each varied field.
        out: the folder that keeps the runs.
        workers: number of processes; one for each processor when omitted, 0 for this process (debugging).
        scheduler: address of a dask scheduler to use instead of local processes.
        retry_failed: run again what failed for want of time or of a worker.
        quiet: no progress bar.
        plan: further fields of the SweepPlan: changes, cases, zipped, sample, repeats, metrics, time_limit_s,
            keep.

    Raises:
        ScenarioError: the plan has mistakes.
        FieldError: it names code of the user's own that stands in no file or that workers cannot import, or
            the scheduler's address is none.
        CodeChangedError: code of the user's own was edited after it was loaded.
        StoreLockedError: another process works on the folder.
        FileWriteError: the disk is full; every run written before is kept.
        WorkersLostError: the scheduler is gone; every finished run is kept.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
    """
    chosen = _plan(base, axes, plan)
    run_plan(chosen, out, Where.of(workers, scheduler), retry_failed=retry_failed, quiet=quiet)
    result = SweepResult(chosen, SweepStore(out))
    result.write_tables()
    return result


def _plan(base: SweepPlan | Base, axes: Mapping[str, Any] | None, fields: Mapping[str, Any]) -> SweepPlan:
    if axes is not None:
        fields = {**fields, "axes": axes}
    if isinstance(base, SweepPlan):
        return base.replace(**fields)
    return SweepPlan(base=base, **fields)
