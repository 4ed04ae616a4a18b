"""The motion as a drawing: for paper, where nothing moves."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import ACTUAL, DESIRED, label, styled
from coop_pin.results import RunResult

_MOMENTS = 6
_WIDTH, _LEAST_WIDTH, _LARGEST_HEIGHT = 6.6, 4.6, 7.0
"""Inches; a cell that is narrow seen from above still leaves room for its legend."""

_ROOM = 0.45


def motion_figure(result: RunResult) -> Figure:
    """Return the paths of the payload and of the tips, and the polygon between the tips at six moments, seen from above.

    Cells that move in space are drawn from the side (x, z) as well, below the view from above and to the same
    scale.

    Args:
        result: the run.
    """
    views = [(0, 1)] if result.scenario.cell.rows == "planar" else [(0, 1), (0, 2)]
    extent = _extent(result)
    scale = min(_WIDTH / extent[0], _LARGEST_HEIGHT / sum(extent[second] for _, second in views))
    heights = [scale * extent[second] + _ROOM for _, second in views]
    with styled():
        figure = Figure(
            figsize=(max(scale * extent[0], _LEAST_WIDTH) + 2.0 * _ROOM, sum(heights) + 2.0 * _ROOM),
            layout="constrained",
        )
        panels = figure.subplots(len(views), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
        for panel, view in zip(panels, views, strict=True):
            _draw(panel, result, view)
        panels[-1].set_xlabel("x (m)")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _extent(result: RunResult) -> Array:
    """Return how far bases, tips and payload reach in x, y and z, with some room around them, m, shape (3,)."""
    data = result.data
    bases = np.array([arm.base.xyz for arm in result.scenario.cell.arms.values()])
    places = (
        bases,
        data["tip_position"].values.reshape(-1, 3),
        data["payload_position"].values,
        data["desired_position"].values,
    )
    return 1.2 * np.maximum(np.ptp(np.concatenate(places), axis=0), 0.1)


def _draw(panel: Axes, result: RunResult, view: tuple[int, int]) -> None:
    data, first, second = result.data, *view
    tips, actual, desired = (
        data[name].values for name in ("tip_position", "payload_position", "desired_position")
    )
    chosen = np.unique(np.linspace(0, len(tips) - 1, _MOMENTS).round().astype(int))
    for age, sample in enumerate(chosen):
        corners = np.concatenate((tips[sample], tips[sample, :1]))
        panel.plot(
            corners[:, first],
            corners[:, second],
            color=palette.LOAD,
            alpha=0.25 + 0.75 * age / len(chosen),
            linewidth=2.5,
        )
    panel.plot(desired[:, first], desired[:, second], label="desired path", **DESIRED)
    panel.plot(actual[:, first], actual[:, second], label="payload's path", **ACTUAL)
    for arm, (name, described) in enumerate(result.scenario.cell.arms.items()):
        base, colour = described.base.xyz, palette.SERIES[(arm + 1) % len(palette.SERIES)]
        panel.plot(tips[:, arm, first], tips[:, arm, second], color=colour, linewidth=0.6)
        panel.plot(base[first], base[second], "^", color=colour, label=f"base of {name}")
    panel.set_aspect("equal", adjustable="box")
    label(panel, "from above" if second == 1 else "from the side", f"{'xyz'[second]} (m)")
