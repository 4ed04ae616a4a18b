"""Tuning: search of scenario fields for the smallest value of a metric under constraints."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple, Self

import numpy as np

from coop_pin.arrays import Array, as_count, require_path, require_type
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, NameNotFoundError, NothingFeasibleError
from coop_pin.sweeps.backend import BackendOptions
from coop_pin.sweeps.engine import Session, open_session
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import PointResult, SweepResult
from coop_pin.sweeps.search import Budget, Ranges, Search, search_by_evolution, search_by_optuna

_FORM = re.compile(r"\s*(?P<metric>[^\s<>=]+)\s*(?P<sign>[<>])=?\s*(?P<bound>[^\s<>=]+)\s*")


class Bound(NamedTuple):
    """Constraint on a metric; the bound itself is allowed.

    Attributes:
        metric: name.
        sign: 1 for an upper bound, -1 for a lower bound.
        bound: the bound.
    """

    metric: str
    sign: int
    bound: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a constraint such as "settling_time_s<2.5" or "internal_axial_mean_N > -11".

        Raises:
            FieldError: the text is not a constraint.
        """
        form = _FORM.fullmatch(text)
        with contextlib.suppress(ValueError):
            if form is not None and np.isfinite(bound := float(form["bound"])):
                return cls(form["metric"], 1 if form["sign"] == "<" else -1, bound)
        wanted = "METRIC<NUMBER or METRIC>NUMBER, with a finite number"
        raise FieldError(f"is {text!r}; it must read {wanted}", "subject_to")

    def excess(self, value: float) -> float:
        """Return the violation, relative to bounds above 1; inf for a value that is not finite."""
        beyond = self.sign * (value - self.bound) / max(1.0, abs(self.bound))
        return max(beyond, 0.0) if np.isfinite(value) else np.inf


_INFEASIBLE = 1e12
"""Cost of an infeasible run, to be multiplied by 1 + its violation."""
_FAILED = 1e100
"""Cost of a failed run; finite, because scipy evaluates a population of infinities twice."""


class Objective(NamedTuple):
    """Objective of a search.

    Attributes:
        minimize: name of the metric to minimise.
        bounds: constraints on metrics.
    """

    minimize: str
    bounds: tuple[Bound, ...]

    def costs(self, result: SweepResult) -> Array:
        """Return the cost of each run, shape (n,).

        The cost is the metric of a feasible run, grows with the violation of an infeasible one beyond any
        metric, and is largest for a failed run.

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
        costs = np.where(excess > 0.0, _INFEASIBLE * (1.0 + excess), metric)
        return np.where(np.isfinite(metric + excess), costs, _FAILED)

    @staticmethod
    def is_feasible(cost: float) -> bool:
        """Return whether a cost is that of a run within all bounds."""
        return cost < _INFEASIBLE


class Evaluator:
    """Evaluates generations of points, each as one sweep of the session, and collects them."""

    def __init__(self, session: Session, base: Scenario, fields: Sequence[str], objective: Objective) -> None:
        self._session, self._base, self._fields = session, base, tuple(fields)
        self._objective = objective
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
        costs = self._objective.costs(SweepResult(plan, store))
        self._lowest = min(self._lowest, float(costs.min()))
        feasible = self._objective.is_feasible(self._lowest)
        self._session.bar.describe(f"best {self._lowest:.4g}" if feasible else "no feasible run yet")
        return costs

    def history(self) -> SweepResult:
        """Return all points as one sweep."""
        return SweepResult(self._plan(self._points), self._session.store)

    def _plan(self, points: Sequence[tuple[float, ...]]) -> SweepPlan:
        values = dict(zip(self._fields, zip(*points, strict=True), strict=True))
        return SweepPlan(base=self._base, zipped=(values,))


Method = Literal["evolution", "optuna"]
_SEARCHES: dict[str, Search] = {"evolution": search_by_evolution, "optuna": search_by_optuna}


class TuneResult(NamedTuple):
    """Result of tuning.

    Attributes:
        best: the feasible run with the smallest metric.
        history: all runs in order, as a sweep.
        objective: the metric and the constraints.
    """

    best: PointResult
    history: SweepResult
    objective: Objective

    def summary(self) -> str:
        """Return the metrics of the objective and the tuned fields of the best run as text."""
        failed = self.history.counts()["failed"]
        lines = [f"best of {len(self.history.plan)} runs ({failed} failed): run {self.best.number}"]
        metrics = dict.fromkeys([self.objective.minimize, *(b.metric for b in self.objective.bounds)])
        lines += [f"  {metric} = {self.best.metrics[metric]:.6g}" for metric in metrics]
        return "\n".join(lines + [f"  {field} = {x:.6g}" for field, x in self.best.parameters.items()])


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
    """Return the values of a scenario's fields that minimise a metric, and every run of the search.

    The search is a function of its arguments: the same call finds its finished runs in the folder and resumes
    an interrupted search; a call with more generations starts with the existing ones. One set of workers
    serves the whole search, which has the folder to itself.

    Args:
        scenario: the scenario, its name or path.
        vary: lowest and highest value of each field.
        minimize: name of the metric.
        subject_to: one constraint on a metric, "settling_time_s<2.5", or several.
        out: folder of the runs.
        method: "evolution" (differential evolution, scipy) or "optuna" (tree-structured Parzen estimator;
            extra "tune").
        generations: number of generations after the first one.
        population: runs in a generation for each field; at least 5 runs in all.
        seed: seed of the search.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bar.

    Raises:
        FieldError: there is no such field or method, a range is empty, a constraint cannot be read, or the
            scheduler's address is malformed.
        NameNotFoundError: runs have no such metric.
        MissingExtraError: the method's package is not installed.
        NothingFeasibleError: no run is within all bounds; the folder keeps the runs.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
        CoopPinError: whatever else ``sweep`` raises.
    """
    require_path("out", out)
    require_type("vary", vary, Mapping)
    require_type("quiet", quiet, bool)
    require_type("minimize", minimize, str)
    require_type("subject_to", subject_to, str, Sequence)
    base = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    generations, population = as_count("generations", generations), as_count("population", population, 1)
    seed = as_count("seed", seed)
    bounds = [subject_to] if isinstance(subject_to, str) else list(subject_to)
    objective = Objective(minimize, tuple(map(Bound.parse, bounds)))
    _check(base, vary, method, generations, population)
    budget = Budget.of(generations, population, len(vary), seed)
    with open_session(out, BackendOptions.of(workers, scheduler), budget.runs, quiet=quiet) as session:
        evaluator = Evaluator(session, base, list(vary), objective)
        _SEARCHES[method](evaluator.costs, vary, budget)
        history = evaluator.history()
        history.write_tables()
    costs = objective.costs(history)
    best = int(np.argmin(costs))
    if not objective.is_feasible(costs[best]):
        failures = history.failures
        complaint = f"{failures[0].kind}: {failures[0].message}" if failures else ""
        raise NothingFeasibleError(len(costs), len(failures), bounds, str(out), complaint)
    return TuneResult(history.point(best), history, objective)


def _check(base: Scenario, vary: Ranges, method: str, generations: int, population: int) -> None:
    """Refuse mistakes in the arguments before anything is run or written."""
    if method not in _SEARCHES:
        raise FieldError(f"is {method!r}; it must be one of {', '.join(_SEARCHES)}", "method")
    if not vary:
        raise FieldError("names no field; give at least one, with its lowest and highest value", "vary")
    if generations < 0 or population < 1:
        detail = f"are {generations} and {population}; they must be at least 0 and 1"
        raise FieldError(detail, "generations and population")
    for field, ends in vary.items():
        try:
            low, high = map(float, ends)
        except (TypeError, ValueError):
            detail = f"has the range {ends!r}; it must be a lowest and a highest number"
            raise FieldError(detail, field) from None
        if not (np.isfinite([low, high]).all() and low < high):
            detail = f"goes from {low:g} to {high:g}; the range must have a lower and a higher end"
            raise FieldError(detail, field)
    SweepPlan(base=base, zipped=(dict(vary),))  # refuses fields that do not exist
