"""Search methods of ``tune``: differential evolution (scipy) and Parzen estimators (optuna)."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import CoopPinError, MissingExtraError
from coop_pin.sweeps.sampling import Sample, Span

Ranges = Mapping[str, tuple[float, float]]
"""The lowest and the highest value of each field."""
Costs = Callable[[Array], Array]
"""Runs a generation of points, shape (s, fields), and returns their costs, shape (s,)."""
_SMALLEST = 5


class Budget(NamedTuple):
    """Budget of a search.

    Attributes:
        generations: number of generations after the first one.
        size: runs in a generation.
        seed: seed of the search.
    """

    generations: int
    size: int
    seed: int

    @classmethod
    def of(cls, generations: int, population: int, fields: int, seed: int) -> Budget:
        """Return the budget for ``population`` runs in a generation for each field.

        A generation has at least five runs, which differential evolution needs.
        """
        return cls(generations, max(_SMALLEST, population * fields), seed)

    @property
    def runs(self) -> int:
        """Number of runs of the search."""
        return (self.generations + 1) * self.size


Search = Callable[[Costs, Ranges, Budget], None]
"""Search method; its points depend on its arguments and on the costs only, not on when these are computed."""


def first_generation(ranges: Ranges, budget: Budget) -> Array:
    """Return the points of the first generation, a Latin hypercube, shape (s, fields)."""
    spans = {field: Span(low=low, high=high) for field, (low, high) in ranges.items()}
    sample = Sample(fields=spans, count=budget.size, method="latin-hypercube", seed=budget.seed)
    return np.array([list(sample.changes(index).values()) for index in range(budget.size)])


def search_by_optuna(costs: Costs, ranges: Ranges, budget: Budget) -> None:
    """Search with optuna's tree-structured Parzen estimator, after a Latin hypercube.

    Points are requested and reported a generation at a time, so that they do not depend on which run ends
    first.

    Args:
        costs: runs a generation and returns its costs.
        ranges: range of each field.
        budget: size of the search.

    Raises:
        MissingExtraError: optuna is not installed.
    """
    with _quiet() as optuna:
        # Pending points count as bad ones, so that a generation spreads.
        options = {"multivariate": True, "constant_liar": True, "seed": budget.seed}
        sampler = optuna.samplers.TPESampler(n_startup_trials=budget.size, **options)
        study = optuna.create_study(sampler=sampler)
        for point in first_generation(ranges, budget):
            study.enqueue_trial(dict(zip(ranges, map(float, point), strict=True)))
        for _ in range(budget.generations + 1):
            trials = [study.ask() for _ in range(budget.size)]
            points = [
                [trial.suggest_float(field, low, high) for field, (low, high) in ranges.items()]
                for trial in trials
            ]
            for trial, cost in zip(trials, costs(np.array(points)), strict=True):
                study.tell(trial, float(cost))


@contextlib.contextmanager
def _quiet() -> Iterator[Any]:
    """Yield optuna without its log messages and without its warnings about experimental options.

    Raises:
        MissingExtraError: optuna is not installed.
    """
    try:
        import optuna  # an extra, and slow to load
    except ImportError:
        raise MissingExtraError("optuna", "tune", "to search with it") from None
    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield optuna
    finally:
        optuna.logging.set_verbosity(level)


def search_by_evolution(costs: Costs, ranges: Ranges, budget: Budget) -> None:
    """Search with scipy's differential evolution, after a Latin hypercube.

    Args:
        costs: runs a generation and returns its costs.
        ranges: range of each field.
        budget: size of the search.

    Raises:
        CoopPinError: whatever ``costs`` raises.
    """
    from scipy.optimize import differential_evolution  # slow to load

    try:
        differential_evolution(
            lambda columns: costs(columns.reshape(len(ranges), -1).T),
            list(ranges.values()),
            maxiter=budget.generations,
            init=first_generation(ranges, budget),
            rng=np.random.default_rng(budget.seed),
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    except RuntimeError as error:
        if isinstance(error.__cause__, CoopPinError):  # scipy wraps any ValueError
            raise error.__cause__ from None
        raise
