"""Preparation of a batch: plants, numbers and references of its runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import TracingError
from coop_pin.base.schema.parts import Filled
from coop_pin.compiled.constants import RunConstants
from coop_pin.compiled.kind import Kind, surroundings_of
from coop_pin.compiled.prepared_plant import PreparedPlant
from coop_pin.control import CellController
from coop_pin.description.scenario import Scenario
from coop_pin.description.thresholds import TaskLimits, TrustThresholds


class Prepared(NamedTuple):
    """Batch before it runs.

    Attributes:
        scenarios: scenarios to run.
        plants: plant of each; runs with equal plants share one.
        signals: signals of each at the ticks of its plant's desired motion, shape (n, entries).
        controller: function that returns the controller of the first run.
        values: leaves of the constants, the controller's last, shape (runs, leaves).
        kind: kind of the runs.
        thresholds: trust thresholds and task limits of each.
    """

    scenarios: Sequence[Scenario]
    plants: Sequence[PreparedPlant]
    signals: Sequence[Array]
    controller: Callable[[], CellController]
    values: Array
    kind: Kind
    thresholds: Sequence[tuple[TrustThresholds, TaskLimits]]

    @property
    def constants(self) -> RunConstants:
        """Numbers of the first run."""
        return self.plants[0].constants._replace(controller=self.controller())

    def part(self, runs: slice) -> Prepared:
        """Return the batch of some of the runs."""
        scenarios, plants = self.scenarios[runs], self.plants[runs]

        def build() -> CellController:
            return scenarios[0].controller.build(scenarios[0], plants[0].arms)

        controller = build if runs.start else self.controller
        values = (self.signals[runs], controller, self.values[runs], self.kind, self.thresholds[runs])
        return Prepared(scenarios, plants, *values)

    def loaded(self, first: Prepared) -> Mask:
        """Return which signals of some run are not those of a first one, shape (entries,)."""
        others = {id(signals): signals for signals in self.signals}.values()
        return np.any([(signals != first.signals[0]).any(axis=0) for signals in others], axis=0)

    @property
    def is_foreign(self) -> bool:
        """Whether the law of the runs is a user's."""
        return bool(self.scenarios[0].controller.user_code)

    def require_surroundings(self) -> None:
        """Refuse to trace a user's law whose classes or modules have changed since the runs were prepared.

        Raises:
            TracingError: They have.
        """
        law = self.scenarios[0].controller
        if law.user_code and self.kind.surroundings != surroundings_of(law):
            raise TracingError(
                f"its controller {law.user_code[0]!r} cannot be traced: its class or module has"
                " attributes that differ between runs; keep them in the object"
            )

    @classmethod
    def of_run(cls, scenario: Scenario, plant: PreparedPlant) -> Prepared:
        """Return the batch of a single run.

        Raises:
            TracingError: the run cannot be in a batch.
            CoopPinError: the run cannot start.
        """
        controller, values, kind = plant.with_controller(scenario)
        signals, thresholds = [plant.signals(scenario)], [(scenario.trust, scenario.task)]
        return cls([scenario], [plant], signals, lambda: controller, values[None], kind, thresholds)

    def alike(self, scenarios: Filled) -> Prepared | None:
        """Return runs that begin with this one and differ from it in numbers of the law.

        Args:
            scenarios: Scenarios of the runs.

        Returns:
            The runs; None where they may differ in more.
        """
        (plant,), count = self.plants, len(scenarios)
        law = plant.columns(scenarios.pattern, np.array(scenarios.rows, dtype=np.float64), self.kind.law)
        if law is None:
            return None
        return self._replace(
            scenarios=scenarios,
            plants=[plant] * count,
            signals=[*self.signals] * count,
            values=np.concatenate((np.broadcast_to(plant.values, (count, plant.values.size)), law), axis=1),
            thresholds=[*self.thresholds] * count,
        )

    @classmethod
    def joined(cls, runs: Sequence[Prepared]) -> Prepared:
        """Return the batch of several runs.

        Raises:
            TracingError: they differ in more than numbers.
        """
        first, *others = runs
        if not others:
            return first
        for index, run in enumerate(others, 1):
            if run.kind != first.kind:
                raise TracingError(f"scenarios[{index}] differs from the first in more than numbers")
        values = np.concatenate([run.values for run in runs])
        scenarios, plants, signals, thresholds = (
            [*itertools.chain.from_iterable(parts)]
            for parts in zip(
                *((run.scenarios, run.plants, run.signals, run.thresholds) for run in runs), strict=True
            )
        )
        return cls(scenarios, plants, signals, first.controller, values, first.kind, thresholds)
