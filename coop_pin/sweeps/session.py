"""Session of a sweep: a locked folder and an execution backend, which compute the missing runs of plans."""

from __future__ import annotations

import contextlib
import functools
import gc
import itertools
import logging
import random
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from coop_pin.base.errors import (
    CoopPinError,
    FieldError,
    FileReadError,
    ScenarioError,
    SweepInterruptedError,
    is_ctrl_c,
    needs_extra,
)
from coop_pin.compiled.engine_choice import choose_engines
from coop_pin.compiled.engines import Way
from coop_pin.description.scenario import Scenario
from coop_pin.running.check import run_findings
from coop_pin.stability.step_size import STEPS_FIELD
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.progress_bar import ProgressBar
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import KeyedPoint, keyed_points
from coop_pin.sweeps.store import TRANSIENT, SweepStore
from coop_pin.sweeps.table import Columns, require_own_names
from coop_pin.sweeps.workers.backend import LocalBackend, outcomes, outcomes_here
from coop_pin.sweeps.workers.execution import Execution
from coop_pin.sweeps.workers.job import Job, JobRecord, Outcome

_LOG = logging.getLogger("coop_pin.sweeps")


class Session:
    """A locked folder and an execution backend, for one plan after the other.

    Attributes:
        store: the folder.
        bar: the progress bar.
        keys: keys of the points of the last plan.
        columns: columns of the runs computed for it.
    """

    bar: ProgressBar

    def __init__(self, store: SweepStore, execution: Execution) -> None:
        self.store, self._execution, self._processes = store, execution, execution.processes
        self._has_looked, self._names, self._remarks = False, set[str](), set[str]()
        self.stack, self._is_over = contextlib.ExitStack(), threading.Event()
        self.stack.callback(self._is_over.set)

    def compute(self, plan: SweepPlan, *, retry_failed: bool = False) -> None:
        """Compute every run of a plan that the folder does not hold yet.

        Args:
            plan: the runs.
            retry_failed: repeat runs that failed for lack of time, of memory or of a worker.

        Raises:
            FieldError: the number of plant steps is not chosen, the plan names code that has no file or that
                workers cannot import, or the scheduler's address is malformed.
            MissingExtraError: dask is not installed.
            CodeChangedError: the user's code was edited after it was loaded.
            FileWriteError: a file cannot be written.
            WorkersLostError: no worker is left.
        """
        if plan.has_open_steps:
            raise FieldError("is 'auto', which cp.run and cp.sweep choose; give a number here", STEPS_FIELD)
        for folder in self._execution.merge:
            self._merge(plan, SweepStore(folder))
        self.keys, self._repeated, self._kept = list[str](), list[str](), set[str]()
        self._is_foreign, self._is_new, self.columns = False, True, Columns(len(plan))
        self._way = _way(plan)
        under_way, refused = set[str](), list[Outcome]()
        jobs = self._jobs(plan, retry_failed, under_way, refused)
        for first in jobs:  # a finished sweep does not wait for workers
            self._log_findings(plan)
            with contextlib.closing(self._outcomes(itertools.chain([first], jobs))) as batches:
                for batch in batches:
                    self._store(plan, batch)
                    under_way.difference_update(outcome.record.key for outcome in batch)
                    self.bar.count(len(batch), failed=sum(bool(record.failure) for record, *_ in batch))
        # Equal points may come while their run is under way: they count when all are done.
        self.bar.count(len(self._repeated), failed=sum(bool(self.store.known[key]) for key in self._repeated))
        self._store(plan, refused)
        if self._is_foreign and self._way == "lanes":
            self._check_batches(plan)

    def _log_findings(self, plan: SweepPlan) -> None:
        """Log errors and warnings that are known of the first point; user's code is not run here."""
        if self._has_looked or self._execution.quiet:
            return
        self._has_looked, scenario = True, plan.resolved(plan[0])
        if not isinstance(scenario, Scenario):
            return
        if not (scenario.controller.user_code or "function" in (scenario.motion.kind, scenario.squeeze.kind)):
            with contextlib.suppress(CoopPinError):  # of which its run tells
                for finding in run_findings(scenario).of("error", "warning"):
                    _LOG.warning("run 0 of the sweep: %s", finding)

    def _store(self, plan: SweepPlan, outcomes: Sequence[Outcome]) -> None:
        """Store outcomes of the plan's runs; a name that another column has is refused before."""
        records = [outcome.record for outcome in outcomes]
        remarks = {remark for outcome in outcomes for remark in outcome.remarks} - self._remarks
        self._remarks |= remarks
        for remark in sorted(remarks):
            _LOG.warning("%s", remark)
        require_own_names(plan, set[str]().union(*(record.metrics for record in records)))
        self.columns.add(records)
        self.store.append(outcomes)

    def result(self, plan: SweepPlan) -> SweepResult:
        """Return the results of the last plan; the store is read if it had some of them before."""
        return SweepResult(plan, self.store, self.keys, self.columns if self._is_new else None)

    def _merge(self, plan: SweepPlan, other: SweepStore) -> None:
        """Store what another folder has of a plan, if a sample of it that is repeated here agrees.

        The sample is drawn anew each time, so that nobody knows it before; nothing else depends on it.
        """
        numbers = {keyed.key: keyed.point.number for keyed in keyed_points(plan)}
        records = self.store.missing_of(other, numbers)
        try:
            require_own_names(plan, {name for record in records.values() for name in record.metrics})
        except FieldError as error:
            raise FileReadError(f"cannot be merged: its runs {error}", str(other.folder)) from None
        count = min(self._execution.recompute, len(records))
        drawn = sorted(random.SystemRandom().sample([numbers[key] for key in records], count))
        sound = [number for number in drawn if isinstance(plan.resolved(plan[number]), Scenario)]
        singles = [outcome.record for outcome in self._singly(plan, sound)] if sound else []
        if reason := _difference(records, singles):
            detail = f"is not merged: of {len(sound)} of its runs that were repeated here, {reason}"
            raise FileReadError(detail, str(other.folder))
        self.store.append([Outcome(record) for record in records.values()])

    def _check_batches(self, plan: SweepPlan) -> None:
        """Repeat two runs of each new family of a user's law singly; if one differs, all of the family.

        A family that agrees is kept in the folder, as a record of its own, and never checked again.
        """
        from coop_pin.compiled.laws.support import checked, disagreement  # slow to load

        numbers = {key: number for number, key in reversed([*enumerate(self.keys)])}
        families = dict[str, list[int]]()
        for key, family in self.store.families().items():
            if key in numbers and family not in self.store.known:
                families.setdefault(family, []).append(numbers[key])
        for family, members in families.items():
            members.sort()
            singles = self._singly(plan, checked(members, lambda number: _of_the_law(plan[number].changes)))
            records = [outcome.record for outcome in singles]
            if reason := _difference(self.store.read_records([each.key for each in records]), records):
                scenario = plan.scenario(members[0])
                _LOG.warning(
                    "runs of %r are repeated one by one: %s", scenario.name, disagreement(scenario, reason)
                )
                self._store(plan, self._singly(plan, members))
            elif not {outcome.record.failure for outcome in singles} & {*TRANSIENT}:
                self.store.append([Outcome(JobRecord(family))])

    def _singly(self, plan: SweepPlan, numbers: Sequence[int]) -> list[Outcome]:
        """Return the outcomes of single runs of a plan's points."""
        jobs = (_job(plan, keyed, "pinocchio") for keyed in keyed_points(plan, numbers))
        with contextlib.closing(self._outcomes(jobs)) as batches:
            return list(itertools.chain.from_iterable(batches))

    @functools.cached_property
    def _outcomes(self) -> Callable[[Iterator[Job]], Generator[list[Outcome]]]:
        """Outcomes of jobs, by the backend."""
        scheduler, processes = self._execution.scheduler, self._processes
        if not scheduler:
            if not processes:
                return outcomes_here
            return self.stack.enter_context(contextlib.closing(LocalBackend(processes))).outcomes
        with needs_extra("distributed", "sweep", "to run a sweep on a scheduler"):
            from coop_pin.sweeps.workers.dask_backend import connected  # slow to load
        return functools.partial(outcomes, self.stack.enter_context(connected(scheduler)))

    def _jobs(
        self, plan: SweepPlan, retry_failed: bool, under_way: set[str], refused: list[Outcome]
    ) -> Iterator[Job]:
        """Yield the jobs still to be computed, to any thread; note the points whose scenario has mistakes."""
        for keyed in keyed_points(plan):
            point, key, scenario = keyed.point, keyed.key, keyed.example
            self._require_files(keyed.code)
            if new := {name for name, _ in keyed.code} - self._names:
                self._names |= new
                self.store.write_code(self._names)
            self.keys.append(key)
            if keyed.code and isinstance(scenario, Scenario):
                self._is_foreign |= bool(scenario.controller.user_code)
            if self._is_over.is_set():
                return
            is_begun, keep = key in under_way or key in self.columns.places, plan.keeps(point.number)
            if is_begun and (not keep or key in self._kept):
                self._repeated.append(key)
                continue
            kind = self.store.known.get(key)
            self._is_new &= kind is None
            again = retry_failed and kind in TRANSIENT
            if isinstance(scenario, ScenarioError):
                if kind is None:
                    refused.append(Outcome(JobRecord.of_failure(key, point.changes, scenario)))
                self.bar.count(failed=1, old=True)
            elif kind is not None and not again and (kind or not keep or self.store.read_result(key)):
                self.bar.count(failed=bool(kind), old=True)
            else:
                under_way.add(key)
                if keep:
                    self._kept.add(key)
                yield _job(plan, keyed, self._way)

    def _require_files(self, code: Sequence[tuple[str, Sequence[str]]]) -> None:
        """Refuse code of a script or notebook that workers cannot import, or whose edits go undetected."""
        for name, digests in code:
            is_here = not (self._processes or self._execution.scheduler)
            if name.startswith("__main__:") and not (is_here and digests):
                reason = "has no file in which edits could be seen" if is_here else "workers cannot import"
                detail = f"names {name!r}, which {reason}; put it into a module (a file of its own)"
                raise FieldError(detail, "the plan")


def _of_the_law(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes of a run in its law."""
    return {path: value for path, value in changes.items() if path.startswith("controller")}


def _way(plan: SweepPlan) -> Way:
    """Return how the runs of a plan are computed: as the first one without mistakes can be."""
    tried = map(plan.resolved, plan.points())
    first = next((each for each in tried if isinstance(each, Scenario)), plan.resolved(plan[0]))
    (choice,) = choose_engines([first], plan.engine, [1], traces_user_code=False)
    _LOG.info(choice.summary())
    return choice.way


def _job(plan: SweepPlan, keyed: KeyedPoint, way: Way) -> Job:
    """Return the job of a point whose scenario has no mistakes."""
    point, limits = keyed.point, (plan.time_limit_s, int(plan.memory_limit_gb * 1e9))
    options = (point.changes, plan.metrics, *limits, plan.keeps(point.number), keyed.code, way)
    return Job(keyed.key, cast(Scenario, keyed.example), *options, keyed.pattern, keyed.numbers)


def _difference(stored: Mapping[str, JobRecord], singles: Sequence[JobRecord]) -> str:
    """Return how stored runs differ from single ones; nothing of those that lacked time or memory."""
    from coop_pin.compiled.laws.support import difference  # slow to load

    for single in singles:
        record = stored[single.key]
        if single.failure in TRANSIENT:
            continue
        if single.failure != record.failure:
            return f"a single run ends with {single.failure or 'its last tick'}: {single.message}"
        if missing := {*single.metrics} - {*record.metrics}:
            return f"{min(missing)} is missing in a stored run"
        if reason := difference(record.metrics, single.metrics):
            return reason
    return ""


@contextlib.contextmanager
def _frozen_objects() -> Iterator[None]:
    """Exclude the objects that exist now from garbage collections until the end, those of the caller as well.

    A full collection of them stops every thread for 0.1 s.
    """
    gc.collect(1)  # young garbage is not to grow old
    try:
        gc.freeze()
        yield
    finally:
        gc.unfreeze()


@contextlib.contextmanager
def open_session(folder: str | Path, execution: Execution, total: int) -> Iterator[Session]:
    """Yield a session that has the folder to itself.

    Args:
        folder: folder of the sweep.
        execution: workers, and whether there is a progress bar.
        total: number of runs that the progress bar counts to.

    Raises:
        StoreLockedError: another process works on the folder.
        FieldError: the number of workers is negative.
        SweepInterruptedError: Ctrl-C.
    """
    session = Session(SweepStore(folder), execution)  # a refusal leaves no folder
    with session.store.locked(), ProgressBar("runs", total=total, quiet=execution.quiet, keep=True) as bar:
        try:
            session.bar = bar
            with session.stack, _frozen_objects():
                yield session
        except BaseException as error:
            if not is_ctrl_c(error):
                raise
            raise SweepInterruptedError(str(folder), bar.finished, total) from None
