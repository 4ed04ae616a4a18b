"""Kinds of runs: what runs of one compiled code share, what the code provides, and what it does not have."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, NamedTuple, Self

from coop_pin.base.arrays import Array, typed
from coop_pin.control.hidden_state import digest, of_classes
from coop_pin.description.cell.cell import Cell
from coop_pin.description.controller import Controller
from coop_pin.description.events import PayloadEvent
from coop_pin.description.plant import PlantOptions
from coop_pin.description.scenario import Scenario

_COVERED = "sensors", "arm_sensors", "actuators", "arm_actuators", "events"
"""Fields of which code provides what any of its runs needs; see Cover."""
_NUMBERS_ALONE = {"friction", "clock", "duration", *_COVERED}
"""Fields that runs of one code need not share; ``Kind.of_scenario`` adds what they must."""
_NOT_OF_THE_PLANT = {"controller", "beyond_bound", "seed", "name", "summary", "trust", "task"}
"""Fields of a scenario that do not make the plant; of the controller, its force path does."""
_OF_THE_PLANT = {*Scenario.model_fields} - _NOT_OF_THE_PLANT
plant_fields = attrgetter("controller.force_path", *sorted(_OF_THE_PLANT))
"""What scenarios with one plant have in common, of a scenario."""
unloaded_fields = attrgetter(
    "controller.force_path",
    *sorted(_OF_THE_PLANT - {"cell", "events"}),
    *(f"cell.{name}" for name in Cell.model_fields if name != "payload"),
)
"""What scenarios have in common whose plants differ in the payload, or in events."""
motion_fields = attrgetter("motion", "clock", "duration", "network")
"""Fields on which the desired motion at the ticks depends."""
squeeze_fields = attrgetter("squeeze", "cell.grasps")
"""Further fields on which the squeeze at the ticks depends."""


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
        """Return what some scenarios need together; the same objects are looked at once."""
        different = {tuple(map(id, attrgetter(*_COVERED)(each))): each for each in scenarios}
        delays, responds, changed, instants = zip(*map(cls.of, different.values()), strict=True)
        return cls(max(delays), any(responds), frozenset().union(*changed), max(instants))


class Kind(NamedTuple):
    """Kind of a run: what runs share that one code computes together, numbers apart.

    Runs of one code may differ in numbers, in rates, times and events, and in what a Cover provides; those of
    one batch have the same times as well.

    Attributes:
        plant: structure of the numbers of plant, sensors and drives, and names of what is recorded.
        law: structure of the numbers of the controller.
        surroundings: digest of what a user's law may read besides its object and its arguments.
        times: ticks, samples of servos, events and losses of torque by their times.
        lane: times and digest of the signals of a run that has an order of kernels of its own; empty in a
            batch.
    """

    plant: Hashable
    law: Hashable = ()
    surroundings: str = ""
    times: Hashable = ()
    lane: Hashable = ()

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Self:
        """Return the kind as far as a scenario shows it, before its run is prepared, without times."""
        fields = scenario.model_dump(exclude={"name", "summary", "seed", "trust", "task", "controller"})
        sensors = map(scenario.sensors_of, scenario.cell.arms)
        actuators = map(scenario.actuators_of, scenario.cell.arms)
        common = (
            [(each.wrist is None, each.joints_are_ideal, each.velocity.kind) for each in sensors],
            [
                (
                    a.gravity_compensation is None,
                    a.missed_ticks > 0.0,
                    a.servo,
                    a.lag > 0.0,
                    a.rate_limit is None,
                )
                for a in actuators
            ],
            plant_reason(scenario.plant, scenario.cell, scenario.events),
        )
        law = _without_numbers(scenario.controller.model_dump())
        return cls(repr((_without_numbers(fields), common)), repr(law))

    def __hash__(self) -> int:
        """Return a hash that takes no time: that of the structures takes longer than a run's preparation."""
        return hash((self.surroundings, self.times))

    @property
    def code(self) -> Self:
        """Kind of the code: without the times."""
        return self._replace(times=())

    def alone(self, signals: Array) -> Self:
        """Return the kind of a run whose signals and times no other run shares."""
        return self._replace(lane=(self.times, hashlib.sha256(signals.tobytes()).digest()))


def surroundings_of(law: Controller) -> str:
    """Return a digest of what a user's law may read besides its object and its arguments."""
    return digest(of_classes(law.user_code)) if law.user_code else ""


def times_of(scenario: Scenario) -> Hashable:
    """Return the times of a kind."""
    times = [(event.time, event.end) for event in scenario.events]
    actuators = [scenario.actuators_of(arm) for arm in scenario.cell.arms]
    lost = [(each.torque_lost_at, each.commands_lost_at) for each in actuators]
    rates, clock = [each.servo and each.servo.rate_hz for each in actuators], scenario.clock
    ticks = clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration
    return (*ticks, str(times), str(lost), str(rates))


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
    """Return None if the plant of lanes can be compiled, otherwise the reason why it cannot.

    Args:
        plant: Options of the plant.
        cell: Cell, whose grasps must be rigid or compliant.
        events: Events of the run.
    """
    for event in events:
        if event.requires:
            return f"its event {event.kind!r} needs {event.requires}, which compiled code does not have"
    if cell.tools:
        return f"the tips of {list(cell.tools)} are tools, which compiled plants do not have"
    if cell.payload.links is not None:
        return f"its payload has joints {[*cell.payload.links.start]}, which compiled plants do not have"
    if cell.jointed:
        return f"the grasps of {list(cell.jointed)} are joints; compiled plants have springs and rigid grasps"
    if cell.shared_joints:
        return f"its shared joints {list(cell.shared_joints)} have drives, which compiled plants do not have"
    if cell.wheels:
        return f"the bases of {list(cell.wheels)} roll on wheels, which compiled plants do not have"
    if cell.has_contacts:
        names = [*cell.patches, *cell.tables]
        return f"the contacts {names} have friction; compiled plants have springs and rigid grasps"
    if cell.pads:
        return f"its pads {list(cell.pads)} have margins of friction, which compiled code does not compute"
    if plant.payload != "welded":
        return "its plant has a free payload; compiled ones have it welded to the first arm"
    if plant.integrator != "rk4" or plant.project != "start":
        options = f"integrator {plant.integrator!r} and project {plant.project!r}"
        return f"its plant has {options}; compiled ones have 'rk4' and 'start'"
    return None


def pinocchio_reason(scenario: Scenario) -> str | None:
    """Return None if a run can have a compiled plant, otherwise the reason why only Pinocchio has it."""
    events = [event for event in scenario.events if event.needs_pinocchio(scenario.cell)]
    return plant_reason(scenario.plant, scenario.cell, events)
