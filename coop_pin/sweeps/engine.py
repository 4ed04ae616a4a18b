"""Sweep engine: computes the missing runs of a plan and stores them."""

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

from coop_pin.base.arrays import require_path, require_type
from coop_pin.base.errors import (
    FieldError,
    FileReadError,
    ScenarioError,
    SweepInterruptedError,
    is_ctrl_c,
    needs_extra,
)
from coop_pin.compiled.engine_choice import choose_engines
from coop_pin.description.scenario import Scenario
from coop_pin.stability.step_size import STEPS_FIELD
from coop_pin.sweeps.feasibility import require_feasible
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.plant_steps import with_steps
from coop_pin.sweeps.progress_bar import ProgressBar
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import KeyedPoint, keyed_points
from coop_pin.sweeps.store import TRANSIENT, SweepStore
from coop_pin.sweeps.table import Columns, require_own_names
from coop_pin.sweeps.workers.backend import LocalBackend, outcomes, outcomes_here
from coop_pin.sweeps.workers.execution import HERE, Execution
from coop_pin.sweeps.workers.job import Job, Outcome, Record

_LOG = logging.getLogger("coop_pin.sweeps")


def with_engine(plan: SweepPlan, store: SweepStore, runs: int | None = None) -> SweepPlan:
    """Return a plan with its engine decided: as the folder has it, otherwise by its first run.

    Args:
        plan: plan.
        store: folder of the plan.
        runs: number of runs of its kind in all; the plan's own when omitted.

    Raises:
        FieldError: the plan wants batches, and its first run cannot be in one.
    """
    if plan.engine in ("pinocchio", "traced"):
        return plan
    if plan.engine == "auto":
        with contextlib.suppress(FileReadError):
            return plan.model_copy(update={"engine": store.read_plan().engine})
    # A user's code runs in workers only; if it cannot be traced, they tell why.
    count = len(plan) if runs is None else runs
    (choice,) = choose_engines([plan.resolved(plan[0])], plan.engine, [count], traces_user_code=False)
    if choice.obstacle is not None and plan.engine == "batch":
        message = f"is 'batch', but the first run cannot be simulated in one: {choice.reason}"
        raise FieldError(message, "engine")
    if choice.obstacle not in (None, "few runs"):
        _LOG.warning("runs are simulated one by one: %s", choice.reason)
    return plan.model_copy(update={"engine": choice.engine})


class Session:
    """A locked folder and an execution backend, for one plan after the other.

    Attributes:
        store: the folder.
        bar: the progress bar.
        keys: keys of the points of the last plan.
        columns: columns of the runs computed for it.
    """

    keys: list[str]
    columns: Columns
    bar: ProgressBar

    def __init__(self, store: SweepStore, execution: Execution) -> None:
        self.store, self._execution, self._processes = store, execution, execution.processes
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
        under_way, refused = set[str](), list[Outcome]()
        jobs = self._jobs(plan, retry_failed, under_way, refused)
        for first in jobs:  # a finished sweep does not wait for workers
            with contextlib.closing(self._outcomes(itertools.chain([first], jobs))) as batches:
                for batch in batches:
                    self._store(plan, batch)
                    under_way.difference_update(outcome.record.key for outcome in batch)
                    self.bar.count(len(batch), failed=sum(bool(record.failure) for record, *_ in batch))
        # Equal points may come while their run is under way: they count when all are done.
        self.bar.count(len(self._repeated), failed=sum(bool(self.store.known[key]) for key in self._repeated))
        self._store(plan, refused)
        if self._is_foreign and plan.engine == "batch":
            self._check_batches(plan)

    def _store(self, plan: SweepPlan, outcomes: Sequence[Outcome]) -> None:
        """Store outcomes of the plan's runs; a name that another column has is refused before."""
        records = [outcome.record for outcome in outcomes]
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
        from coop_pin.compiled.single_runs import checked, told  # slow to load

        numbers = {key: number for number, key in reversed([*enumerate(self.keys)])}
        families = dict[str, list[int]]()
        for key, family in self.store.families().items():
            if key in numbers and family not in self.store.known:
                families.setdefault(family, []).append(numbers[key])
        for family, members in families.items():
            members.sort()
            singles = self._singly(plan, checked(members))
            records = [outcome.record for outcome in singles]
            if reason := _difference(self.store.read_records([each.key for each in records]), records):
                scenario = plan.scenario(members[0])
                _LOG.warning("runs of %r are repeated one by one: %s", scenario.name, told(scenario, reason))
                self._store(plan, self._singly(plan, members))
            elif not {outcome.record.failure for outcome in singles} & {*TRANSIENT}:
                self.store.append([Outcome(Record(family))])

    def _singly(self, plan: SweepPlan, numbers: Sequence[int]) -> list[Outcome]:
        """Return the outcomes of single runs of a plan's points."""
        jobs = (self._job(plan, keyed)._replace(engine="pinocchio") for keyed in keyed_points(plan, numbers))
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
                    refused.append(Outcome(Record.of_failure(key, point.changes, scenario)))
                self.bar.count(failed=1, old=True)
            elif kind is not None and not again and (kind or not keep or self.store.read_result(key)):
                self.bar.count(failed=bool(kind), old=True)
            else:
                under_way.add(key)
                if keep:
                    self._kept.add(key)
                yield self._job(plan, keyed)

    @staticmethod
    def _job(plan: SweepPlan, keyed: KeyedPoint) -> Job:
        """Return the job of a point whose scenario has no mistakes."""
        point, limits = keyed.point, (plan.time_limit_s, int(plan.memory_limit_gb * 1e9))
        options = (point.changes, plan.metrics, *limits, plan.keeps(point.number), keyed.code, plan.engine)
        return Job(keyed.key, cast(Scenario, keyed.example), *options, keyed.pattern, keyed.numbers)

    def _require_files(self, code: Sequence[tuple[str, Sequence[str]]]) -> None:
        """Refuse code of a script or notebook that workers cannot import, or whose edits go undetected."""
        for name, digests in code:
            is_here = not (self._processes or self._execution.scheduler)
            if name.startswith("__main__:") and not (is_here and digests):
                reason = "has no file in which edits could be seen" if is_here else "workers cannot import"
                detail = f"names {name!r}, which {reason}; put it into a module (a file of its own)"
                raise FieldError(detail, "the plan")


def _difference(stored: Mapping[str, Record], singles: Sequence[Record]) -> str:
    """Return how stored runs differ from single ones; nothing of those that cannot be told."""
    from coop_pin.compiled.single_runs import difference  # slow to load

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
        FileReadError: an older version wrote the folder.
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


Base = str | Path | Scenario | Sequence[str | Path | Scenario] | Mapping[str, str | Path | Scenario]


def sweep(
    base: SweepPlan | Base,
    axes: Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    execution: Execution = HERE,
    retry_failed: bool = False,
    **plan: Any,
) -> SweepResult:
    """Return the results of many runs of a scenario; finished runs are stored in a folder and never repeated.

    ``sweep("adept-paper", {"controller.gains.sign_gain": [0.0, 0.1, 0.2]}, out="out/sign-gain")``. Runs are
    found by a key of what determines them: the same call resumes an interrupted sweep, a changed one computes
    what is new.

    Args:
        base: SweepPlan, or the plan's ``base``: a scenario, its name or path, or several.
        axes: values of each varied field.
        out: folder of the sweep.
        execution: workers, engine, folders to merge: ``Execution(workers=0)`` computes in this process.
        retry_failed: whether runs that failed for lack of time, of memory or of a worker are repeated.
        plan: further fields of the SweepPlan: changes, cases, zipped, sample, metrics, time_limit_s,
            memory_limit_gb, keep, engine, repeats.

    Raises:
        ScenarioError: the plan has mistakes, or the scenario of every run has.
        InfeasibleMotionError: the path of every run is out of reach.
        FieldError: no run's law fits its cell, the plan names code that has no file or that workers cannot
            import, or the scheduler's address is malformed.
        MissingExtraError: dask is not installed.
        CodeChangedError: the user's code was edited after it was loaded.
        StoreLockedError: another process works on the folder.
        FileReadError: an older version wrote the folder, or one of ``merge`` is not that of a sweep.
        FileWriteError: the disk is full; every run written before is kept.
        WorkersLostError: the scheduler is gone; every finished run is kept.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
    """
    require_path("out", out)
    require_type("retry_failed", retry_failed, bool)
    require_type("execution", execution, Execution)
    for field in {"workers", "scheduler", "merge", "recompute", "quiet"} & {*plan}:
        raise FieldError(f"is a field of execution; write execution=coop_pin.Execution({field}=...)", field)
    fields = plan if axes is None else {**plan, "axes": axes}
    if execution.engine is not None:
        fields = {**fields, "engine": execution.engine}
    chosen = base.replace(**fields) if isinstance(base, SweepPlan) else SweepPlan(base=base, **fields)
    require_feasible(map(chosen.resolved, chosen.points()))
    return sweep_plan(chosen, out, execution, retry_failed=retry_failed)


def sweep_plan(
    plan: SweepPlan, out: str | Path, execution: Execution, *, retry_failed: bool = False
) -> SweepResult:
    """Return the results of a plan, as ``sweep`` does, also if every run must fail."""
    with open_session(out, execution, len(plan)) as session:
        plan = with_steps(with_engine(plan, session.store), session.store)
        session.store.write_plan(plan)
        session.compute(plan, retry_failed=retry_failed)
        result = session.result(plan)
        result.write_tables()
    return result
