"""Search by optuna's tree-structured Parzen estimator (extra "tune")."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from coop_pin.errors import MissingExtraError
from coop_pin.sweeps.tuning.effort import Costs, Effort, Ranges, first_generation


def search_by_optuna(costs: Costs, ranges: Ranges, effort: Effort) -> None:
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
            points = [[trial.suggest_float(field, low, high) for field, (low, high) in ranges.items()] for trial in trials]
            for trial, cost in zip(trials, costs(np.array(points)), strict=True):
                study.tell(trial, float(cost))


def _sampler(optuna: Any, effort: Effort) -> Any:
    """Return the estimator: over all fields together, and counting points under way as bad, so that a generation spreads."""
    return optuna.samplers.TPESampler(n_startup_trials=effort.size, multivariate=True, constant_liar=True, seed=effort.seed)


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
