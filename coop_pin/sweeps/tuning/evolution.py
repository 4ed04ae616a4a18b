"""Search by differential evolution (scipy's)."""

from __future__ import annotations

import numpy as np

from coop_pin.errors import CoopPinError
from coop_pin.sweeps.tuning.effort import Costs, Effort, Ranges, first_generation


def search_by_evolution(costs: Costs, ranges: Ranges, effort: Effort) -> None:
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
        if isinstance(error.__cause__, CoopPinError):  # scipy takes a ValueError for a mistake in its own arguments
            raise error.__cause__ from None
        raise
