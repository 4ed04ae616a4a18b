"""Preparation of a batch: plants, numbers and references of its runs, and what they must share."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.constants import run_constants, start
from coop_pin.batch.signals import RunShape, columns, desired_of, first_of, run_signals
from coop_pin.batch.support import plant_reason
from coop_pin.build_controller import build_controller
from coop_pin.control import CellController
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.model.arm_model import ArmModel
from coop_pin.results.dataset import without_time
from coop_pin.results.quantities import QUANTITIES, quantities
from coop_pin.simulation import Simulation
from coop_pin.tracing.tree import leaves, structure

_OTHERS = {"controller", "beyond_bound", "seed"}
"""Fields of a scenario that reach its controller and signals only."""
_PLANT = set(Scenario.model_fields) - _OTHERS - {"name", "summary", "trust"}
"""Fields that make its plant."""
_NUMBERS = re.compile(r"(?<=[:\[,])-?\d[-+.\deE]*")
"""Of JSON without blanks."""


class PreparedPlant:
    """Plant of one or more runs, before they run.

    Attributes:
        scenario: of the newest of them.
        run: a simulation of the first, at its start.
        constants: its numbers, the controller's last.
        values: leaves of the others.
        start: of the runs.
        shape: of the runs.
        desired: desired motion and squeeze at all ticks.
        example: signals of a tick.
        table: quantities of the runs.
        read: quantities that are recorded at ticks; runs with and without an error of the kinematics share a
            batch.
        labels: names and limits of arms and joints.
        kind: what the runs of a batch must share besides numbers, the controller apart.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build the plant.

        Raises:
            TracingError: it cannot be traced.
            CoopPinError: the run cannot start.
        """
        if reason := plant_reason(scenario.plant):
            raise TracingError(f"{scenario.name!r} cannot run in a batch: {reason}")
        self.scenario, self.run = scenario, Simulation(scenario, build_controller(scenario))
        self._models = {name: ArmModel.from_cell(scenario.cell, name) for name in scenario.cell.arms}
        self.constants, self.start = run_constants(scenario, self.run), start(scenario, self.run)
        others = self.constants._replace(controller=None)
        self.values, self.shape = leaves(others), RunShape.of(scenario)
        self.kind = structure(others), self.shape, _times(scenario)
        self.desired = desired_of(self.run)
        self._joints = [len(place.drive) for place in self.run.plant.chain.model.arms]
        drawn = run_signals(scenario, self.desired, self._joints)
        self.example, self._signals = first_of(drawn), {scenario.seed: columns(drawn)}
        recorder, self.table = self.run.recorder, quantities(scenario)
        self.read = [each for each in QUANTITIES if each in self.table or each.group == "kinematics"]
        self.labels = without_time(scenario, [own for _, own in recorder.joints], recorder.limit_table())

    def controller(self, scenario: Scenario) -> CellController:
        """Return the controller of a run of this plant."""
        return build_controller(scenario, self._models)

    def signals(self, scenario: Scenario) -> Array:
        """Return the signals of a run of this plant at all ticks, shape (ticks + 1, entries)."""
        if scenario.seed not in self._signals:
            drawn = run_signals(scenario, self.desired, self._joints)
            self._signals = {scenario.seed: columns(drawn)}  # those of one seed are kept
        return self._signals[scenario.seed]


class Prepared(NamedTuple):
    """A batch before it runs.

    Attributes:
        scenarios: to run.
        plants: of each; runs with equal plants share the first one's.
        signals: of each at all ticks, shape (ticks + 1, entries).
        values: leaves of the constants, shape (runs, leaves).
        kind: what they share besides numbers.
    """

    scenarios: Sequence[Scenario]
    plants: Sequence[PreparedPlant]
    signals: Sequence[Array]
    values: Array
    kind: Hashable


def prepare(scenarios: Sequence[Scenario], known: Iterable[PreparedPlant] = ()) -> Prepared:
    """Return plants, numbers and signals of all runs; those of equal plants are shared.

    Args:
        scenarios: to run.
        known: plants that some of them may have.

    Raises:
        TracingError: a scenario cannot run in a batch, or they differ in more than numbers.
    """
    plants, values, kinds, signals, distinct = list[PreparedPlant](), [], [], list[Array](), list(known)
    for scenario in scenarios:
        plant = next((each for each in distinct if _same_plant(scenario, each.scenario)), None)
        if plant is None:
            plant = PreparedPlant(scenario)
            distinct.append(plant)
        plant.scenario = scenario  # the next one shares more of its objects
        controller = plant.controller(scenario)
        plants.append(plant)
        values.append([*plant.values, *leaves(controller)])
        kinds.append((plant.kind, structure(controller)))
        signals.append(plant.signals(scenario))
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise TracingError(f"scenarios[{index}] differs from the first in more than numbers")
    return Prepared(scenarios, plants, signals, np.array(values, dtype=np.float64), kinds[0])


def _same_plant(scenario: Scenario, other: Scenario) -> bool:
    law, other_law = scenario.controller, other.controller
    same_kind = type(law) is type(other_law) and law.force_path == other_law.force_path
    return same_kind and all(getattr(scenario, name) == getattr(other, name) for name in _PLANT)


def families(scenarios: Sequence[Scenario]) -> list[Hashable]:
    """Return what each scenario must share with others of its batch, as far as its fields show it.

    Args:
        scenarios: of any kinds.
    """
    found, last = list[Hashable](), None
    for scenario in scenarios:
        if last is None or not _same_plant(scenario, last):
            last, plant = scenario, (_kinds(scenario, _PLANT), RunShape.of(scenario), _times(scenario))
        found.append((plant, _kinds(scenario, _OTHERS)))
    return found


def _kinds(scenario: Scenario, fields: set[str]) -> str:
    """Return the JSON of some fields with every number replaced by 0."""
    return _NUMBERS.sub("0", scenario.model_dump_json(include=fields))


def _times(scenario: Scenario) -> Hashable:
    """Return ticks, and events and losses of torque by their times."""
    times = [(event.time, event.end) for event in scenario.events]
    lost = [scenario.actuators_of(arm).torque_lost_at for arm in scenario.cell.arms]
    clock = scenario.clock
    return clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration, str(times), str(lost)
