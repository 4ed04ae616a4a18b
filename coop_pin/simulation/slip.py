"""Slip of patches as the controllers get it: noisy, delayed, the largest of those that hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import SlipSensor
from coop_pin.simulation.signals import generator


class SlipSensors(NamedTuple):
    """Sensors of all patches: ``s[k] = slip(t_{k-D}) + noise``; its memory are the readings, newest first.

    Attributes:
        noise: standard deviations, m, shape (p,).
        delay: D, ticks, shape (p,).
    """

    noise: Array
    delay: Array

    @classmethod
    def of(cls, scenario: Scenario) -> SlipSensors:
        """Return the sensors of the arms with patches."""
        sensors = [scenario.sensors_of(name).slip or SlipSensor() for name in scenario.cell.patches]
        return cls(
            np.array([one.noise for one in sensors]), np.array([one.delay for one in sensors], dtype=int)
        )

    def start(self) -> Array:
        """Return the memory before the first reading: nothing has slid, shape (d, p)."""
        return np.zeros((int(self.delay.max(initial=0)) + 1, len(self.noise)))

    def step(self, memory: Array, slips: Array, errors: Array, holds: Mask) -> tuple[float, Array]:
        """Return the largest reading of patches whose arms hold, m, and the memory.

        Args:
            memory: Readings before.
            slips: Slip of each patch, m, shape (p,).
            errors: Standard normal numbers, shape (p,).
            holds: Arms that hold, shape (p,).
        """
        memory = np.vstack((slips + self.noise * errors, memory[:-1]))
        readings = memory[self.delay, np.arange(len(slips))]
        return float(readings[holds].max(initial=0.0)), memory


def slip_errors(scenario: Scenario, ticks: int) -> Iterator[Array]:
    """Yield standard normal numbers for the patches, shape (p,), tick by tick after a number of ticks."""
    sources = [generator(scenario.seed, f"{name}/slip") for name in scenario.cell.patches]
    for source in sources:
        source.standard_normal(ticks)
    while True:
        yield np.array([source.standard_normal() for source in sources])
