"""Ticks of a run: signals of all its parts, for both engines, references, and inputs of a controller."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.spatial.task_rows import TaskRows
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.description.cell.grasp_plan import GraspPlan
from coop_pin.description.grasp_events import MissedGrasp
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_model import ArmPlace
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, retreated
from coop_pin.reference.squeeze import SqueezeReference
from coop_pin.simulation.devices.network import MessageSignals, NetworkSignals
from coop_pin.simulation.devices.signals import CellSignals, SensorSignals, missed_ticks
from coop_pin.simulation.timeline import Timeline

_LARGEST_BLOCK = 1024
"""Ticks whose signals a single run draws at once, at most."""


class TickSignals(NamedTuple):
    """Signals of a run at n ticks, or without the first axis at one.

    Attributes:
        sensors: signals of the sensors.
        missed: whether each arm misses the command, masks, shape (n, m).
        network: timing of the messages; empty without a network.
    """

    sensors: CellSignals
    missed: Any
    network: NetworkSignals | tuple[()]

    def ticks(self) -> Iterator[TickSignals]:
        """Return the signals of one tick after the other."""
        network = self.network.ticks() if self.network else itertools.repeat(())
        return map(TickSignals, self.sensors.ticks(), self.missed.tolist(), network)


class TickInputs(NamedTuple):
    """What a controller gets at a tick, and what the cell is to do then.

    Attributes:
        measurements: measurement of each arm.
        references: reference of each arm.
        target: desired motion of the payload.
        squeeze: desired internal wrench of each arm about P in payload axes, N and N m, shape (m, 6).
        signals: errors of the sensors, and what is late or lost.
    """

    measurements: list[ArmMeasurement]
    references: list[ArmReference]
    target: PoseTarget
    squeeze: Array
    signals: TickSignals


class SignalSource:
    """Source of the signals of a run, drawn in blocks of ticks that follow each other."""

    def __init__(self, scenario: Scenario, arms: Sequence[ArmPlace]) -> None:
        """Begin before the first tick.

        Args:
            scenario: Scenario with sensors, actuators, network and seed.
            arms: Positions of the arms in the cell's model.
        """
        self._sensors = SensorSignals(scenario, [len(arm.drive) for arm in arms])
        self._missed = [missed_ticks(scenario, arm.name) for arm in arms]
        self._network = None if scenario.network is None else MessageSignals(scenario)
        may_miss = any(scenario.actuators_of(arm.name).missed_ticks for arm in arms)
        self._vary = self._sensors.vary or may_miss or self._network is not None

    def draw(self, count: int) -> TickSignals:
        """Return the signals of the next ticks."""
        network = () if self._network is None else self._network.draw(count)
        missed = np.stack([draw(count) for draw in self._missed], axis=1)
        return TickSignals(self._sensors.draw(count), missed, network)

    def rows(self, skipped: int = 0) -> Iterator[TickSignals]:
        """Return the signals of one tick after the other, those of some skipped."""
        self.draw(skipped)
        return self._in_blocks() if self._vary else itertools.repeat(next(self.draw(1).ticks()))

    def _in_blocks(self) -> Iterator[TickSignals]:
        """Yield rows of blocks that grow: a run may end, or another one begin, at any tick."""
        count = 1
        while True:
            yield from self.draw(count).ticks()
            count = min(2 * count, _LARGEST_BLOCK)


CellReference: TypeAlias = tuple[list[ArmReference], PoseTarget, Array, GraspPlan | None]
"""Reference of each arm, desired motion of the payload, desired internal wrench of each arm about P in
payload axes, N and N m, shape (m, 6), and the plan of the grasps, if they have events."""


class References:
    """References of the arms of a run at any time.

    Attributes:
        clocks: clocks of arms that are off, by the index of the arm.
    """

    def __init__(self, scenario: Scenario, timeline: Timeline) -> None:
        """Take clocks, grasps and their events from a scenario and its timeline."""
        self._scenario, self._timeline, self._rows = scenario, timeline, scenario.cell.task_rows
        self.clocks, self._has_plan = scenario.clocks, scenario.has_grasp_plan or bool(scenario.cell.tools)

    def at(
        self, time: float, motion: PoseReference, squeeze: SqueezeReference, missed: Sequence[MissedGrasp]
    ) -> CellReference:
        """Return what the cell is to do at a time, s; arms whose clocks are off follow what these show.

        Args:
            time: Time, s.
            motion: Desired motion.
            squeeze: Desired internal wrenches.
            missed: Grasps that did not happen.
        """
        desired = self._exact(time, motion, squeeze, missed)
        for index, clock in self.clocks.items():
            shown, *_ = self._exact(clock.reading(time), motion, squeeze, missed)
            desired[0][index] = shown[index]
        return desired

    def _exact(
        self, time: float, motion: PoseReference, squeeze: SqueezeReference, missed: Sequence[MissedGrasp]
    ) -> CellReference:
        """Return what the cell is to do if all clocks show the time."""
        cell, target = self._scenario.cell, motion.at(time)
        wrenches = squeeze.at(time, cell.grasps)
        if not self._has_plan:
            return arm_references(self._rows, target, wrenches), target, wrenches, None
        just_after, events = self._timeline.just_after(time), [each.event for each in missed]
        plan = self._scenario.grasp_plan_at(just_after, events)
        wrenches = plan.squeeze(wrenches)
        references: list[ArmReference] = []
        arms = zip(cell.grasps, plan.carried.tolist(), plan.retreats, strict=True)
        for index, (name, share, retreat) in enumerate(arms):
            moved = retreated(cell.target_of(name, target, time), cell.way_out(name), retreat)
            (reference,) = arm_references(self._rows, moved, wrenches[index : index + 1])
            references.append(reference._replace(load_share=share))
        return references, target, wrenches, plan


def arm_references(rows: TaskRows, target: PoseTarget, squeeze: Iterable[Array]) -> list[ArmReference]:
    """Return the reference of each arm.

    Args:
        rows: Task rows of the cell.
        target: Desired motion of the payload.
        squeeze: Desired internal wrench of each arm about P in payload axes, shape (6,) each.
    """
    X, V, A = target
    pose, twist, acceleration = frozen(X), frozen(rows.select(V)), frozen(rows.select(A))
    return [ArmReference(pose, twist, acceleration, frozen(rows.select(wrench))) for wrench in squeeze]
