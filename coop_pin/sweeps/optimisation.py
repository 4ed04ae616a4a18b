"""Optimisation: scenario fields with the smallest value of a metric under constraints, by optuna."""

from __future__ import annotations

import contextlib
import itertools
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from coop_pin.base.arrays import Array, as_count, require_path, require_type
from coop_pin.base.errors import FieldError, NothingFeasibleError, ScenarioError, needs_extra
from coop_pin.description.scenario import Scenario
from coop_pin.stability.step_size import with_changes
from coop_pin.sweeps.dimensions import Sample, Span
from coop_pin.sweeps.engine import with_engine
from coop_pin.sweeps.feasibility import require_feasible, require_feasible_groups
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.session import open_session
from coop_pin.sweeps.table import PointResult
from coop_pin.sweeps.workers.execution import HERE, Execution

_SMALLEST = 5
"""Runs in a generation, at least."""
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
        require_type("a constraint", text, str)
        form = _FORM.fullmatch(text)
        with contextlib.suppress(ValueError):
            if form is not None and np.isfinite(bound := float(form["bound"])):
                return cls(form["metric"], 1 if form["sign"] == "<" else -1, bound)
        expected = "METRIC<NUMBER or METRIC>NUMBER, with a finite number"
        raise FieldError(f"is {text!r}; it must read {expected}", "subject_to")

    def excess(self, values: Array) -> Array:
        """Return the violations, relative to bounds above 1; inf for values that are not finite."""
        beyond = self.sign * (values - self.bound) / max(1.0, abs(self.bound))
        return np.where(np.isfinite(values), np.maximum(beyond, 0.0), np.inf)


class Objective(NamedTuple):
    """Objective of a search.

    Attributes:
        minimize: name of the metric to minimise.
        bounds: constraints on metrics.
    """

    minimize: str
    bounds: tuple[Bound, ...]

    def read(self, result: SweepResult) -> tuple[Array, Array]:
        """Return the metric and the violation of all bounds together of each point, shapes (n,).

        The last dimension of the sweep has the points; the metric is the mean over the others, and the
        violation their sum. Within all bounds it is 0; inf where a run failed or has no finite metric.

        Raises:
            NameNotFoundError: runs have no such metric.
        """
        shape = (-1, result.plan.shape[-1])
        if not result.metric_names:
            return np.full(shape[-1], np.nan), np.full(shape[-1], np.inf)
        metric = result.values(self.minimize).values.reshape(shape)
        excess = np.where(np.isfinite(metric), 0.0, np.inf)
        for bound in self.bounds:
            excess += bound.excess(result.values(bound.metric).values.reshape(shape))
        return metric.mean(axis=0), excess.sum(axis=0)


_LARGEST = 1e12
"""Violation of a failed run; the search wants finite numbers."""


def search(
    evaluate: Callable[[list[list[float]]], tuple[Array, Array]], first: Sample, *, generations: int
) -> None:
    """Search with optuna's tree-structured Parzen estimator, after a sample.

    Points are requested and reported a generation at a time, so that they do not depend on which run ends
    first. Among infeasible runs the one with the smaller violation is better, and any feasible one is better
    than these.

    Args:
        evaluate: runs a generation of points, s rows of values, and returns what ``Objective.read`` does.
        first: the first generation; the later ones have its size, ranges and seed.
        generations: number of later ones.

    Raises:
        MissingExtraError: optuna is not installed.
    """
    with needs_extra("optuna", "tune", "to search for gains"):
        import optuna  # slow to load
    experimental, size, start = optuna.exceptions.ExperimentalWarning, first.count, first.dimension()
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings(action="ignore", category=experimental))
        stack.callback(optuna.logging.set_verbosity, optuna.logging.get_verbosity())
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        # Pending points count as bad ones, so that a generation spreads.
        sampler = optuna.samplers.TPESampler(
            n_startup_trials=size, multivariate=True, constant_liar=True, seed=first.seed
        )
        study = optuna.create_study(sampler=sampler)
        for index in range(size):
            study.enqueue_trial(dict(start.changes(index)))
        for _ in range(generations + 1):
            trials = [study.ask() for _ in range(size)]
            points = [
                [
                    trial.suggest_float(field, span.low, span.high, log=span.scale == "log")
                    for field, span in first.fields.items()
                ]
                for trial in trials
            ]
            for trial, metric, excess in zip(trials, *evaluate(points), strict=True):
                trial.set_constraint("bounds", min(float(excess), _LARGEST))
                study.tell(trial, float(metric) if np.isfinite(metric) else 0.0)


class TuneResult(NamedTuple):
    """Result of tuning.

    Attributes:
        best: the feasible run with the smallest metric; with cases, that of the first one.
        value: the metric; with cases, their mean.
        history: all runs in order, as a sweep.
        objective: the metric and the constraints.
    """

    best: PointResult
    value: float
    history: SweepResult
    objective: Objective

    def summary(self) -> str:
        """Return the metrics of the objective and the tuned fields of the best run as text."""
        failed = self.history.counts()["failed"]
        verdict = self.best.verdict()
        lines = [f"best of {len(self.history.plan)} runs ({failed} failed): run {self.best.number}"]
        lines += [f"  {verdict}"] * bool(verdict)
        bounded = {bound.metric: self.best.metrics[bound.metric] for bound in self.objective.bounds}
        metrics = {self.objective.minimize: self.value} | bounded | self.tuned
        return "\n".join(lines + [f"  {name} = {x:.6g}" for name, x in metrics.items()])

    def __repr__(self) -> str:
        return self.summary()

    @property
    def tuned(self) -> dict[str, float]:
        """The tuned fields of the best run."""
        return {field: self.best.parameters[field] for field in self.history.plan.zipped[0]}


def _rows(sample: Sample) -> list[tuple[float, ...]]:
    """Return the points of a sample, one value for each field."""
    values = sample.dimension().fields
    return list(zip(*(values[field] for field in sample.fields), strict=True))


def _require_feasible_cases(plan: SweepPlan, size: int) -> None:
    """Refuse a search of which no point of the first generation can run, in one of the cases at least.

    Args:
        plan: first generation; its last dimension has the points.
        size: number of points.
    """
    if not plan.cases:
        require_feasible(map(plan.resolved, plan.points(range(size))))
    names = itertools.product(*plan.cases.values()) if plan.cases else ()
    require_feasible_groups(
        {
            f"cases.{' | '.join(case)}": map(plan.resolved, plan.points(range(k * size, (k + 1) * size)))
            for k, case in enumerate(names)
        }
    )


def tune(
    scenario: str | Path | Scenario,
    vary: Mapping[str, tuple[float, float] | Span],
    *,
    minimize: str,
    subject_to: str | Sequence[str] = (),
    out: str | Path,
    metrics: Sequence[str | Callable[..., Any]] = (),
    changes: Mapping[str, Any] | None = None,
    cases: Mapping[str, Mapping[str, Any]] | None = None,
    generations: int = 10,
    population: int = 8,
    seed: int = 0,
    execution: Execution = HERE,
) -> TuneResult:
    """Return the values of a scenario's fields that minimise a metric, and every run of the search.

    The search is a function of its arguments: the same call finds its finished runs in the folder and resumes
    an interrupted search; a call with more generations starts with the existing ones. One set of workers
    serves the whole search, which has the folder to itself.

    Args:
        scenario: scenario, its name or path.
        vary: lowest and highest value of each field.
        minimize: name of the metric.
        subject_to: one constraint on a metric, "settling_time_s<2.5", or several.
        out: folder of the runs.
        metrics: functions of the user, "module:function", as in a SweepPlan; ``minimize`` and ``subject_to``
            may name what they return.
        changes: fields changed in every run, by dotted path, as in a SweepPlan.
        cases: named groups of changes, as in a SweepPlan, in each of which every point is run: the mean of
            the metric is minimised, and the constraints hold in each.
        generations: number of generations after the first one.
        population: runs in a generation for each field; at least 5 runs in all.
        seed: seed of the search.
        execution: workers, engine, folders to merge; "auto" counts the runs of the whole search.

    Raises:
        FieldError: there is no such field, a range is empty, a constraint cannot be read, no run of the first
            generation can succeed in a case, or the scheduler's address is malformed.
        InfeasibleMotionError: the path of every run of the first generation is out of reach.
        NameNotFoundError: runs have no such metric.
        MissingExtraError: optuna is not installed.
        NothingFeasibleError: no run is within all bounds; the folder keeps the runs.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
        CoopPinError: whatever else ``sweep`` raises.
    """
    require_path("out", out)
    require_type("vary", vary, Mapping)
    require_type("minimize", minimize, str)
    require_type("subject_to", subject_to, str, Sequence)
    require_type("metrics", metrics, Sequence)
    require_type("cases", cases, Mapping, type(None))
    require_type("execution", execution, Execution)
    require_type("changes", changes, Mapping, type(None))
    base = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    for field in set(changes or ()) & set(vary):
        raise FieldError("has a range and a value; give it one of them", field)
    base = with_changes(base, changes or {})
    generations, population = as_count("generations", generations), as_count("population", population, 1)
    bounds = [subject_to] if isinstance(subject_to, str) else list(subject_to)
    objective = Objective(minimize, tuple(map(Bound.parse, bounds)))
    size, seed = max(_SMALLEST, population * len(vary)), as_count("seed", seed)
    try:
        first = Sample(fields=vary, count=size, method="latin-hypercube", seed=seed)
    except ScenarioError as error:
        detail = f"names no field, or one with a range that is not two numbers, the lower first: {error}"
        raise FieldError(detail, "vary") from None
    points, engine = list[list[float]](), execution.engine or "auto"

    def plan(rows: Sequence[Sequence[float]]) -> SweepPlan:
        values = dict(zip(vary, zip(*rows, strict=True), strict=True))
        return SweepPlan(
            base=base, cases=cases or {}, zipped=(values,), metrics=tuple(metrics), engine=engine
        )

    lowest = plan([[span.low for span in first.fields.values()]])  # refuses fields that do not exist
    _require_feasible_cases(plan(_rows(first)), size)
    total = (generations + 1) * size * len(lowest)
    with open_session(out, execution, total) as session:
        engine = with_engine(lowest, session.store, total).engine

        def evaluate(generation: list[list[float]]) -> tuple[Array, Array]:
            points.extend(generation)
            newest = plan(generation)
            session.store.write_plan(plan(points))
            session.compute(newest)
            metric, excess = objective.read(session.result(newest))
            least = np.where(excess > 0.0, np.inf, metric).min()
            session.bar.describe(f"best of the last {size}: {least:.4g}")
            return metric, excess

        search(evaluate, first, generations=generations)
        history = SweepResult(plan(points), session.store)
        history.write_tables()
    metric, excess = objective.read(history)
    best = int(np.argmin(np.where(excess > 0.0, np.inf, metric)))
    if excess[best] > 0.0:
        failures = history.failures
        complaint = f"{failures[0].kind}: {failures[0].message}" if failures else ""
        raise NothingFeasibleError(total, len(failures), bounds, str(out), complaint)
    return TuneResult(history.point(best), float(metric[best]), history, objective)
