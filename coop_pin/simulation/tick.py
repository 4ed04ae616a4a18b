"""Ticks of a run: the signals of all its parts, for both engines, and what a controller gets."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control import ArmMeasurement, ArmReference
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_model import ArmPlace
from coop_pin.reference.pose_reference import PoseTarget
from coop_pin.simulation.devices.network import MessageSignals, NetworkSignals
from coop_pin.simulation.devices.signals import CellSignals, SensorSignals, missed_ticks

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
