"""Findings of a record before anything is fitted: gaps, resets, clocks and units that do not fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.description.scenario import Scenario
from coop_pin.logs.record import ArmRecord, Record
from coop_pin.model.joint_limits import JointLimits
from coop_pin.results.finding import Finding

_STEPS = (1e-5, 0.2)
"""Steps of time between which a log of joints can be, s."""
_GAP = 5.0
"""Usual steps from which on a pause is a gap."""
_BEYOND = 0.1
"""Angle beyond a limit that counts, rad or m."""
_SHORTEST = 1.0
"""Time that all arms must share, s."""


@typed
def log_findings(record: Record, scenario: Scenario) -> Iterator[Finding]:
    """Yield what is wrong with a record, or doubtful.

    Args:
        record: record of the arms.
        scenario: cell whose arms were logged.
    """
    start, end = record.span
    if end - start < _SHORTEST:
        sentence = f"all arms have samples together for {end - start:.3g} s only: clocks or units differ"
        yield Finding("log", "time", "error", sentence, end - start, _SHORTEST)
    elif (held := np.subtract(*record.held_span[::-1])) < _SHORTEST:
        sentence = f"arms hold the payload for {held:.3g} s of the log only, after log.free = {record.free}"
        yield Finding("log", "free", "error", sentence, float(held), _SHORTEST)
    for name, arm in record.arms.items():
        yield from _times(name, arm)
        yield from _joints(name, arm, JointLimits(scenario.cell.arms[name], name))
        if not len(arm.wrench_time):
            yield Finding(
                "log", name, "note", f"no wrench of {name} is logged: its wrist and the payload are not seen"
            )
    if record.free is None:
        sentence = "no interval log.free with free hands: the zero of the squeeze is its prior alone"
        yield Finding("log", "free", "note", sentence)


def _times(name: str, arm: ArmRecord) -> Iterator[Finding]:
    steps = np.diff(arm.time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if (steps < 0.0).any():
        back = float(steps.min())
        times = int((steps < 0.0).sum())
        sentence = f"stamps of {name} go back by {-back:.3g} s, {times} times: split the log there"
        yield Finding("log", name, "error", sentence, back, 0.0)
    elif not _STEPS[0] <= usual <= _STEPS[1]:
        unit = "ms" if usual > _STEPS[1] else "s"
        sentence = f"stamps of {name} step by {usual:.3g} s: their unit is another one"
        yield Finding("log", name, "error", sentence, usual, _STEPS[1], {"log.time": unit})
    elif (largest := float(steps.max())) > _GAP * usual:
        sentence = (
            f"{name} has a gap of {largest:.3g} s at {arm.time[int(steps.argmax())]:.3g} s; it is left out"
        )
        yield Finding("log", name, "warning", sentence, largest, _GAP * usual)


def _joints(name: str, arm: ArmRecord, limits: JointLimits) -> Iterator[Finding]:
    lower, upper = limits.lower - _BEYOND, limits.upper + _BEYOND
    if ((arm.position < lower) | (arm.position > upper)).any(axis=1).mean() > 0.01:
        worst = float(np.abs(arm.position).max())
        degrees = np.deg2rad(arm.position)
        is_degrees = not ((degrees < lower) | (degrees > upper)).any()
        hint = ": they are degrees" if is_degrees else ""
        sentence = f"joints of {name} are beyond their limits, up to {worst:.4g} rad{hint}"
        yield Finding(
            "log",
            name,
            "error",
            sentence,
            worst,
            float(upper.max()),
            {"log.angle": "deg"} if is_degrees else {},
        )
    if len(arm.time) < 2:
        return
    moved = np.abs(np.gradient(arm.position, axis=0) / np.gradient(arm.time)[:, None])
    if np.isfinite(arm.velocity).all() and (arm.velocity != 0.0).any():
        ratio = float(moved.mean() / np.abs(arm.velocity).mean())
        if not 0.2 < ratio < 5.0:
            hint = "milliseconds" if ratio < 0.2 else "another unit"
            sentence = f"joints of {name} move at {ratio:.3g} of the velocities that it logs: {hint}"
            yield Finding("log", name, "error", sentence, ratio, 1.0)
