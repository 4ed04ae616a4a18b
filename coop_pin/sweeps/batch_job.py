"""Jobs of a sweep that are simulated together; what cannot be is left to single runs."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import logging
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch import BatchSimulator
from coop_pin.batch.hidden_state import digest
from coop_pin.batch.preparation import Prepared
from coop_pin.description.code_family import Cover
from coop_pin.errors import CoopPinError, TracingError
from coop_pin.sweeps.job import CtrlC, Job, Outcome, Record, outcome_of, run_job, separate, times
from coop_pin.sweeps.run_key import require_unchanged

_simulator = BatchSimulator()
"""With plants, code and memory of the last families, for all batches of a process."""
IN_PYTHON = threading.Lock()
"""Held by the thread that works on a batch, but while compiled code runs."""
_untraceable = list[Hashable]()
"""Families that were refused: their later batches are not traced again."""
_LOG = logging.getLogger("coop_pin.sweeps")
Result = TypeVar("Result")


def run_jobs(jobs: Sequence[Job]) -> list[Outcome | None]:
    """Return the outcomes of jobs of one engine; None for those of a batch that must be run singly."""
    return run_batch(jobs) if jobs[0].engine == "batch" else [run_job(job) for job in jobs]


def run_batch(jobs: Sequence[Job], is_over: Callable[[], bool] = bool) -> list[Outcome | None]:
    """Return the outcomes of jobs in their order; None for those that must be run singly.

    What a run gives does not depend on those that it is simulated with.

    Args:
        jobs: jobs of the batch engine.
        is_over: whether nobody waits for the outcomes any longer, as after Ctrl-C; asked between parts of the
            compiled code.

    Raises:
        CodeChangedError: this process has loaded other code than a job's key covers.
        KeyboardInterrupt: Ctrl-C, or ``is_over``.
    """
    with IN_PYTHON:
        start, outcomes = times(), dict[int, Outcome | None]()
        for code in {job.code for job in jobs}:
            require_unchanged(code)
        families = list[dict[int, Prepared]]()
        for index, run in enumerate(_prepared(jobs)):
            if run is None or run.kind in _untraceable:
                continue
            same = (each for each in families if next(iter(each.values())).kind == run.kind)
            if (family := next(same, None)) is None:
                families.append(family := {})
            family[index] = run
        preparation = (times() - start) / len(jobs)
        for family in families:
            outcomes |= (
                _attempted(jobs[next(iter(family))], _of_family, jobs, family, preparation, is_over) or {}
            )
        return [outcomes.get(index) for index in range(len(jobs))]


def _prepared(jobs: Sequence[Job]) -> Iterator[Prepared | None]:
    """Yield jobs prepared for a batch, those of a pattern together; None for one that cannot be."""
    cover = Cover.of_all(job.scenario for job in jobs)
    for _, group in itertools.groupby(jobs, lambda job: id(job.pattern)):
        alike = list(group)
        scenarios, pattern = [separate(job.scenario) for job in alike], alike[0].pattern
        numbers = np.array([job.numbers for job in alike], dtype=np.float64)
        runs = None if pattern is None else _simulator.prepare_alike(scenarios, pattern, numbers, cover)
        if runs is not None:
            yield from runs
            continue
        for job, scenario in zip(alike, scenarios, strict=True):
            yield _attempted(job, _simulator.prepare, scenario, cover)


def _of_family(
    jobs: Sequence[Job], family: Mapping[int, Prepared], preparation: Array, is_over: Callable[[], bool]
) -> dict[int, Outcome | None]:
    """Return the outcomes of runs of one code, by the index of their jobs; see _together.

    Args:
        jobs: jobs of all runs.
        family: runs, prepared, by the index of their jobs.
        preparation: Times of the preparation of one run, as of _together.
        is_over: see run_batch.

    Raises:
        TracingError: the runs cannot be traced.
    """
    start, outcomes = times(), dict[int, Outcome | None]()
    batches = dict[Hashable, dict[int, Prepared]]()
    for index, run in family.items():
        batches.setdefault(run.times, {})[index] = run
    try:
        _simulator.family([Prepared.joined([*runs.values()]) for runs in batches.values()])
    except TracingError:
        _untraceable.append(next(iter(family.values())).kind)
        raise
    shared = preparation + (times() - start) / len(family)
    for runs in batches.values():
        together = _together([jobs[index] for index in runs], [*runs.values()], shared, is_over)
        outcomes |= zip(runs, together, strict=True)
    return outcomes


def _attempted(job: Job, function: Callable[..., Result], *arguments: Any) -> Result | None:
    """Return a function's value, or None: what fails is left to single runs.

    It is told why; a run that cannot start records its own error. Only a user's code prints, and no
    thread runs it: sys.stdout is one for all threads.
    """
    try:
        with contextlib.redirect_stdout(sys.stderr) if job.code else contextlib.nullcontext():
            return function(*arguments)
    except CtrlC:
        raise
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # the last two of a user's controller
        if isinstance(error, TracingError) or not isinstance(error, CoopPinError):
            _tell(job, error)
        return None


def _tell(job: Job, error: BaseException) -> None:
    """Warn that runs like a job are simulated one by one, and why."""
    reason = str(error) if isinstance(error, CoopPinError) else f"{type(error).__name__}: {error}"
    _warn_once(f"runs of {job.scenario.name!r} are simulated one by one: {reason}")


@functools.lru_cache(maxsize=64)
def _warn_once(message: str) -> None:
    _LOG.warning("%s", message)


@contextlib.contextmanager
def _compiled(is_over: Callable[[], bool]) -> Iterator[Callable[[], None]]:
    """Let other threads work on their batches, while compiled code runs; give what ends it early."""

    def end() -> None:
        if is_over():
            raise CtrlC

    IN_PYTHON.release()
    try:
        yield end
    finally:
        IN_PYTHON.acquire()


def _together(
    jobs: Sequence[Job], runs: Sequence[Prepared], preparation: Array, is_over: Callable[[], bool]
) -> list[Outcome | None]:
    """Return the outcomes of runs of a family; None for one that breaks a guard: a single run has its error.

    When a batch cannot start, for example for lack of memory, its halves can; why a run alone cannot is told.

    Args:
        jobs: jobs of the runs.
        runs: runs with the same times, prepared, whose code is compiled.
        preparation: wall and processor time that the preparation of one run took, s, shape (2,).
        is_over: see run_batch.

    Raises:
        TracingError: the runs cannot be traced.
    """
    start = times()
    try:
        batch = _simulator.run_prepared(runs, _compiled(is_over))
        metrics = batch.metrics()
    except TracingError:
        raise
    except Exception as error:
        half = len(jobs) // 2
        if not half:
            _tell(jobs[0], error)
            return [None]
        parts = slice(half), slice(half, None)
        return [each for part in parts for each in _together(jobs[part], runs[part], preparation, is_over)]
    family = digest((*runs[0].kind, jobs[0].code)) if runs[0].is_foreign else ""
    spent, outcomes = preparation + (times() - start) / len(jobs), list[Outcome | None]()
    for index, job in enumerate(jobs):
        if not batch.is_valid[index]:
            outcomes.append(None)
            continue
        told: dict[str, Any] = {"engine": "batch", "family": family}
        told |= zip(("wall_s", "cpu_s"), spent.tolist(), strict=True)
        if job.metrics or job.keep:
            outcome = outcome_of(job, functools.partial(batch.result, index))
            told |= {name: told[name] + getattr(outcome.record, name) for name in ("wall_s", "cpu_s")}
            outcomes.append(outcome._replace(record=dataclasses.replace(outcome.record, **told)))
        else:
            outcomes.append(Outcome(Record(job.key, dict(job.changes), metrics[index], **told)))
    batch.release()
    return outcomes
