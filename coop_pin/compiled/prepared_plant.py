"""Plant of one or more runs before they run: its numbers and those of controllers, its start, its signals."""

from __future__ import annotations

import copy
from collections.abc import Hashable
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import CoopPinError, TracingError
from coop_pin.base.schema.parts import Pattern
from coop_pin.compiled.constants import (
    DesiredSource,
    RunSignals,
    changes,
    columns,
    covered_constants,
    covered_drives,
    first_of,
    run_constants,
    start,
)
from coop_pin.compiled.kind import (
    Cover,
    Kind,
    motion_fields,
    plant_reason,
    squeeze_fields,
    surroundings_of,
    times_of,
    unloaded_fields,
)
from coop_pin.compiled.laws.law_code import as_tracing_errors
from coop_pin.control import CellController
from coop_pin.description.scenario import Scenario
from coop_pin.results.quantities import QUANTITIES
from coop_pin.simulation.build_controller import controlled_arm
from coop_pin.simulation.devices.actuation import Actuation
from coop_pin.simulation.loop import start_configuration
from coop_pin.simulation.pinocchio_plant import PinocchioPlant
from coop_pin.simulation.plant import Plant
from coop_pin.simulation.simulation import Simulation
from coop_pin.simulation.tick import SignalSource
from coop_pin.tracing.evaluation import evaluate
from coop_pin.tracing.tape import Tape, UntraceableError, operands
from coop_pin.tracing.traced_array import inputs
from coop_pin.tracing.tree import flattened, leaves


class PreparedPlant:
    """Plant of one or more runs, before they run.

    Attributes:
        scenario: scenario of the first run.
        timeline: timeline of the runs.
        actuation: drives of the runs.
        slots: places of the arms in the cell's model.
        arms: numbers of the arms that controllers know.
        constants: numbers of the runs, without a controller.
        values: leaves of the constants, shape (leaves,).
        drives: memory of the drives at the start.
        begins: numbers of the fields of a block that the plant begins with, by name.
        source: source of the desired motion.
        desired: desired motion and squeeze at all ticks, of a long run at its first ones.
        example: signals of a tick.
        table: quantities of the runs.
        read: quantities that are recorded at ticks; runs with and without an error of the kinematics share a
            batch.
        labels: names and limits of arms and joints.
        determined: mask of the rows of the interaction wrenches that are determinate; see RigidGrasps.
        of_springs: function that gives quantities of compliant grasps to the arms that have them.
        kind: kind of the runs, without a law.
    """

    def __init__(
        self,
        scenario: Scenario,
        most_ticks: int | None = None,
        cover: Cover | None = None,
        like: PreparedPlant | None = None,
        simulation: Simulation | None = None,
    ) -> None:
        """Build the plant.

        Args:
            scenario: scenario of the first run.
            most_ticks: number of ticks of which desired motion and signals are made at first; None for all.
            cover: Provisions of the code; those that this run needs when None.
            like: Plant of another scenario, of which parts are taken over that are the same.
            simulation: run of the scenario by Pinocchio before its first tick; a new one when None.

        Raises:
            TracingError: it cannot be traced.
            CoopPinError: the run cannot start.
        """
        if reason := plant_reason(scenario.plant, scenario.cell, scenario.events):
            raise TracingError(f"{scenario.name!r} cannot run in a batch: {reason}")
        run = simulation or Simulation(scenario)
        self.scenario, self.timeline, self._sensing = scenario, run.timeline, run.sensing
        self._chain = chain = run.chain  # read while a plant is built, with that plant's payload
        self.slots, self.of_springs = run.slots, chain.springs.of_arms
        self.arms = [controlled_arm(scenario, arm) for arm in chain.arms]
        self.table, self.labels = run.recorder.table, run.recorder.labels()
        self.determined = run.recorder.determined
        self.read = [each for each in QUANTITIES if each in self.table or each.group == "kinematics"]
        self._cover, needed = cover, run_constants(scenario, run)._replace(controller=None)
        fixed = needed.cell.arms, needed.arms, needed.sensors
        self._known = {id(part): flattened(part) for part in (*self.arms, *fixed)}
        self._begin(needed, run.plant, run.actuation)
        self._last = self.kind
        self._untraced = list[Hashable]()  # numbers whose controllers are built one by one
        self.source = DesiredSource(scenario, run.motion, run.timeline)
        ticks = range(run.timeline.ticks + 1)[:most_ticks]
        if like is None or motion_fields(like.scenario) != motion_fields(scenario):
            self.desired, self._clocked = self.source.desired(ticks), self.source.clocked(ticks)
        else:
            self.desired, self._clocked = like.desired, like._clocked
            if squeeze_fields(like.scenario) != squeeze_fields(scenario):
                self.desired = self.source.squeezed(self.desired)
                self._clocked = tuple(each and self.source.squeezed(each) for each in self._clocked)
        self._drawn = SignalSource(scenario, self.slots)
        drawn = RunSignals(self.desired, self._drawn.draw(len(self.desired.time)), self._clocked)
        self.example, self._signals = first_of(drawn), {scenario.seed: columns(drawn)}

    def _begin(self, needed: Any, plant: Plant, actuation: Actuation) -> None:
        """Set the numbers of the scenario's run, its start and its kind.

        Args:
            needed: Constants that the run needs.
            plant: Plant at the start.
            actuation: Drives at the start.
        """
        constants, self.drives, cover, scenario = needed, actuation.state, self._cover, self.scenario
        if cover is not None:
            constants = covered_constants(cover, constants, scenario, self.timeline)
            self.drives = covered_drives(self.drives, constants)
        self._needed, self.actuation, self.constants = needed, actuation, constants
        numbers, structure = flattened(constants, self._known)
        self.values = np.array(numbers, dtype=np.float64)
        others = {"drives": self.drives, "surroundings": constants.changes[0]}
        begins = start(plant, self.slots, actuation, self._sensing) | others
        self.begins = {name: leaves(part) for name, part in begins.items()}
        names, samples = tuple(each.name for each in self.read), tuple(constants.drives.samples())
        self.kind = Kind((structure, tuple(scenario.cell.arms), names, samples), times=times_of(scenario))

    def carrying(self, scenario: Scenario, cover: Cover | None) -> PreparedPlant | None:
        """Return the plant of a scenario with another payload in rigid grasps, or other numbers of events.

        It is built on the tree of this one. None where more may differ.

        Args:
            scenario: Scenario of the plant.
            cover: Provisions of the code.
        """
        cell, base = scenario.cell, self.scenario
        if scenario.controller.user_code or cell.has_force_elements or cover != self._cover:
            return None
        kinds = [[event.kind for event in each.events] for each in (scenario, base)]
        has_times = kinds[0] == kinds[1] and times_of(scenario) == self.kind.times
        if not has_times or unloaded_fields(scenario) != unloaded_fields(base):
            return None
        prepared, chain = copy.copy(self), self._chain.carrying(cell)
        plant = PinocchioPlant(chain, scenario.plant, start_configuration(chain, scenario))
        actuation = Actuation(scenario, plant, self.slots, chain.arms, chain.loads(plant.q))
        prepared.scenario, prepared._chain = scenario, chain
        prepared.source = self.source._replace(scenario=scenario)
        needed = self._needed._replace(
            cell=self._needed.cell._replace(surroundings=cell.surroundings),
            drives=actuation.drives,
            changes=changes(scenario, self.timeline),
        )
        prepared._begin(needed, plant, actuation)
        return prepared if prepared.kind == self.kind else None

    @as_tracing_errors()
    def with_controller(self, scenario: Scenario) -> tuple[CellController, Array, Kind]:
        """Return the controller of a run of this plant, the numbers of both, and the kind of the run.

        Raises:
            TracingError: The controller cannot be traced.
            CoopPinError: It cannot be built.
        """
        controller = scenario.controller.build(scenario, self.arms)
        self.actuation.require_taken(controller)
        numbers, structure = flattened(controller, self._known)
        surroundings = surroundings_of(scenario.controller)
        kind = Kind(self.kind.plant, structure, surroundings, self.kind.times)  # _replace takes longer
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
            drawn = SignalSource(scenario, self.slots).draw(len(self.desired.time))
            kept = columns(RunSignals(self.desired, drawn, self._clocked))
            self._signals = {scenario.seed: kept}  # those of one seed
        return self._signals[scenario.seed]

    def later(self, ticks: range) -> tuple[PreparedPlant, Array]:
        """Return the plant with the desired motion of the ticks that come next, and their signals."""
        plant = copy.copy(self)
        plant.desired = self.source.desired(ticks)
        drawn = self._drawn.draw(len(ticks))
        return plant, columns(RunSignals(plant.desired, drawn, self.source.clocked(ticks)))
