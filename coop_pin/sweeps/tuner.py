"""One call from ranges of gains to the best of them; every try is a run of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, NothingFeasibleError
from coop_pin.sweeps.engine import open_session
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import PointResult, SweepResult
from coop_pin.sweeps.search import search_by_optuna
from coop_pin.sweeps.tuning.bound import Bound
from coop_pin.sweeps.tuning.effort import Effort, Ranges, Search
from coop_pin.sweeps.tuning.evolution import search_by_evolution
from coop_pin.sweeps.tuning.goal import Goal
from coop_pin.sweeps.tuning.tries import Tries
from coop_pin.sweeps.where import Where

Method = Literal["evolution", "optuna"]
_SEARCHES: dict[str, Search] = {"evolution": search_by_evolution, "optuna": search_by_optuna}


class TuneResult(NamedTuple):
    """What tuning found.

    Attributes:
        best: the run with the smallest metric among those within all bounds.
        history: every run that was tried, in order, as a sweep.
    """

    best: PointResult
    history: SweepResult


def tune(
    scenario: str | Path | Scenario,
    vary: Ranges,
    *,
    minimize: str,
    subject_to: str | Sequence[str] = (),
    out: str | Path,
    method: Method = "evolution",
    generations: int = 10,
    population: int = 8,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    quiet: bool = False,
) -> TuneResult:
    """Search fields of a scenario for the smallest value of a metric.

    The search is a function of its arguments: the same call finds its finished runs in the folder and goes on where it was stopped,
    and one with more generations begins with those that are there. Runs that fail are the worst; of two runs outside the bounds the
    one that is less outside is better. The workers serve the whole search, and nobody else may use the folder meanwhile.

    Args:
        scenario: the scenario, its name or path.
        vary: lowest and highest value of each field.
        minimize: name of the metric.
        subject_to: one bound on a metric, "settling_time_s<2.5", or several.
        out: the folder that keeps the runs.
        method: "evolution" (differential evolution, scipy's) or "optuna" (its tree-structured Parzen estimator; extra "tune").
        generations: after the first one.
        population: runs in a generation for each field; at least 5 runs in all.
        seed: of the search, not of the runs.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bar.

    Raises:
        FieldError: there is no such field or method, a range is empty, a bound cannot be read, or the scheduler's address is none.
        EntryNotFoundError: runs have no such metric.
        MissingExtraError: the method's package is not installed.
        NothingFeasibleError: no run is within all bounds; the folder keeps what was tried.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
        CoopPinError: whatever else ``sweep`` raises.
    """
    base = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    bounds = [subject_to] if isinstance(subject_to, str) else list(subject_to)
    goal = Goal(minimize, tuple(map(Bound.parse, bounds)))
    _check(base, vary, method, generations, population)
    effort = Effort.of(generations, population, len(vary), seed)
    with open_session(out, Where.of(workers, scheduler), effort.runs, quiet=quiet) as session:
        tries = Tries(session, base, list(vary), goal)
        _SEARCHES[method](tries.costs, vary, effort)
        history = tries.history()
        history.write_tables()
    costs = goal.costs(history)
    best = int(np.argmin(costs))
    if not goal.met(costs[best]):
        failures = history.failures
        complaint = f"{failures[0].kind}: {failures[0].message}" if failures else ""
        raise NothingFeasibleError(len(costs), len(failures), bounds, str(out), complaint)
    return TuneResult(history.point(best), history)


def _check(base: Scenario, vary: Ranges, method: str, generations: int, population: int) -> None:
    """Refuse what cannot be searched before anything is run or written."""
    if method not in _SEARCHES:
        raise FieldError(f"is {method!r}; it must be one of {', '.join(_SEARCHES)}", "method")
    if not vary:
        raise FieldError("names no field; say at least one, with its lowest and highest value", "vary")
    if generations < 0 or population < 1:
        raise FieldError(f"are {generations} and {population}; they must be at least 0 and 1", "generations and population")
    for field, ends in vary.items():
        try:
            low, high = map(float, ends)
        except (TypeError, ValueError):
            raise FieldError(f"has the range {ends!r}; it must be a lowest and a highest number", field) from None
        if not (np.isfinite([low, high]).all() and low < high):
            raise FieldError(f"goes from {low:g} to {high:g}; the range must have a lower and a higher end", field)
    SweepPlan(base=base, zipped=(dict(vary),))  # refuses fields that are not there
