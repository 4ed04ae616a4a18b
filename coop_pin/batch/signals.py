"""Signals of a run: all that changes from tick to tick and does not depend on what the plant does.

References, ages of measurements, and the random errors of sensors and drives; these are drawn from the
generators of coop_pin.simulation in the same order, so that the samples are the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.description.events import PayloadChange
from coop_pin.description.scenario import Scenario
from coop_pin.description.sensors import WristSensor
from coop_pin.simulation import Simulation
from coop_pin.simulation.noise import generator
from coop_pin.spatial import rotate_vector6, shift_wrench
from coop_pin.spatial.task_rows import TaskRows
from coop_pin.tracing.kernel import Layout


class RunShape(NamedTuple):
    """What runs of one program share besides numbers.

    Attributes:
        rows: task rows of the cell.
        delay: ticks of transport of the internal wrench; None without a force path.
        wrist_delays: of each arm's wrist sensor, ticks, 0 for an arm without one; None if no arm has one.
        has_wrist: whether each arm measures its wrench.
        has_encoders: whether each arm's drives are not measured as they are.
        misses: whether each arm may miss ticks.
        lags: whether each arm's drives have a lag.
        changes_payload: whether events change it.
        pushes: whether events push it.
    """

    rows: TaskRows
    delay: int | None
    wrist_delays: tuple[int, ...] | None
    has_wrist: tuple[bool, ...]
    has_encoders: tuple[bool, ...]
    misses: tuple[bool, ...]
    lags: tuple[bool, ...]
    changes_payload: bool
    pushes: bool

    @classmethod
    def of(cls, scenario: Scenario) -> RunShape:
        """Return the shape of a scenario's run."""
        path, arms = scenario.controller.force_path, list(scenario.cell.arms)
        sensors, actuators = map(scenario.sensors_of, arms), list(map(scenario.actuators_of, arms))
        wrists, are_ideal = zip(*((own.wrist, own.joints_are_ideal) for own in sensors), strict=True)
        return cls(
            rows=scenario.cell.task_rows,
            delay=path.delay if path.measures else None,
            wrist_delays=tuple(wrist.delay if wrist else 0 for wrist in wrists) if any(wrists) else None,
            has_wrist=tuple(wrist is not None for wrist in wrists),
            has_encoders=tuple(not is_ideal for is_ideal in are_ideal),
            misses=tuple(own.missed_ticks > 0.0 for own in actuators),
            lags=tuple(own.lag > 0.0 for own in actuators),
            changes_payload=any(isinstance(event, PayloadChange) for event in scenario.events),
            pushes=any(not isinstance(event, PayloadChange) for event in scenario.events),
        )


def signal_layout(arms: int, drives: int) -> Layout:
    """Return the entries of a tick's signals."""
    layout = Layout()
    fields: tuple[tuple[Any, ...], ...] = (
        *(("time",), ("pose", 4, 4), ("twist", 6), ("acceleration", 6), ("squeeze", arms, 6)),
        *(("age",), ("arrived",), ("wrist_age", arms), ("wrist_arrived", arms), ("wrist_error", arms, 6)),
        *(("encoder_noise", drives), ("missed", arms)),
    )
    for field in fields:
        layout.add(*field)
    return layout


def references(run: Simulation) -> dict[str, Array]:
    """Return time, pose, twist, acceleration and squeeze at all ticks."""
    grasps, motion, squeeze = run.scenario.cell.grasps, run.motion, run.squeeze
    times = np.array([run.timeline.time(tick) for tick in range(run.timeline.ticks + 1)])
    targets = map(np.array, zip(*map(motion.at, times.tolist()), strict=True))
    found = dict(zip(("pose", "twist", "acceleration"), targets, strict=True))
    return {
        "time": times,
        **found,
        "squeeze": np.array([squeeze.at(time, grasps) for time in times.tolist()]),
    }


def errors(scenario: Scenario, shape: RunShape, joints: list[int], time: Array) -> dict[str, Any]:
    """Return errors of sensors and drives at all ticks, and the ages of measurements.

    Args:
        scenario: its sensors, actuators and seed.
        shape: of the run.
        joints: number of each arm's drives.
        time: of all ticks, s, shape (n,).
    """
    tick, cell, count = np.arange(len(time)), scenario.cell, len(time)
    noise, missed, wrists = [], [], []
    for name, size, is_read, misses in zip(cell.arms, joints, shape.has_encoders, shape.misses, strict=True):
        sensors, lost = scenario.sensors_of(name), scenario.actuators_of(name).missed_ticks
        normal, uniform = np.zeros((count, size)), np.ones(count)
        if is_read and np.any(sensors.encoder.noise):
            rng = generator(scenario.seed, f"{name}/encoder")
            normal = np.array(sensors.encoder.noise) * rng.standard_normal((count, size))
        if misses:
            uniform = generator(scenario.seed, f"{name}/missed_ticks").random(count)
        noise.append(normal)
        missed.append(uniform < lost)
        wrists.append(_wrist(scenario, name, time))
    arrived, taken, wrist_error = (np.stack(parts, axis=1) for parts in zip(*wrists, strict=True))
    sent = taken.min(axis=1) if shape.wrist_delays is not None else tick.astype(np.float64)
    is_new = sent > np.maximum(np.concatenate(([-np.inf], sent[:-1])), 0.0)
    held = _delayed(np.where(is_new, sent, -np.inf), shape.delay or 0)
    return {
        "arrived": np.isfinite(held),
        "age": tick - np.maximum.accumulate(held) if shape.delay is not None else np.full(count, np.inf),
        "wrist_arrived": arrived,
        "wrist_age": np.where(shape.has_wrist, tick[:, None] - taken, np.inf),
        "wrist_error": wrist_error,
        "encoder_noise": np.concatenate(noise, axis=1),
        "missed": np.stack(missed, axis=1),
    }


def _wrist(scenario: Scenario, arm: str, time: Array) -> tuple[Mask, Array, Array]:
    """Return where a sample of a wrist arrives, the tick of the newest, and its errors in payload axes."""
    sensor, clock, X_PE = scenario.sensors_of(arm).wrist, scenario.clock, scenario.cell.grasps[arm].matrix
    sensor = sensor or WristSensor()
    noise, offset, drift = (part.vector6 for part in (sensor.noise, sensor.offset, sensor.drift))
    now, every = time + 1e-9 * clock.period, sensor.ticks_per_sample(clock)
    taken = np.full(len(time), -np.inf)
    taken[::every] = np.arange(0.0, len(time), every)
    for start, end in sensor.lost:
        taken[(start <= now) & (now < end)] = -np.inf
    error_E = offset + time[:, None] * drift
    if noise.any():
        drawn = generator(scenario.seed, f"{arm}/wrist").standard_normal((len(time[::every]), 6))
        error_E[::every] = noise * drawn + offset + time[::every, None] * drift
    error_P = shift_wrench(rotate_vector6(X_PE[:3, :3], error_E), X_PE[:3, 3])
    taken = _delayed(taken, sensor.delay)
    return np.isfinite(taken), np.maximum.accumulate(taken), error_P


def _delayed(taken: Array, delay: int) -> Array:
    """Return what arrives at each tick: the tick of a sample, -inf where none arrives."""
    return np.concatenate((np.full(delay, -np.inf), taken[: len(taken) - delay]))
