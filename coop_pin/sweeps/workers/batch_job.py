"""Jobs of a sweep that are simulated together; what cannot be is left to single runs."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import logging
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

from coop_pin.base.arrays import Array
from coop_pin.base.errors import CoopPinError, TracingError
from coop_pin.base.schema.parts import Filled
from coop_pin.base.schema.user_code import accept_code
from coop_pin.compiled.engines import Way
from coop_pin.compiled.kind import Cover, Kind
from coop_pin.compiled.preparation import Prepared
from coop_pin.compiled.simulate import BatchSimulator
from coop_pin.control.hidden_state import digest
from coop_pin.sweeps.run_key import require_unchanged
from coop_pin.sweeps.workers.job import (
    CtrlC,
    Job,
    JobRecord,
    Outcome,
    deadline,
    has_options,
    outcome_of,
    run_job,
    separate,
    times,
)

_simulator = BatchSimulator()
"""With plants, code and memory of the last families, for all batches of a process."""
IN_PYTHON = threading.Lock()
"""Held by the thread that draws or works on a batch, but while compiled code runs and metrics are found."""
_untraceable = list[Kind]()
"""Families that were refused: their later batches are not traced again."""
_LOG = logging.getLogger("coop_pin.sweeps")
_ALIKE = 4
"""Runs from which on the numbers of their laws are made together."""
Result = TypeVar("Result")


def run_jobs(jobs: Sequence[Job]) -> list[Outcome | Way]:
    """Return the outcomes of jobs of one way; another way for those that must be run singly."""
    return run_batch(jobs) if jobs[0].way == "lanes" else [run_job(job) for job in jobs]


def run_batch(jobs: Sequence[Job], is_over: Callable[[], bool] = bool) -> list[Outcome | Way]:
    """Return the outcomes of jobs in their order; for those that must be run singly the way in which.

    That is "plant" for those that cannot be lanes, and "pinocchio" for those that break off.

    What a run gives does not depend on those that it is simulated with.

    Args:
        jobs: jobs whose way is "lanes".
        is_over: whether nobody waits for the outcomes any longer, as after Ctrl-C; asked between parts of the
            compiled code.

    Raises:
        CodeChangedError: this process has loaded other code than a job's key covers.
        KeyboardInterrupt: Ctrl-C, or ``is_over``.
    """
    with IN_PYTHON:
        start, outcomes = times(), dict[int, Outcome | Way]()
        for code in {job.code for job in jobs}:
            require_unchanged(code)
            accept_code(name for name, _ in code)
        families = dict[Kind, list[_Block]]()
        for block in _prepared(jobs):
            families.setdefault(block.runs.kind.code, []).append(block)
        preparation = (times() - start) / len(jobs)
        for family in (families[kind] for kind in families if kind not in _untraceable):
            first = jobs[family[0].indices[0]]
            outcomes |= _attempted(first, _of_family, jobs, family, preparation, is_over) or {}
        for code in {job.code for job in jobs}:
            require_unchanged(code)  # as it was loaded now
        return [outcomes.get(index, "plant") for index in range(len(jobs))]


class _Block(NamedTuple):
    """Runs that are prepared together.

    Attributes:
        indices: indices of their jobs.
        runs: runs, prepared.
    """

    indices: Sequence[int]
    runs: Prepared


def _prepared(jobs: Sequence[Job]) -> Iterator[_Block]:
    """Yield what can be in a batch, prepared: jobs that differ in numbers of a law together."""
    groups = [[*group] for _, group in itertools.groupby(range(len(jobs)), lambda i: id(jobs[i].pattern))]
    laws = [_of_a_law([jobs[index] for index in group]) for group in groups]
    cover = Cover.of_all(
        job.scenario
        for law, group in zip(laws, groups, strict=True)
        for job in (jobs[index] for index in (group[:1] if law else group))
    )
    for law, group in zip(laws, groups, strict=True):
        if law and (runs := _simulator.prepare_alike(law, cover)) is not None:
            yield _Block(group, runs)
            continue
        for index in group:
            job = jobs[index]
            if (run := _attempted(job, _simulator.prepare, separate(job.scenario), cover)) is not None:
                yield _Block([index], run)


def _of_a_law(jobs: Sequence[Job]) -> Filled | None:
    """Return the scenarios of jobs of one pattern that differ in numbers of a law of the package only."""
    pattern, example = jobs[0].pattern, jobs[0].example
    if pattern is None or len(jobs) < _ALIKE or jobs[0].code or has_options(example):
        return None
    is_of_the_law = all(name.startswith("controller.") for name in pattern.names)
    return Filled(pattern, [job.numbers for job in jobs]) if is_of_the_law else None


def _of_family(
    jobs: Sequence[Job], family: Sequence[_Block], preparation: Array, is_over: Callable[[], bool]
) -> dict[int, Outcome | Way]:
    """Return the outcomes of runs of one code, by the index of their jobs; see _together.

    Args:
        jobs: jobs of all runs.
        family: runs of the code.
        preparation: Times of the preparation of one run, as of _together.
        is_over: see run_batch.

    Raises:
        TracingError: the runs cannot be traced.
    """
    start, outcomes = times(), dict[int, Outcome | Way]()
    alike = dict[Hashable, list[_Block]]()
    for block in family:
        alike.setdefault(block.runs.kind.times, []).append(block)
    batches = [
        (
            [index for block in blocks for index in block.indices],
            Prepared.joined([each.runs for each in blocks]),
        )
        for blocks in alike.values()
    ]
    try:
        _simulator.family([runs for _, runs in batches])
    except TracingError:
        _untraceable.append(family[0].runs.kind.code)
        raise
    shared = preparation + (times() - start) / sum(len(indices) for indices, _ in batches)
    for indices, runs in batches:
        together = _together([jobs[index] for index in indices], runs, shared, is_over)
        outcomes |= zip(indices, together, strict=True)
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
    _warn_once(f"runs of {job.example.name!r} are simulated one by one: {reason}")


@functools.lru_cache(maxsize=64)
def _warn_once(message: str) -> None:
    _LOG.warning("%s", message)


@contextlib.contextmanager
def _unlocked(is_over: Callable[[], bool], check: Callable[[int, int], None]) -> Iterator[Callable[[], None]]:
    """Let other threads prepare their batches, while compiled code and numpy run; give what ends it early."""

    def end() -> None:
        check(0, 0)
        if is_over():
            raise CtrlC

    IN_PYTHON.release()
    try:
        yield end
    finally:
        IN_PYTHON.acquire()


def _together(
    jobs: Sequence[Job], runs: Prepared, preparation: Array, is_over: Callable[[], bool]
) -> list[Outcome | Way]:
    """Return the outcomes of runs of a family; "pinocchio" for one that breaks a guard, and fails there.

    When a batch cannot start, for example for lack of memory, or takes longer than the limits of its runs in
    all, its halves may be able to; why a run alone is not is told.

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
        with contextlib.ExitStack() as stack:
            check = deadline(jobs[0].time_limit_s * len(jobs))
            batch = _simulator.run_prepared(
                [runs], lambda: stack.enter_context(_unlocked(is_over, check)), jobs[0].memory_limit
            )
            metrics = batch.metrics()
    except TracingError:
        raise
    except Exception as error:
        half = len(jobs) // 2
        if not half:
            _tell(jobs[0], error)
            return ["pinocchio"]
        parts = slice(half), slice(half, None)
        together = (_together(jobs[part], runs.part(part), preparation, is_over) for part in parts)
        return [*itertools.chain.from_iterable(together)]
    family = digest((*runs.kind.code, jobs[0].code)) if runs.is_foreign else ""
    spent, outcomes = preparation + (times() - start) / len(jobs), list[Outcome | Way]()
    shared: dict[str, Any] = {"engine": "compiled", "family": family}
    shared |= zip(("wall_s", "cpu_s"), spent.tolist(), strict=True)
    for index, (job, is_valid) in enumerate(zip(jobs, batch.is_valid.tolist(), strict=True)):
        if not is_valid:
            outcomes.append("pinocchio")
        elif job.metrics or job.keep:
            outcome = outcome_of(job, functools.partial(batch.result, index), metrics[index])
            more = {name: shared[name] + getattr(outcome.record, name) for name in ("wall_s", "cpu_s")}
            record = dataclasses.replace(outcome.record, **shared | more)
            outcomes.append(outcome._replace(record=record))
        else:
            record = JobRecord(job.key, dict(job.changes), metrics[index], **shared)
            outcomes.append(Outcome(record, line=record.to_line()))
    batch.release()
    return outcomes
