"""Preparation of a batch: plants, numbers and references of its runs, and what they must share."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.kernel import Layout
from coop_pin.batch.run_constants import RunConstants, Start, run_constants, start
from coop_pin.batch.signals import RunShape, errors, references, signal_layout
from coop_pin.batch.support import plant_reason
from coop_pin.batch.tree import leaves, structure
from coop_pin.description.events import WrenchPulse
from coop_pin.description.scenario import Scenario
from coop_pin.errors import TracingError
from coop_pin.run_scenario import build_controller
from coop_pin.simulation import Simulation

_NO_DIFFERENCE = {"name", "summary", "controller", "trust", "beyond_bound", "seed"}
"""Fields of a scenario that do not reach its plant."""


class Prepared(NamedTuple):
    """A batch before it runs.

    Attributes:
        scenarios: to run.
        runs: a simulation of each, at its start; runs with equal plants share the first one's.
        constants: numbers of each.
        starts: of each.
        shape: of all runs.
        layout: of the signals of a tick.
        signals: of each at all ticks, shape (ticks + 1, entries).
        values: leaves of the constants, shape (runs, leaves).
        kind: what they share besides numbers.
    """

    scenarios: Sequence[Scenario]
    runs: Sequence[Simulation]
    constants: Sequence[RunConstants]
    starts: Sequence[Start]
    shape: RunShape
    layout: Layout
    signals: Sequence[Array]
    values: Array
    kind: Hashable


def prepare(scenarios: Sequence[Scenario]) -> Prepared:
    """Return plants, numbers and references of all runs; those of equal plants are shared.

    Raises:
        TracingError: a scenario cannot run in a batch, or they differ in more than numbers.
    """
    first, runs = scenarios[0], list[Simulation]()
    constants, starts, signals = list[RunConstants](), list[Start](), list[Array]()
    for scenario in scenarios:
        if runs and _same_plant(scenario, first):
            run = runs[0]
            constants.append(constants[0]._replace(controller=build_controller(scenario)))
            starts.append(starts[0])
        else:
            if reason := plant_reason(scenario):
                raise TracingError(f"{scenario.name!r} cannot run in a batch: {reason}")
            run = Simulation(scenario, build_controller(scenario))
            constants.append(run_constants(scenario, run))
            starts.append(start(scenario, run))
        runs.append(run)
        if len(runs) > 1 and run is runs[0] and scenario.seed == first.seed:
            signals.append(signals[0])
        else:
            signals.append(_signals(scenario, run))
    kinds = list(map(_kind, scenarios, constants))
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise TracingError(f"scenarios[{index}] differs from the first in more than numbers")
    values = np.array([leaves(tree) for tree in constants], dtype=np.float64)
    layout = signal_layout(*_sizes(runs[0]))
    return Prepared(scenarios, runs, constants, starts, RunShape.of(first), layout, signals, values, kinds[0])


def _sizes(run: Simulation) -> tuple[int, int]:
    """Return the numbers of arms and drives."""
    joints = [len(place.drive) for place in run.plant.chain.model.arms]
    return len(joints), sum(joints)


def _signals(scenario: Scenario, run: Simulation) -> Array:
    """Return the signals at all ticks, shape (ticks + 1, entries)."""
    found = references(run)
    joints = [len(place.drive) for place in run.plant.chain.model.arms]
    found |= errors(scenario, RunShape.of(scenario), joints, found["time"])
    layout, count = signal_layout(*_sizes(run)), len(found["time"])
    values = np.zeros((count, layout.size))
    for name, entries in found.items():
        values[:, layout.slots(name).ravel()] = entries.reshape(count, -1)
    return values


def _same_plant(scenario: Scenario, other: Scenario) -> bool:
    fields = set(Scenario.model_fields) - _NO_DIFFERENCE
    law, other_law = scenario.controller, other.controller
    same_kind = type(law) is type(other_law) and law.force_path == other_law.force_path
    return same_kind and all(getattr(scenario, name) == getattr(other, name) for name in fields)


def family(scenario: Scenario) -> Hashable:
    """Return what a scenario must share with others of its batch, as far as its fields show it."""
    fields = set(Scenario.model_fields) - {"name", "summary", "trust"}
    fixed = RunShape.of(scenario), _times(scenario)
    return *(structure(getattr(scenario, name)) for name in sorted(fields)), *fixed


def _kind(scenario: Scenario, constants: RunConstants) -> Hashable:
    """Return what the scenarios of a batch must share."""
    return structure(constants), RunShape.of(scenario), _times(scenario)


def _times(scenario: Scenario) -> Hashable:
    """Return ticks, and events and losses of torque by their times."""
    times = [
        (event.time, event.end if isinstance(event, WrenchPulse) else np.nan) for event in scenario.events
    ]
    lost = [scenario.actuators_of(arm).torque_lost_at for arm in scenario.cell.arms]
    clock = scenario.clock
    return clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration, str(times), str(lost)
