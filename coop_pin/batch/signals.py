"""Signals of a run as one array: all that changes from tick to tick and does not depend on the plant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.scenario import Scenario
from coop_pin.simulation import Simulation
from coop_pin.simulation.signals import CellSignals, MissedTicks, SensorSignals
from coop_pin.spatial.task_rows import TaskRows


class RunShape(NamedTuple):
    """What runs of one program share besides numbers.

    Attributes:
        rows: task rows of the cell.
        delay: ticks of transport of the internal wrench; None without a force path.
        wrist_delays: delay of each arm's wrist sensor, ticks, 0 without one; None if no arm has one.
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
        payload = scenario.cell.payload
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
            changes_payload=any(event.apply(payload) is not payload for event in scenario.events),
            pushes=any(event.push_at(event.time) is not None for event in scenario.events),
        )


class Desired(NamedTuple):
    """Desired motion and squeeze at n ticks, or without the first axis at one.

    Attributes:
        time: t_k, s, shape (n,).
        pose: X_WP_d, shape (n, 4, 4).
        twist: V_WP_d, shape (n, 6).
        acceleration: A_WP_d, shape (n, 6).
        squeeze: f_d of each arm in payload axes, shape (n, m, 6).
    """

    time: Array
    pose: Array
    twist: Array
    acceleration: Array
    squeeze: Array


class RunSignals(NamedTuple):
    """Signals of a run at n ticks, or without the first axis at one.

    Attributes:
        desired: desired motion and squeeze.
        sensors: signals of the sensors.
        missed: whether each arm misses the command, masks, shape (n, m).
    """

    desired: Desired
    sensors: CellSignals
    missed: Array


def desired_of(run: Simulation) -> Desired:
    """Return desired motion and squeeze at all ticks of a run."""
    grasps, times = run.scenario.cell.grasps, [run.timeline.time(k) for k in range(run.timeline.ticks + 1)]
    pose, twist, acceleration = map(np.array, zip(*map(run.motion.at, times), strict=True))
    squeeze = np.array([run.squeeze.at(time, grasps) for time in times])
    return Desired(np.array(times), pose, twist, acceleration, squeeze)


def run_signals(scenario: Scenario, desired: Desired, joints: list[int]) -> RunSignals:
    """Return the signals of a run at all ticks.

    Args:
        scenario: Scenario with sensors, actuators and seed.
        desired: Desired motion and squeeze.
        joints: Number of each arm's drives.
    """
    count = len(desired.time)
    sensors = SensorSignals(scenario, joints).draw(count)
    return RunSignals(desired, sensors, MissedTicks(scenario).draw(count))


def columns(signals: RunSignals) -> Array:
    """Return signals as one array, in the order of the leaves of those of a tick, shape (n, entries)."""
    parts = list[Array]()
    _mapped(parts.append, signals)
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def first_of(signals: RunSignals) -> RunSignals:
    """Return the signals of the first tick."""
    first: RunSignals = _mapped(lambda part: part[0], signals)
    return first


def _mapped(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of tuples with a function applied to each of its arrays."""
    if not isinstance(tree, tuple):
        return function(tree)
    parts = [_mapped(function, part) for part in tree]
    return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
