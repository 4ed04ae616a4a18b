"""Jobs of a sweep that are simulated together; what cannot be is simulated singly."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import logging
import sys
import time
from collections import defaultdict
from collections.abc import Hashable, Sequence

from coop_pin.batch import BatchSimulator, RecordMemory, families
from coop_pin.errors import TracingError
from coop_pin.sweeps.job import CtrlC, Job, Outcome, Record, outcome_of, run_job, separate
from coop_pin.sweeps.run_key import require_unchanged

_simulators: dict[Hashable, BatchSimulator | None] = {}
"""With their code, by the family of the scenarios, for all batches of a process; None for single runs."""
_memory = RecordMemory()
"""Memory of their records: a batch gives it back as soon as its outcomes are made."""
_KEPT = 8
"""Families whose code is kept, those used last; the tapes of one may take 60 MB."""
_LOG = logging.getLogger("coop_pin.sweeps")


def run_jobs(jobs: Sequence[Job]) -> list[Outcome | None]:
    """Return the outcomes of jobs of one engine; None for those of a batch that must be run singly."""
    return run_batch(jobs) if jobs[0].engine == "batch" else [run_job(job) for job in jobs]


def run_batch(jobs: Sequence[Job]) -> list[Outcome | None]:
    """Return the outcomes of jobs in their order; None for those that must be run singly.

    What a run gives does not depend on those that it is simulated with.

    Raises:
        CodeChangedError: this process has loaded other code than a job's key covers.
        KeyboardInterrupt: Ctrl-C.
    """
    groups, found = defaultdict[Hashable, list[int]](list), dict[int, Outcome | None]()
    jobs = [job._replace(scenario=separate(job.scenario)) for job in jobs]
    for place, kind in enumerate(families([job.scenario for job in jobs])):
        require_unchanged(jobs[place].code)
        groups[kind].append(place)
    for kind, places in groups.items():
        found |= zip(places, _family(kind, [jobs[place] for place in places]), strict=True)
    return [found[place] for place in range(len(jobs))]


def _family(kind: Hashable, jobs: Sequence[Job]) -> list[Outcome | None]:
    """Return the outcomes of runs of a family; why it cannot be traced is told once."""
    simulator = _simulators[kind] = (
        _simulators.pop(kind) if kind in _simulators else BatchSimulator(memory=_memory)
    )
    if len(_simulators) > _KEPT:
        del _simulators[next(iter(_simulators))]
    try:
        if simulator is not None:
            return _together(simulator, jobs)
    except CtrlC:
        raise
    except (TracingError, SystemExit, KeyboardInterrupt) as error:  # the last two of a user's controller
        _simulators[kind] = None
        _LOG.warning("runs of %r are simulated one by one: %s", jobs[0].scenario.name, error)
    return [None] * len(jobs)


def _together(simulator: BatchSimulator, jobs: Sequence[Job]) -> list[Outcome | None]:
    """Return the outcomes of runs of a family.

    A run that breaks a guard is repeated singly, for its error; when a batch cannot start, its halves can.

    Raises:
        TracingError: the runs cannot be traced, or not together.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with contextlib.redirect_stdout(sys.stderr):
            batch = simulator.run([job.scenario for job in jobs])
            metrics = batch.metrics()
    except TracingError:
        raise
    except Exception:  # of a run that cannot start, or of the user's motion
        half = len(jobs) // 2
        return _together(simulator, jobs[:half]) + _together(simulator, jobs[half:]) if half else [None]
    wall, cpu = (time.perf_counter() - wall) / len(jobs), (time.process_time() - cpu) / len(jobs)
    found = list[Outcome | None]()
    for place, job in enumerate(jobs):
        if not batch.is_valid[place]:
            found.append(None)
            continue
        outcome = Outcome(Record(job.key, dict(job.changes), metrics[place]))
        if job.metrics or job.keep:
            outcome = outcome_of(job, functools.partial(batch.result, place))
        wall_s, cpu_s = outcome.record.wall_s + wall, outcome.record.cpu_s + cpu
        record = dataclasses.replace(outcome.record, engine="batch", wall_s=wall_s, cpu_s=cpu_s)
        found.append(outcome._replace(record=record))
    batch.release()
    return found
