"""The axes of the paper's Figs. 2 and 3, and where the curves of runs lie in them.

A curve fits where its extremes lie between the end of its axis and the next tick, as of a program that ends
an axis at the tick beyond the data.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pages import markdown

import coop_pin as cp
from coop_pin.base.arrays import Array

SCENARIOS = ("adept-paper", "adept-paper-fit")
EVENT, TICK = 10.0, 1.0 / 80.0
"""Time of the event and period, s."""
PSI = np.pi / 3
"""Desired angle of the bar, rad."""


class Axis(NamedTuple):
    """An axis of the paper: its ends, and the distance of its ticks.

    Attributes:
        curve: name and unit.
        low: lower end.
        high: upper end.
        tick: distance of two ticks.
    """

    curve: str
    low: float
    high: float
    tick: float


AXES = (
    Axis("$x$, m", 0.35, 0.70, 0.05),
    Axis("$y$, m", 0.04, 0.22, 0.02),
    Axis("$\\psi$, deg", 10.0, 90.0, 10.0),
    Axis("$f$ along the bar, N", -20.0, -2.0, 2.0),
    Axis("joint 1, arm 1, N m", -80.0, 80.0, 20.0),
    Axis("joint 2, arm 1", -60.0, 80.0, 20.0),
    Axis("joint 3, arm 1", -60.0, 120.0, 20.0),
    Axis("joint 1, arm 2", -60.0, 140.0, 20.0),
    Axis("joint 2, arm 2", -80.0, 60.0, 20.0),
    Axis("joint 3, arm 2", -100.0, 40.0, 20.0),
)
SEEN = 1e-3
"""Part of an axis that shows: less beyond it is within it."""
LOW, HIGH, TICKS = (np.array([getattr(axis, name) for axis in AXES]) for name in ("low", "high", "tick"))


def extremes(samples: Any) -> Array:
    """Return least and greatest value of the ten curves of runs, shape (runs, 10, 2).

    The panels of pose and force draw desired and actual curves, and their axes bound both.

    Args:
        samples: quantities of a batch by name, with a leading axis of runs.
    """
    pose, desired = samples["pose_error"], samples["desired_position"]
    x, y = ((pose[..., row] + desired[..., row], desired[..., row]) for row in (0, 1))
    psi = np.degrees(pose[..., 5] + PSI), np.full(pose.shape[:-1], np.degrees(PSI))
    f = samples["internal_axial"][..., 0], samples["desired_internal_axial"][..., 0]
    curves = [np.concatenate(pair, axis=1) for pair in (x, y, psi, f)]
    curves += [samples["torque"][..., arm, joint] for arm in (0, 1) for joint in (0, 1, 2)]
    return np.stack([np.stack([curve.min(axis=1), curve.max(axis=1)], axis=-1) for curve in curves], axis=1)


def outside(found: Array) -> Array:
    """Return how far the extremes of each curve lie from where its axis has them, in lengths of the axis."""
    low, high = found[..., 0], found[..., 1]
    below = np.maximum(LOW - low, 0.0) + np.maximum(low - LOW - TICKS, 0.0)
    above = np.maximum(high - HIGH, 0.0) + np.maximum(HIGH - TICKS - high, 0.0)
    return (below + above) / (HIGH - LOW)


def settled(samples: Any) -> Array:
    """Return the times after which runs stay within 5 mm and 5 mrad, from start and event, (runs, 2)."""
    error = samples["pose_error"]
    far = (np.linalg.norm(error[..., :2], axis=-1) > 5e-3) | (np.abs(error[..., 5]) > 5e-3)
    time = np.arange(far.shape[1]) * TICK
    before = time < EVENT - 1e-9
    last = [
        np.where(far & part, time, begin).max(axis=1) for part, begin in ((before, 0.0), (~before, EVENT))
    ]
    return np.stack([last[0], last[1] - EVENT], axis=-1)


def ranges(scenario: str) -> Array:
    """Return the extremes of the ten curves along a run of a scenario, shape (10, 2)."""
    data = cp.run(scenario, warn=False).data
    names = ("pose_error", "desired_position", "torque", "internal_axial", "desired_internal_axial")
    return extremes({name: data[name].values[None] for name in names})[0]


def table() -> str:
    """Return the printed axes beside the ranges of the scenarios; in bold what is where its axis has it."""
    columns = [ranges(name) for name in SCENARIOS]
    rows = []
    for index, axis in enumerate(AXES):
        cells = [axis.curve, f"{axis.low:g} to {axis.high:g}"]
        for column in columns:
            text = " to ".join(f"{value:.{2 if axis.tick < 1.0 else 1}f}" for value in column[index])
            cells.append(f"**{text}**" if outside(column[None])[0, index] < SEEN else text)
        rows.append(cells)
    sums = [f"{outside(column[None]).sum():.2f}" for column in columns]
    rows.append(["sum of what lies outside, in lengths of the axes", "", *sums])
    return markdown(["", "printed axis", *(f"`{name}`" for name in SCENARIOS)], rows)
