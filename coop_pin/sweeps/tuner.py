"""One call from ranges of gains to the best of them; every try is a run of a sweep."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple, Self

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, NameNotFoundError, NothingFeasibleError
from coop_pin.sweeps.backend import Where
from coop_pin.sweeps.engine import Session, open_session
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import PointResult, SweepResult
from coop_pin.sweeps.search import Budget, Ranges, Search, search_by_evolution, search_by_optuna

_FORM = re.compile(r"\s*(?P<metric>[^\s<>=]+)\s*(?P<sign>[<>])=?\s*(?P<bound>[^\s<>=]+)\s*")


class Bound(NamedTuple):
    """A bound on a metric; the bound itself is allowed, since no run meets a number exactly.

    Attributes:
        metric: name.
        sign: 1 where the metric must stay below, -1 where it must stay above.
        bound: the number.
    """

    metric: str
    sign: int
    bound: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read "settling_time_s<2.5" or "internal_axial_mean_N > -11".

        Raises:
            FieldError: the text does not say that.
        """
        mistake = FieldError(
            f"is {text!r}; it must read METRIC<NUMBER or METRIC>NUMBER, with a finite number", "subject_to"
        )
        form = _FORM.fullmatch(text)
        if form is None:
            raise mistake
        try:
            bound = float(form["bound"])
        except ValueError:
            raise mistake from None
        if not np.isfinite(bound):
            raise mistake
        return cls(form["metric"], 1 if form["sign"] == "<" else -1, bound)

    def excess(self, value: float) -> float:
        """Return by how much a value is outside, as a share of the bound where that is above 1; inf where it is not a number."""
        beyond = self.sign * (value - self.bound) / max(1.0, abs(self.bound))
        return max(beyond, 0.0) if np.isfinite(value) else np.inf


_OUTSIDE = 1e12
"""What a run outside its bounds costs; how far outside it is counts on top."""
_FAILED = 1e100
"""What a failed run costs; a number, because scipy evaluates a population of infinities twice."""


class Objective(NamedTuple):
    """What is wanted of a run.

    Attributes:
        minimize: name of the metric that should be small.
        bounds: what other metrics must keep.
    """

    minimize: str
    bounds: tuple[Bound, ...]

    def costs(self, result: SweepResult) -> Array:
        """Return a number for each run, by which searches compare them: shape (n,).

        It is the metric of a run within all bounds, more than any metric outside them, and the most for a run
        that failed.

        Raises:
            NameNotFoundError: runs have no such metric.
        """
        known, count = result.metric_names, len(result.plan)
        if not known:
            return np.full(count, _FAILED)
        wanted = {self.minimize, *(bound.metric for bound in self.bounds)}
        for name in sorted(wanted - set(known)):
            raise NameNotFoundError("metric", name, known, "the runs")
        values = {name: result.values(name).values.ravel() for name in wanted}
        excess = np.zeros(count)
        for bound in self.bounds:
            excess += [bound.excess(value) for value in values[bound.metric]]
        metric = values[self.minimize]
        costs = np.where(excess > 0.0, _OUTSIDE * (1.0 + excess), metric)
        return np.where(np.isfinite(metric + excess), costs, _FAILED)

    @staticmethod
    def met(cost: float) -> bool:
        """Say whether a cost is that of a run within all bounds."""
        return cost < _OUTSIDE


class Evaluator:
    """Points that were tried; a generation of them is one pass of the session."""

    def __init__(self, session: Session, base: Scenario, fields: Sequence[str], goal: Objective) -> None:
        self._session, self._base, self._fields, self._goal = session, base, tuple(fields), goal
        self._points: list[tuple[float, ...]] = []
        self._lowest = np.inf

    def costs(self, generation: Array) -> Array:
        """Run a generation of points, shape (s, fields), and return their costs, shape (s,).

        Raises:
            NameNotFoundError: runs have no such metric.
            CoopPinError: whatever ``Session.compute`` raises.
        """
        points = [tuple(map(float, point)) for point in generation]
        self._points += points
        store, plan = self._session.store, self._plan(points)
        store.write_plan(self._plan(self._points))
        self._session.compute(plan)
        costs = self._goal.costs(SweepResult(plan, store))
        self._lowest = min(self._lowest, float(costs.min()))
        self._session.bar.say(
            f"best {self._lowest:.4g}" if self._goal.met(self._lowest) else "nothing within the bounds yet"
        )
        return costs

    def history(self) -> SweepResult:
        """Return all tries as one sweep."""
        return SweepResult(self._plan(self._points), self._session.store)

    def _plan(self, points: Sequence[tuple[float, ...]]) -> SweepPlan:
        values = dict(zip(self._fields, zip(*points, strict=True), strict=True))
        return SweepPlan(base=self._base, zipped=(values,))


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

    The search is a function of its arguments: the same call finds its finished runs in the folder and goes on
    where it was stopped, and one with more generations begins with those that are there. Runs that fail are
    the worst; of two runs outside the bounds the one that is less outside is better. The workers serve the
    whole search, and nobody else may use the folder meanwhile.

    Args:
        scenario: the scenario, its name or path.
        vary: lowest and highest value of each field.
        minimize: name of the metric.
        subject_to: one bound on a metric, "settling_time_s<2.5", or several.
        out: the folder that keeps the runs.
        method: "evolution" (differential evolution, scipy's) or "optuna" (its tree-structured Parzen
            estimator; extra "tune").
        generations: after the first one.
        population: runs in a generation for each field; at least 5 runs in all.
        seed: of the search, not of the runs.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bar.

    Raises:
        FieldError: there is no such field or method, a range is empty, a bound cannot be read, or the
            scheduler's address is none.
        NameNotFoundError: runs have no such metric.
        MissingExtraError: the method's package is not installed.
        NothingFeasibleError: no run is within all bounds; the folder keeps what was tried.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
        CoopPinError: whatever else ``sweep`` raises.
    """
    base = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    bounds = [subject_to] if isinstance(subject_to, str) else list(subject_to)
    goal = Objective(minimize, tuple(map(Bound.parse, bounds)))
    _check(base, vary, method, generations, population)
    effort = Budget.of(generations, population, len(vary), seed)
    with open_session(out, Where.of(workers, scheduler), effort.runs, quiet=quiet) as session:
        tries = Evaluator(session, base, list(vary), goal)
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
        raise FieldError(
            f"are {generations} and {population}; they must be at least 0 and 1", "generations and population"
        )
    for field, ends in vary.items():
        try:
            low, high = map(float, ends)
        except (TypeError, ValueError):
            raise FieldError(
                f"has the range {ends!r}; it must be a lowest and a highest number", field
            ) from None
        if not (np.isfinite([low, high]).all() and low < high):
            raise FieldError(
                f"goes from {low:g} to {high:g}; the range must have a lower and a higher end", field
            )
    SweepPlan(base=base, zipped=(dict(vary),))  # refuses fields that are not there
