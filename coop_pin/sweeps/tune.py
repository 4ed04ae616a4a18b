"""Gains that make one metric small while others keep their bounds, found by differential evolution; every try is a run of a sweep."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.errors import EntryNotFoundError, FieldError, NothingFeasibleError
from coop_pin.sweeps.one_call import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import PointResult, SweepResult
from coop_pin.sweeps.table import FAILED

_OUTSIDE = 1e12
"""What a run outside its bounds costs; how far outside it is counts on top."""
_FAILED = 1e100
"""What a failed run costs; a number, because scipy evaluates a population of infinities twice."""
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
        mistake = FieldError(f"is {text!r}; it must read METRIC<NUMBER or METRIC>NUMBER", "subject_to")
        form = _FORM.fullmatch(text)
        if form is None:
            raise mistake
        try:
            bound = float(form["bound"])
        except ValueError:
            raise mistake from None
        return cls(form["metric"], 1 if form["sign"] == "<" else -1, bound)

    def excess(self, value: float) -> float:
        """Return by how much a value is outside, as a share of the bound where that is above 1; inf where it is not a number."""
        beyond = self.sign * (value - self.bound) / max(1.0, abs(self.bound))
        return max(beyond, 0.0) if np.isfinite(value) else np.inf


class TuneResult(NamedTuple):
    """What tuning found.

    Attributes:
        best: the run with the smallest metric among those within all bounds.
        history: every run that was tried, in order, as a sweep.
    """

    best: PointResult
    history: SweepResult


class _Tries:
    """The runs tried so far; a generation is one batch of the engine, and what the folder holds is not run again."""

    def __init__(self, base: Scenario, fields: Sequence[str], minimize: str, bounds: Sequence[Bound], options: Mapping[str, Any]) -> None:
        self._base, self._fields, self._minimize, self._bounds, self._options = base, tuple(fields), minimize, tuple(bounds), options
        self._points: list[tuple[float, ...]] = []

    def costs(self, population: Array) -> Array:
        """Return the cost of each column of a population of shape (fields, s): shape (s,)."""
        points = [tuple(float(value) for value in column) for column in population.reshape(len(self._fields), -1).T]
        self._points += points
        return self.costs_of(self._run(points))

    def costs_of(self, result: SweepResult) -> Array:
        """Return the metric of runs within all bounds, a cost above all metrics for others, and the highest for failed ones."""
        known = result.metric_names
        if not known:
            return np.full(len(result.plan), _FAILED)
        wanted = {self._minimize, *(bound.metric for bound in self._bounds)}
        for name in sorted(wanted - set(known)):
            raise EntryNotFoundError("metric", name, known, "the runs")
        values = {name: result.values(name).values.ravel() for name in wanted}
        excess = sum(
            (np.array([bound.excess(value) for value in values[bound.metric]]) for bound in self._bounds), np.zeros(len(result.plan))
        )
        costs = np.where(excess > 0.0, _OUTSIDE * (1.0 + excess), values[self._minimize])
        return np.where(np.isfinite(values[self._minimize] + excess), costs, _FAILED)

    def history(self) -> SweepResult:
        """Return all tries as one sweep; their runs are there already."""
        return self._run(self._points)

    def _run(self, points: Sequence[tuple[float, ...]]) -> SweepResult:
        values = dict(zip(self._fields, zip(*points, strict=True), strict=True))
        return sweep(SweepPlan(base=self._base, zipped=(values,)), **self._options)


def tune(
    scenario: str | Path | Scenario,
    vary: Mapping[str, tuple[float, float]],
    *,
    minimize: str,
    subject_to: Sequence[str] = (),
    out: str | Path,
    generations: int = 10,
    population: int = 8,
    seed: int = 0,
    workers: int | None = None,
    scheduler: str | None = None,
    quiet: bool = False,
) -> TuneResult:
    """Search fields of a scenario for the smallest value of a metric, by differential evolution.

    The search is a function of its arguments: the same call finds its finished runs in the folder and goes on where it was stopped,
    and one with more generations begins with those that are there. Runs that fail are the worst; of two runs outside the bounds the
    one that is less outside is better.

    Args:
        scenario: the scenario, its name or path.
        vary: lowest and highest value of each field.
        minimize: name of the metric.
        subject_to: bounds on metrics, "settling_time_s<2.5".
        out: the folder that keeps the runs.
        generations: after the first one.
        population: runs in a generation for each field; at least 5 runs in all.
        seed: of the search, not of the runs.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bars.

    Raises:
        FieldError: a range is empty, or a bound cannot be read.
        EntryNotFoundError: runs have no such metric.
        NothingFeasibleError: no run is within all bounds; the folder keeps what was tried.
        CoopPinError: whatever ``sweep`` raises.
    """
    from scipy.optimize import differential_evolution  # slow to load

    for field, (low, high) in vary.items():
        if not low < high:
            raise FieldError(f"goes from {low:g} to {high:g}; the range must have a lower and a higher end", field)
    if not vary or generations < 0 or population < 1:
        raise FieldError(f"has {len(vary)} fields, {generations} generations of {population}; there is nothing to search", "vary")
    base = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    options: dict[str, Any] = {"out": out, "workers": workers, "scheduler": scheduler, "quiet": quiet}
    tries = _Tries(base, list(vary), minimize, [Bound.parse(text) for text in subject_to], options)
    differential_evolution(
        tries.costs,
        list(vary.values()),
        maxiter=generations,
        popsize=population,
        rng=np.random.default_rng(seed),
        tol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
    )
    history = tries.history()
    costs = tries.costs_of(history)
    if not costs.min() < _OUTSIDE:
        raise NothingFeasibleError(len(costs), history.counts()[FAILED], list(subject_to))
    return TuneResult(history.point(int(np.argmin(costs))), history)
