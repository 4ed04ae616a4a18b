"""Signals of a run: all that depends on time and chance only, for blocks of successive ticks.

Errors of sensors, missed ticks, and when samples arrive and how old they are. Every source of noise has a
generator of its own, derived from the scenario's seed by the name of the source.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import rotate_vector6, shift_wrench
from coop_pin.description.plant import Clock
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import WristSensor

EARLY = 1e-9
"""A tick this part of a period before an instant is at the instant."""


def generator(seed: int, source: str) -> np.random.Generator:
    """Return the random generator of a source, independent of those of all other names and seeds.

    Adding a source does not change what another one draws.

    Args:
        seed: Seed of the scenario, not negative.
        source: Name of the source, for example "left/encoder".
    """
    name = int.from_bytes(hashlib.sha256(source.encode()).digest()[:16], "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence((seed, name))))


class ArmSignals(NamedTuple):
    """Signals of one arm at n ticks, or without the first axis at one; masks are 0.0 or 1.0.

    Attributes:
        encoder_noise: noise of the drives' encoders, rad, shape (n, k).
        wrist_error: error of a wrist sample about P in payload axes, N and N m, shape (n, 6).
        wrist_arrived: whether a sample of the wrist arrives that does not repeat the last, shape (n,).
        wrist_age: age of the newest sample that has arrived, ticks, inf before the first, shape (n,).
    """

    encoder_noise: Array
    wrist_error: Array
    wrist_arrived: Any
    wrist_age: Any


class CellSignals(NamedTuple):
    """Signals of all arms at n ticks, or without the first axis at one.

    Attributes:
        arms: signals of each arm.
        arrived: whether an internal wrench arrives at the controllers, a mask, shape (n,).
        age: age of the newest that has arrived, ticks, inf before the first, shape (n,).
        slip_noise: noise of the sensors of slip, m, shape (n, p).
    """

    arms: tuple[ArmSignals, ...]
    arrived: Any
    age: Any
    slip_noise: Any

    def ticks(self) -> Iterator[CellSignals]:
        """Return the signals of one tick after the other."""
        arms = [
            map(ArmSignals, *(part if part.ndim > 1 else part.tolist() for part in signals))
            for signals in self.arms
        ]
        others = (part.tolist() for part in (self.arrived, self.age, self.slip_noise))
        return map(CellSignals, zip(*arms, strict=True), *others)


class Sampling(NamedTuple):
    """Ticks at which a wrist sensor takes samples, and their delay.

    Attributes:
        every: ticks from one sample to the next.
        delay: ticks until the controller has a sample.
        lost: ticks [first, end) without samples, the latest interval first.
    """

    every: int
    delay: int
    lost: tuple[tuple[int, int], ...]

    @classmethod
    def of_sensor(cls, sensor: WristSensor, clock: Clock) -> Sampling:
        """Return the sampling of a sensor."""
        first, end = (
            [math.ceil(interval[side] / clock.period - EARLY) for interval in sensor.lost] for side in (0, 1)
        )
        lost = sorted(zip(first, end, strict=True), reverse=True)
        return cls(clock.ticks_between(sensor.rate_hz), sensor.delay, tuple(lost))

    def newest(self, ticks: Array) -> Array:
        """Return the tick of the newest sample that has arrived by each tick, -inf for none."""
        newest = (ticks - self.delay) // self.every * self.every
        for first, end in self.lost:
            before = (first - 1) // self.every * self.every
            newest = np.where((first <= newest) & (newest < end), before, newest)
        return np.where(newest >= 0.0, newest, -np.inf)


class SensorSignals:
    """Source of the signals of a run's sensors, drawn in blocks of ticks that follow each other.

    Attributes:
        vary: whether they differ from tick to tick.
    """

    def __init__(self, scenario: Scenario, joints: Sequence[int]) -> None:
        """Begin before the first tick.

        Args:
            scenario: Cell, sensors, clock and seed.
            joints: Number of each arm's drives.
        """
        self._clock, self.vary, arms = scenario.clock, False, list(scenario.cell.arms)
        sensors = [scenario.sensors_of(name).wrist for name in arms]
        self._has_wrist = [sensor is not None for sensor in sensors]
        self._wrists = [sensor or WristSensor() for sensor in sensors]
        self._sampling = [Sampling.of_sensor(wrist, scenario.clock) for wrist in self._wrists]
        self._grasps = [scenario.cell.grasps[name].matrix for name in arms]
        path = scenario.controller.force_path
        self._path_delay = path.delay if path.by_sensors else None
        self._encoder_noise = [
            self._normal(scenario, f"{name}/encoder", np.array(scenario.sensors_of(name).encoder.noise), size)
            for name, size in zip(arms, joints, strict=True)
        ]
        self._wrist_noise = [
            self._normal(scenario, f"{name}/wrist", wrist.noise.vector6, 6)
            for name, wrist in zip(arms, self._wrists, strict=True)
        ]
        self._slip_noise = [
            self._normal(scenario, f"{name}/slip", np.array(sensor.noise if sensor else 0.0), 1)
            for name in scenario.cell.patches
            for sensor in (scenario.sensors_of(name).slip,)
        ]
        self.vary |= any(self._has_wrist) or path.by_sensors
        self._tick = 0

    def _normal(self, scenario: Scenario, source: str, deviation: Array, size: int) -> Callable[[int], Array]:
        """Return a function that draws rows of Gaussian noise, shape (count, size)."""
        if not deviation.any():
            return lambda count: np.zeros((count, size))
        rng, self.vary = generator(scenario.seed, source), True
        return lambda count: deviation * rng.standard_normal((count, size))

    def draw(self, count: int) -> CellSignals:
        """Return the signals of the next ticks."""
        ticks = np.arange(self._tick, self._tick + count, dtype=np.float64)
        self._tick += count
        arms = tuple(self._arm(index, ticks) for index in range(len(self._wrists)))
        slips = np.hstack([np.empty((count, 0)), *(draw(count) for draw in self._slip_noise)])
        if self._path_delay is None:
            return CellSignals(arms, np.zeros(count), np.full(count, np.inf), slips)
        newest = self._sent(ticks - self._path_delay)
        is_new = newest > np.maximum(self._sent(ticks - self._path_delay - 1.0), 0.0)
        age = ticks - np.where(newest > 0.0, newest, -np.inf)
        return CellSignals(arms, is_new.astype(np.float64), age, slips)

    def _arm(self, index: int, ticks: Array) -> ArmSignals:
        sensor, sampling, X_PE = self._wrists[index], self._sampling[index], self._grasps[index]
        newest, is_due = sampling.newest(ticks), ticks % sampling.every == 0.0
        noise = np.zeros((len(ticks), 6))
        noise[is_due] = self._wrist_noise[index](int(is_due.sum()))  # drawn while lost, too: then none shifts
        time = ticks * self._clock.period
        stuck = np.inf if sensor.stuck_at is None else sensor.stuck_at - EARLY * self._clock.period
        arrives = (newest > sampling.newest(ticks - 1.0)) & (newest * self._clock.period < stuck)
        error_E = noise + sensor.offset.vector6 + time[:, None] * sensor.drift.vector6
        error_P = error_E
        if error_E.any():
            error_P = shift_wrench(rotate_vector6(X_PE[None, :3, :3], error_E), X_PE[:3, 3])
        return ArmSignals(
            encoder_noise=self._encoder_noise[index](len(ticks)),
            wrist_error=error_P,
            wrist_arrived=arrives.astype(np.float64),
            wrist_age=ticks - (newest if self._has_wrist[index] else -np.inf),
        )

    def _sent(self, ticks: Array) -> Array:
        """Return the tick of the oldest reading in the internal wrenches that are known at each tick."""
        if not any(self._has_wrist):
            return ticks
        return reduce(np.minimum, [sampling.newest(ticks) for sampling in self._sampling])


def missed_ticks(scenario: Scenario, arm: str) -> Callable[[int], Array]:
    """Return a function that draws whether an arm misses its command at each of the next ticks, masks."""
    probability = scenario.actuators_of(arm).missed_ticks
    if not probability:
        return np.zeros
    rng = generator(scenario.seed, f"{arm}/missed_ticks")
    return lambda count: (rng.random(count) < probability).astype(np.float64)
