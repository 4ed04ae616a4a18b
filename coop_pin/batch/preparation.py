"""Preparation of a batch: plants, numbers and references of its runs, and what they must share."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.batch.run_constants import RunConstants, Start, run_constants, start
from coop_pin.batch.support import support
from coop_pin.batch.tree import structure
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
    """

    scenarios: Sequence[Scenario]
    runs: Sequence[Simulation]
    constants: Sequence[RunConstants]
    starts: Sequence[Start]
    references: Array


def prepare(scenarios: Sequence[Scenario]) -> Prepared:
    """Return plants, numbers and references of all runs; those of equal plants are shared."""
    runs: list[Simulation] = []
    constants: list[RunConstants] = []
    starts: list[Start] = []
    references: list[Array] = []
    first = scenarios[0]
    for scenario in scenarios:
        run = runs[0] if runs and _same_plant(scenario, first) else None
        if run is None:
            if reason := support(scenario):
                raise ArgumentError(f"{scenario.name!r} cannot run in a batch: {reason}")
            run = Simulation(scenario, build_controller(scenario))
        is_new = not runs or run is not runs[0]
        runs.append(run)
        constants.append(run_constants(scenario, run))
        starts.append(start(scenario, run) if is_new else starts[0])
        references.append(_references(run) if is_new else references[0])
        if _kind(scenario, constants[-1]) != _kind(first, constants[0]):
            raise ArgumentError(f"scenarios[{len(runs) - 1}] differs from the first in more than numbers")
    return Prepared(scenarios, runs, constants, starts, np.array(references))


def _same_plant(scenario: Scenario, other: Scenario) -> bool:
    fields = set(Scenario.model_fields) - _NO_DIFFERENCE
    same_path = scenario.controller.force_path == other.controller.force_path
    return same_path and all(getattr(scenario, name) == getattr(other, name) for name in fields)


def _kind(scenario: Scenario, constants: RunConstants) -> Hashable:
    """Return what the scenarios of a batch must share."""
    path, events = scenario.controller.force_path, scenario.events
    times = [(event.time, event.end if isinstance(event, WrenchPulse) else np.nan) for event in events]
    delay = None if isinstance(path, NoForcePath) else path.delay
    clock = scenario.clock
    ticks = (clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration)
    return structure(constants), scenario.cell.rows, ticks, str(times), delay


def _references(run: Simulation) -> Array:
    """Return X_WP_d, V_WP_d, A_WP_d and squeeze of all ticks, shape (ticks + 1, 28 + 6 m)."""
    found, grasps = [], run.scenario.cell.grasps
    for tick in range(run.timeline.ticks + 1):
        time = run.timeline.time(tick)
        target, squeeze = run.motion.at(time), run.squeeze.at(time, grasps)
        found.append(np.concatenate((target.X_WP_d.ravel(), target.V_WP_d, target.A_WP_d, squeeze.ravel())))
    return np.array(found)
