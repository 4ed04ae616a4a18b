"""Jobs of a sweep that are simulated together; what cannot be is simulated singly."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import logging
import sys
import time
from collections import defaultdict
from collections.abc import Hashable, Sequence

from coop_pin.batch import BatchSimulator, family
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.sweeps.job import CtrlC, Job, Outcome, outcome_of, run_job
from coop_pin.sweeps.run_key import require_unchanged

_simulators: dict[Hashable, BatchSimulator | None] = {}
"""With their code, by the family of the scenarios, for all batches of a process; None for single runs."""
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
    families, found = defaultdict[Hashable, list[int]](list), dict[int, Outcome | None]()
    scenarios = _scenarios([job.scenario for job in jobs])
    for place, (job, scenario) in enumerate(zip(jobs, scenarios, strict=True)):
        require_unchanged(job.code)
        families[family(scenario)].append(place)
    for kind, places in families.items():
        alike = [(jobs[place], scenarios[place]) for place in places]
        found |= zip(places, _family(kind, alike), strict=True)
    return [found[place] for place in range(len(jobs))]


def _scenarios(texts: Sequence[str]) -> list[Scenario]:
    """Return the scenarios of JSON; those fields that are the first one's are not validated again."""
    first, fields = Scenario.model_validate_json(texts[0]), json.loads(texts[0])
    known = {name: getattr(first, name) for name in fields}
    return [
        Scenario(**{name: known[name] if value == fields[name] else value for name, value in own.items()})
        for own in map(json.loads, texts)
    ]


def _family(kind: Hashable, runs: Sequence[tuple[Job, Scenario]]) -> list[Outcome | None]:
    """Return the outcomes of runs of a family; why it cannot be traced is told once."""
    simulator = _simulators.setdefault(kind, BatchSimulator())
    try:
        if simulator is not None:
            return _together(simulator, runs)
    except CtrlC:
        raise
    except (TracingError, SystemExit, KeyboardInterrupt) as error:  # the last two of a user's controller
        _simulators[kind] = None
        _LOG.warning("runs of %r are simulated one by one: %s", runs[0][1].name, error)
    return [None] * len(runs)


def _together(simulator: BatchSimulator, runs: Sequence[tuple[Job, Scenario]]) -> list[Outcome | None]:
    """Return the outcomes of runs of a family.

    A run that breaks a guard is repeated singly, for its error; when a batch cannot start, its halves can.

    Raises:
        TracingError: the runs cannot be traced, or not together.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with contextlib.redirect_stdout(sys.stderr):
            batch = simulator.run([scenario for _, scenario in runs])
    except TracingError:
        raise
    except Exception:  # of a run that cannot start, or of the user's motion
        half = len(runs) // 2
        return _together(simulator, runs[:half]) + _together(simulator, runs[half:]) if half else [None]
    wall, cpu = (time.perf_counter() - wall) / len(runs), (time.process_time() - cpu) / len(runs)
    found = list[Outcome | None]()
    for place, (job, _) in enumerate(runs):
        if not batch.is_valid[place]:
            found.append(None)
            continue
        record, content = outcome_of(job, functools.partial(batch.result, place))
        wall_s, cpu_s = record.wall_s + wall, record.cpu_s + cpu
        record = dataclasses.replace(record, engine="batch", wall_s=wall_s, cpu_s=cpu_s)
        found.append(Outcome(record, content))
    return found
