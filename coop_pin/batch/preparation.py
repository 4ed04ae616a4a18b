"""Preparation of a batch: plants, numbers and references of its runs, and what they must share."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.run_constants import RunConstants, Start, run_constants, start, with_laws
from coop_pin.batch.support import support
from coop_pin.batch.tree import leaves, structure
from coop_pin.description.controller import NoForcePath
from coop_pin.description.events import WrenchPulse
from coop_pin.description.scenario import Scenario
from coop_pin.errors import ArgumentError
from coop_pin.run_scenario import build_controller
from coop_pin.simulation import Simulation

_NO_DIFFERENCE = {"name", "summary", "controller", "trust", "beyond_bound"}
"""Fields of a scenario that do not reach its plant."""


class Prepared(NamedTuple):
    """A batch before it runs.

    Attributes:
        scenarios: to run.
        runs: a simulation of each, at its start; runs with equal plants share the first one's.
        constants: numbers of each.
        starts: of each.
        references: X_WP_d, V_WP_d, A_WP_d and squeeze at all ticks, shape (runs, ticks + 1, 28 + 6 m).
        values: leaves of the constants, shape (runs, leaves).
        kind: what they share besides numbers.
    """

    scenarios: Sequence[Scenario]
    runs: Sequence[Simulation]
    constants: Sequence[RunConstants]
    starts: Sequence[Start]
    references: Array
    values: Array
    kind: Hashable


def prepare(scenarios: Sequence[Scenario]) -> Prepared:
    """Return plants, numbers and references of all runs; those of equal plants are shared.

    Raises:
        ArgumentError: a scenario cannot run in a batch, or they differ in more than numbers.
    """
    first, runs = scenarios[0], list[Simulation]()
    constants, starts, references = list[RunConstants](), list[Start](), list[Array]()
    for scenario in scenarios:
        if runs and _same_plant(scenario, first):
            runs.append(runs[0])
            constants.append(with_laws(constants[0], scenario))
            starts.append(starts[0])
            references.append(references[0])
            continue
        if reason := support(scenario):
            raise ArgumentError(f"{scenario.name!r} cannot run in a batch: {reason}")
        run = Simulation(scenario, build_controller(scenario))
        runs.append(run)
        constants.append(run_constants(scenario, run))
        starts.append(start(scenario, run))
        references.append(_references(run))
    kinds = list(map(_kind, scenarios, constants))
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise ArgumentError(f"scenarios[{index}] differs from the first in more than numbers")
    values = np.array([leaves(tree) for tree in constants], dtype=np.float64)
    return Prepared(scenarios, runs, constants, starts, np.array(references), values, kinds[0])


def _same_plant(scenario: Scenario, other: Scenario) -> bool:
    fields = set(Scenario.model_fields) - _NO_DIFFERENCE
    law, other_law = scenario.controller, other.controller
    same_kind = type(law) is type(other_law) and law.force_path == other_law.force_path
    return same_kind and all(getattr(scenario, name) == getattr(other, name) for name in fields)


def family(scenario: Scenario) -> Hashable:
    """Return what a scenario must share with others of its batch, as far as its fields show it."""
    fields = set(Scenario.model_fields) - {"name", "summary", "trust"}
    return *(structure(getattr(scenario, name)) for name in sorted(fields)), _times(scenario)


def _kind(scenario: Scenario, constants: RunConstants) -> Hashable:
    """Return what the scenarios of a batch must share."""
    return structure(constants), scenario.cell.rows, _times(scenario)


def _times(scenario: Scenario) -> Hashable:
    """Return ticks and delays, and events by their times."""
    path, events = scenario.controller.force_path, scenario.events
    times = [(event.time, event.end if isinstance(event, WrenchPulse) else np.nan) for event in events]
    delay = None if isinstance(path, NoForcePath) else path.delay
    clock = scenario.clock
    ticks = (clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration)
    return ticks, str(times), delay


def _references(run: Simulation) -> Array:
    """Return X_WP_d, V_WP_d, A_WP_d and squeeze of all ticks, shape (ticks + 1, 28 + 6 m)."""
    found, grasps = [], run.scenario.cell.grasps
    for tick in range(run.timeline.ticks + 1):
        time = run.timeline.time(tick)
        target, squeeze = run.motion.at(time), run.squeeze.at(time, grasps)
        found.append(np.concatenate((target.X_WP_d.ravel(), target.V_WP_d, target.A_WP_d, squeeze.ravel())))
    return np.array(found)
