"""What a search is for: one metric small, others within their bounds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import EntryNotFoundError
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.tuning.bound import Bound

_OUTSIDE = 1e12
"""What a run outside its bounds costs; how far outside it is counts on top."""
_FAILED = 1e100
"""What a failed run costs; a number, because scipy evaluates a population of infinities twice."""


class Goal(NamedTuple):
    """What is wanted of a run.

    Attributes:
        minimize: name of the metric that should be small.
        bounds: what other metrics must keep.
    """

    minimize: str
    bounds: tuple[Bound, ...]

    def costs(self, result: SweepResult) -> Array:
        """Return a number for each run, by which searches compare them: shape (n,).

        It is the metric of a run within all bounds, more than any metric outside them, and the most for a run that failed.

        Raises:
            EntryNotFoundError: runs have no such metric.
        """
        known, count = result.metric_names, len(result.plan)
        if not known:
            return np.full(count, _FAILED)
        wanted = {self.minimize, *(bound.metric for bound in self.bounds)}
        for name in sorted(wanted - set(known)):
            raise EntryNotFoundError("metric", name, known, "the runs")
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
