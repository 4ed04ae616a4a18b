"""The runs that a search has tried, in their order; what the folder holds already is not run again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.sweeps.engine import Session
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.tuning.goal import Goal


class Tries:
    """Points that were tried; a generation of them is one pass of the session."""

    def __init__(self, session: Session, base: Scenario, fields: Sequence[str], goal: Goal) -> None:
        self._session, self._base, self._fields, self._goal = session, base, tuple(fields), goal
        self._points: list[tuple[float, ...]] = []
        self._lowest = np.inf

    def costs(self, generation: Array) -> Array:
        """Run a generation of points, shape (s, fields), and return their costs, shape (s,).

        Raises:
            EntryNotFoundError: runs have no such metric.
            CoopPinError: whatever ``Session.compute`` raises.
        """
        points = [tuple(map(float, point)) for point in generation]
        self._points += points
        store, plan = self._session.store, self._plan(points)
        store.write_plan(self._plan(self._points))
        self._session.compute(plan)
        costs = self._goal.costs(SweepResult(plan, store))
        self._lowest = min(self._lowest, float(costs.min()))
        self._session.bar.say(f"best {self._lowest:.4g}" if self._goal.met(self._lowest) else "nothing within the bounds yet")
        return costs

    def history(self) -> SweepResult:
        """Return all tries as one sweep."""
        return SweepResult(self._plan(self._points), self._session.store)

    def _plan(self, points: Sequence[tuple[float, ...]]) -> SweepPlan:
        values = dict(zip(self._fields, zip(*points, strict=True), strict=True))
        return SweepPlan(base=self._base, zipped=(values,))
