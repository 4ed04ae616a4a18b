"""Preparation of a batch: plants, numbers and references of its runs, and what they must share."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Hashable, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import CoopPinError, TracingError
from coop_pin.base.schema.parts import Filled, Pattern
from coop_pin.compiled.code_family import Cover, plant_reason
from coop_pin.compiled.constants import (
    RunConstants,
    changes,
    covered_constants,
    covered_drives,
    run_constants,
    start,
)
from coop_pin.compiled.laws.hidden_state import digest, of_classes
from coop_pin.compiled.laws.law_code import as_tracing_errors
from coop_pin.compiled.signals import RunSignals, clocked_of, columns, desired_of, first_of, squeezed
from coop_pin.control import CellController
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.description.trust import TrustThresholds
from coop_pin.results.quantities import QUANTITIES
from coop_pin.simulation.build_controller import controlled_arm
from coop_pin.simulation.devices.actuation import Actuation
from coop_pin.simulation.loop import start_configuration
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import SignalSource
from coop_pin.tracing.numpy_machine import evaluate
from coop_pin.tracing.tape import Tape, UntraceableError, operands
from coop_pin.tracing.traced_array import inputs
from coop_pin.tracing.tree import flattened, leaves

_NOT_OF_THE_PLANT = {"controller", "beyond_bound", "seed", "name", "summary", "trust"}
"""Fields of a scenario that do not make the plant; of the controller, its force path does."""
plant_fields = attrgetter("controller.force_path", *sorted({*Scenario.model_fields} - _NOT_OF_THE_PLANT))
"""What scenarios with one plant have in common, of a scenario."""
_UNLOADED = attrgetter(
    "controller.force_path",
    *sorted({*Scenario.model_fields} - _NOT_OF_THE_PLANT - {"cell", "events"}),
    *(f"cell.{name}" for name in Cell.model_fields if name != "payload"),
)
"""Fields of the plant besides the payload and the events."""
_MOTION, _SQUEEZE = attrgetter("motion", "clock", "duration", "network"), attrgetter("squeeze", "cell.grasps")
"""Fields on which the desired motion at the ticks depends, and further ones of the squeeze."""


class PreparedPlant:
    """Plant of one or more runs, before they run.

    Attributes:
        run: simulation of the first run, at its start.
        arms: numbers of the arms that controllers know.
        constants: numbers of the runs, without a controller.
        values: leaves of the constants, shape (leaves,).
        drives: memory of the drives at the start.
        begins: numbers of the fields of a block that the plant begins with, by name.
        desired: desired motion and squeeze at all ticks, of a long run at its first ones.
        example: signals of a tick.
        table: quantities of the runs.
        read: quantities that are recorded at ticks; runs with and without an error of the kinematics share a
            batch.
        labels: names and limits of arms and joints.
        kind: structure that runs of one code share besides numbers, the controller apart.
        times: times that the runs of a batch share.
    """

    def __init__(
        self,
        scenario: Scenario,
        most_ticks: int | None = None,
        cover: Cover | None = None,
        like: PreparedPlant | None = None,
    ) -> None:
        """Build the plant.

        Args:
            scenario: scenario of the first run.
            most_ticks: number of ticks of which desired motion and signals are made at first; None for all.
            cover: Provisions of the code; those that this run needs when None.
            like: Plant of another scenario, of which parts are taken over that are the same.

        Raises:
            TracingError: it cannot be traced.
            CoopPinError: the run cannot start.
        """
        if reason := plant_reason(scenario.plant, scenario.cell, scenario.events):
            raise TracingError(f"{scenario.name!r} cannot run in a batch: {reason}")
        self.run = Simulation(scenario)
        self.arms = [controlled_arm(scenario, arm) for arm in self.run.chain.arms]
        self._cover, self._needed = cover, run_constants(scenario, self.run)._replace(controller=None)
        fixed = self._needed.cell.arms, self._needed.arms, self._needed.sensors
        self._known = {id(part): flattened(part) for part in (*self.arms, *fixed)}
        structure = self._begin(scenario, self.run.plant, self.run.actuation)
        self.times = _times(scenario)
        self._last: tuple[Hashable, ...] = ()
        self._untraced = list[Hashable]()  # numbers whose controllers are built one by one
        ticks = range(self.run.timeline.ticks + 1)[:most_ticks]
        if like is None or _MOTION(like.run.scenario) != _MOTION(scenario):
            self.desired, self._clocked = desired_of(self.run, ticks), clocked_of(self.run, ticks)
        else:
            self.desired, self._clocked = like.desired, like._clocked
            if _SQUEEZE(like.run.scenario) != _SQUEEZE(scenario):
                self.desired = squeezed(self.desired, self.run)
                self._clocked = tuple(each and squeezed(each, self.run) for each in self._clocked)
        self._source = SignalSource(scenario, self.run.slots)
        drawn = RunSignals(self.desired, self._source.draw(len(self.desired.time)), self._clocked)
        self.example, self._signals = first_of(drawn), {scenario.seed: columns(drawn)}
        self.table = self.run.recorder.table
        self.read = [each for each in QUANTITIES if each in self.table or each.group == "kinematics"]
        self.labels = self.run.recorder.labels()
        names, samples = tuple(each.name for each in self.read), tuple(self.constants.drives.samples())
        self.kind = structure, tuple(scenario.cell.arms), names, samples

    def _begin(self, scenario: Scenario, plant: Plant, actuation: Actuation) -> Hashable:
        """Set the numbers of a run and its start; return the structure of the numbers."""
        constants, self.drives, cover = self._needed, actuation.state, self._cover
        if cover is not None:
            constants = covered_constants(cover, constants, scenario, self.run.timeline)
            self.drives = covered_drives(self.drives, constants)
        self.constants, (numbers, structure) = constants, flattened(constants, self._known)
        self.values = np.array(numbers, dtype=np.float64)
        others = {"drives": self.drives, "surroundings": constants.changes[0]}
        begins = start(plant, self.run.slots, actuation, self.run.sensing) | others
        self.begins = {name: leaves(part) for name, part in begins.items()}
        return structure

    def carrying(self, scenario: Scenario, cover: Cover | None) -> PreparedPlant | None:
        """Return the plant of a scenario with another payload in rigid grasps, or other numbers of events.

        The simulation of this plant serves for what they share, and its tree carries the other payload from
        then on. None where more may differ.

        Args:
            scenario: Scenario of the plant.
            cover: Provisions of the code.
        """
        run, cell = self.run, scenario.cell
        if scenario.controller.user_code or cell.has_force_elements or cover != self._cover:
            return None
        is_alike = _times(scenario) == self.times and _UNLOADED(scenario) == _UNLOADED(run.scenario)
        if not is_alike or _kinds(scenario) != _kinds(run.scenario):
            return None
        prepared, chain = copy.copy(self), run.chain.carrying(cell)
        plant = PinocchioPlant(chain, scenario.plant, start_configuration(chain, scenario))
        actuation = Actuation(scenario, plant, run.slots, chain.arms, chain.loads(plant.q))
        prepared._needed = self._needed._replace(
            cell=self._needed.cell._replace(surroundings=cell.surroundings),
            drives=actuation.drives,
            changes=changes(scenario, run.timeline),
        )
        structure = prepared._begin(scenario, plant, actuation)
        return prepared if structure == self.kind[0] else None

    @property
    def determined(self) -> Mask:
        """Rows of the interaction wrenches that are determinate; see RigidGrasps."""
        return self.run.recorder.determined

    @as_tracing_errors()
    def with_controller(self, scenario: Scenario) -> tuple[CellController, Array, tuple[Hashable, ...]]:
        """Return the controller of a run of this plant, the numbers of both, and the family of the run.

        Raises:
            TracingError: The controller cannot be traced.
            CoopPinError: It cannot be built.
        """
        controller = scenario.controller.build(scenario, self.arms)
        self.run.actuation.require_taken(controller)
        numbers, structure = flattened(controller, self._known)
        kind = self.kind, structure, _surroundings(scenario)
        self._last = self._last if kind == self._last else kind  # the same object: no more to compare
        return controller, np.concatenate((self.values, np.array(numbers, dtype=np.float64))), self._last

    def columns(self, pattern: Pattern, numbers: Array, structure: Hashable) -> Array | None:
        """Return the numbers of the controllers of runs of this plant, shape (runs, leaves), by tracing one.

        None where the building cannot be traced, or may round otherwise than traced code.

        Args:
            pattern: Pattern of the scenarios, which differ in their controllers.
            numbers: Their numbers in it, shape (runs, numbers).
            structure: Structure of the controllers.
        """
        if (untraced := (pattern.names, structure)) in self._untraced:
            return None
        tape = Tape()
        try:
            scenario = pattern.filled([inputs(tape) for _ in pattern.names])
            entries, traced = flattened(scenario.controller.build(scenario, self.arms), self._known)
            outputs = operands(tape, entries)
            is_alike = traced == structure and tape.rounds_alike(outputs)
        except (CoopPinError, UntraceableError, TypeError, ValueError, AttributeError):
            is_alike = False
        if not is_alike:
            self._untraced.append(untraced)
            return None
        columns = np.empty((len(outputs), len(numbers)))
        for column, value in zip(columns, evaluate(tape, outputs, list(numbers.T)), strict=True):
            column[:] = value
        return columns.T

    def signals(self, scenario: Scenario) -> Array:
        """Return the signals of a run of this plant at the ticks of ``desired``, shape (n, entries)."""
        if scenario.seed not in self._signals:
            drawn = SignalSource(scenario, self.run.slots).draw(len(self.desired.time))
            kept = columns(RunSignals(self.desired, drawn, self._clocked))
            self._signals = {scenario.seed: kept}  # those of one seed
        return self._signals[scenario.seed]

    def later(self, ticks: range) -> tuple[PreparedPlant, Array]:
        """Return the plant with the desired motion of the ticks that come next, and their signals."""
        plant = copy.copy(self)
        plant.desired = desired_of(self.run, ticks)
        drawn = self._source.draw(len(ticks))
        return plant, columns(RunSignals(plant.desired, drawn, clocked_of(self.run, ticks)))


class Prepared(NamedTuple):
    """Batch before it runs.

    Attributes:
        scenarios: scenarios to run.
        plants: plant of each; runs with equal plants share one.
        signals: signals of each at the ticks of its plant's desired motion, shape (n, entries).
        controller: function that returns the controller of the first run.
        values: leaves of the constants, the controller's last, shape (runs, leaves).
        kind: family of the runs: what they share besides numbers and times.
        trust: trust thresholds of each.
    """

    scenarios: Sequence[Scenario]
    plants: Sequence[PreparedPlant]
    signals: Sequence[Array]
    controller: Callable[[], CellController]
    values: Array
    kind: tuple[Hashable, ...]
    trust: Sequence[TrustThresholds]

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
        values = (self.signals[runs], controller, self.values[runs], self.kind, self.trust[runs])
        return Prepared(scenarios, plants, *values)

    def loaded(self, first: Prepared) -> Mask:
        """Return which signals of some run are not those of a first one, shape (entries,)."""
        others = {id(signals): signals for signals in self.signals}.values()
        return np.any([(signals != first.signals[0]).any(axis=0) for signals in others], axis=0)

    @property
    def times(self) -> Hashable:
        """Times that the runs share."""
        return self.plants[0].times

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
        if law.user_code and self.kind[-1] != _surroundings(self.scenarios[0]):
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
        signals, trust = [plant.signals(scenario)], [scenario.trust]
        return cls([scenario], [plant], signals, lambda: controller, values[None], kind, trust)

    def alike(self, scenarios: Filled) -> Prepared | None:
        """Return runs that begin with this one and differ from it in numbers of the law.

        Args:
            scenarios: Scenarios of the runs.

        Returns:
            The runs; None where they may differ in more.
        """
        (plant,), count = self.plants, len(scenarios)
        law = plant.columns(scenarios.pattern, np.array(scenarios.rows, dtype=np.float64), self.kind[1])
        if law is None:
            return None
        return self._replace(
            scenarios=scenarios,
            plants=[plant] * count,
            signals=[*self.signals] * count,
            values=np.concatenate((np.broadcast_to(plant.values, (count, plant.values.size)), law), axis=1),
            trust=[*self.trust] * count,
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
            if (run.kind, run.times) != (first.kind, first.times):
                raise TracingError(f"scenarios[{index}] differs from the first in more than numbers")
        values = np.concatenate([run.values for run in runs])
        scenarios, plants, signals, trust = (
            [*itertools.chain.from_iterable(parts)]
            for parts in zip(
                *((run.scenarios, run.plants, run.signals, run.trust) for run in runs), strict=True
            )
        )
        return cls(scenarios, plants, signals, first.controller, values, first.kind, trust)


def _surroundings(scenario: Scenario) -> str:
    """Return a digest of what a user's law may read besides its object and its arguments."""
    return digest(of_classes(scenario.controller.user_code))


def _kinds(scenario: Scenario) -> list[str]:
    """Return the kinds of events."""
    return [event.kind for event in scenario.events]


def _times(scenario: Scenario) -> Hashable:
    """Return ticks and samples of servos, and events and losses of torque by their times."""
    times = [(event.time, event.end) for event in scenario.events]
    actuators = [scenario.actuators_of(arm) for arm in scenario.cell.arms]
    lost = [(each.torque_lost_at, each.commands_lost_at) for each in actuators]
    rates, clock = [each.servo and each.servo.rate_hz for each in actuators], scenario.clock
    ticks = clock.rate_hz, clock.steps_per_tick, clock.record_every, scenario.duration
    return (*ticks, str(times), str(lost), str(rates))
