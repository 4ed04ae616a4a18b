"""Families of runs of one compiled code: what they share, what the code provides, what it does not have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from coop_pin.base.arrays import typed
from coop_pin.description.cell.cell import Cell
from coop_pin.description.controller import Controller
from coop_pin.description.events import PayloadEvent
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario

_COVERED = "sensors", "arm_sensors", "actuators", "arm_actuators", "events"
"""Fields of which code provides what any of its runs needs; see Cover."""
_NUMBERS_ALONE = {"friction", "clock", "duration", *_COVERED}
"""Fields that runs of one code need not share; ``family_of`` adds what they must."""


class Cover(NamedTuple):
    """What code provides, so that runs of which only some need it can share it; none of it changes a bit.

    Attributes:
        delay: Longest delay of a wrist sensor, ticks.
        responds: Whether the torques of an arm may be lost between ticks.
        changed: Fields of the surroundings that events change.
        instants: Number of instants of events.
    """

    delay: int = 0
    responds: bool = False
    changed: frozenset[str] = frozenset()
    instants: int = 0

    @classmethod
    def of(cls, scenario: Scenario) -> Cover:
        """Return what a scenario needs."""
        actuators = [scenario.actuators_of(arm) for arm in scenario.cell.arms]
        responds = any(each.torque_lost_at is not None for each in actuators)
        events, start = scenario.events, scenario.cell.surroundings
        after = [event.apply(start, event.time) for event in events]
        changed = (
            name
            for each in after
            for name, first, then in zip(start._fields, start, each, strict=True)
            if then is not first
        )
        instants = {time for event in events for time in (event.time, event.end)}
        delay = max((wrist.delay for wrist in scenario.wrists), default=0)
        return cls(delay, responds, frozenset(changed), len(instants))

    @classmethod
    def of_all(cls, scenarios: Iterable[Scenario]) -> Cover:
        """Return what some scenarios need together; those with the same objects are asked once."""
        parts = attrgetter(*_COVERED)
        different = {tuple(map(id, parts(scenario))): scenario for scenario in scenarios}
        delays, responds, changed, instants = zip(*map(cls.of, different.values()), strict=True)
        return cls(max(delays), any(responds), frozenset().union(*changed), max(instants))


def family_of(scenario: Scenario) -> str:
    """Return what runs of one code have in common, as far as the scenario shows it, as text.

    They may differ in numbers, in rates, times and events, and in what a Cover provides: the delay of wrist
    sensors, and what is lost.
    """
    fields = scenario.model_dump(exclude={"name", "summary", "seed", "trust"})
    sensors = map(scenario.sensors_of, scenario.cell.arms)
    actuators = map(scenario.actuators_of, scenario.cell.arms)
    common = (
        [(each.wrist is None, each.joints_are_ideal, each.velocity.kind) for each in sensors],
        [
            (a.gravity_compensation is None, a.missed_ticks > 0.0, a.servo, a.lag > 0.0, a.rate_limit is None)
            for a in actuators
        ],
        plant_reason(scenario.plant, scenario.cell, scenario.events),
    )
    return repr((_without_numbers(fields), common))


def _without_numbers(value: Any) -> Any:
    """Return a value without its floats, and without what runs of one code need not share."""
    if isinstance(value, Mapping):
        return {key: _without_numbers(each) for key, each in value.items() if key not in _NUMBERS_ALONE}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return list(map(_without_numbers, value))
    return "number" if isinstance(value, float) else value


@typed
def law_reason(law: Controller) -> str | None:
    """Return None if a law of the package can be traced, otherwise the reason why it cannot."""
    if {"model", "regressor"} & {*law.needs}:
        return f"its controller {law.kind!r} computes with a model of Pinocchio"
    return None


@typed
def plant_reason(plant: PlantOptions, cell: Cell, events: Sequence[PayloadEvent] = ()) -> str | None:
    """Return None if a plant can be traced, otherwise the reason why it cannot.

    Args:
        plant: Options of the plant.
        cell: Cell, whose grasps must be rigid or compliant.
        events: Events of the run.
    """
    for event in events:
        if event.requires:
            return f"its event {event.kind!r} needs {event.requires}; batches are compiled without"
    if cell.has_contacts:
        names = [*cell.patches, *cell.tables]
        return f"the contacts {names} have friction; the traced plant has rigid grasps and no tables"
    if cell.pads:
        return f"its pads {list(cell.pads)} have margins of friction, which batches do not compute"
    if plant.payload != "welded":
        return "its plant has a free payload; the traced one has it welded to the first arm"
    if plant.integrator != "rk4" or plant.project != "start":
        options = f"integrator {plant.integrator!r} and project {plant.project!r}"
        return f"its plant has {options}; the traced one has 'rk4' and 'start'"
    return None
