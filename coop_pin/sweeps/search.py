"""Search by optuna's tree-structured Parzen estimator (extra "tune")."""

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
    """How much is tried.

    Attributes:
        generations: after the first one.
        size: runs in a generation.
        seed: of the search.
    """

    generations: int
    size: int
    seed: int

    @classmethod
    def of(cls, generations: int, population: int, fields: int, seed: int) -> Budget:
        """Return the effort for so many runs in a generation for each field; at least five in all, which differential evolution needs."""
        return cls(generations, max(_SMALLEST, population * fields), seed)

    @property
    def runs(self) -> int:
        """Number of runs of the search."""
        return (self.generations + 1) * self.size


Search = Callable[[Costs, Ranges, Budget], None]
"""A way of searching: the points that it tries depend on its arguments and on the costs alone, never on who computes them or when."""


def first_generation(ranges: Ranges, effort: Budget) -> Array:
    """Return the points that every search begins with, a Latin hypercube: shape (s, fields)."""
    spans = {field: Span(low=low, high=high) for field, (low, high) in ranges.items()}
    sample = Sample(fields=spans, count=effort.size, method="latin-hypercube", seed=effort.seed)
    return np.array([list(sample.point(index).values()) for index in range(effort.size)])


def search_by_optuna(costs: Costs, ranges: Ranges, effort: Budget) -> None:
    """Try a Latin hypercube first, then generations drawn from where good points are dense and bad ones are not.

    Points are asked for and told a generation at a time, so that they do not depend on which run ends first.

    Args:
        costs: runs a generation and returns its costs.
        ranges: of the fields.
        effort: how much is tried.

    Raises:
        MissingExtraError: optuna is not installed.
    """
    with _quiet() as optuna:
        study = optuna.create_study(sampler=_sampler(optuna, effort))
        for point in first_generation(ranges, effort):
            study.enqueue_trial(dict(zip(ranges, map(float, point), strict=True)))
        for _ in range(effort.generations + 1):
            trials = [study.ask() for _ in range(effort.size)]
            points = [
                [trial.suggest_float(field, low, high) for field, (low, high) in ranges.items()]
                for trial in trials
            ]
            for trial, cost in zip(trials, costs(np.array(points)), strict=True):
                study.tell(trial, float(cost))


def _sampler(optuna: Any, effort: Budget) -> Any:
    """Return the estimator: over all fields together, and counting points under way as bad, so that a generation spreads."""
    return optuna.samplers.TPESampler(
        n_startup_trials=effort.size, multivariate=True, constant_liar=True, seed=effort.seed
    )


@contextlib.contextmanager
def _quiet() -> Iterator[Any]:
    """Yield optuna, which says nothing meanwhile: neither of each study nor of options that it calls experimental.

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


def search_by_evolution(costs: Costs, ranges: Ranges, effort: Budget) -> None:
    """Try a Latin hypercube first, then generations bred from the best and from differences of others.

    Args:
        costs: runs a generation and returns its costs.
        ranges: of the fields.
        effort: how much is tried.

    Raises:
        CoopPinError: whatever ``costs`` raises.
    """
    from scipy.optimize import differential_evolution  # slow to load

    try:
        differential_evolution(
            lambda columns: costs(columns.reshape(len(ranges), -1).T),
            list(ranges.values()),
            maxiter=effort.generations,
            init=first_generation(ranges, effort),
            rng=np.random.default_rng(effort.seed),
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
        )
    except RuntimeError as error:
        if isinstance(
            error.__cause__, CoopPinError
        ):  # scipy takes a ValueError for a mistake in its own arguments
            raise error.__cause__ from None
        raise
