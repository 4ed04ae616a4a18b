"""Figure of the motion of a run: paths of payload and tips, from above and from the side."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.base.arrays import Array, typed
from coop_pin.figures import palette
from coop_pin.figures.style import ACTUAL, DESIRED, as_written, label, plain_figure
from coop_pin.results.run_result import RunResult

_INSTANTS = 6
_WIDTH, _MIN_WIDTH, _MAX_HEIGHT, _MARGIN = 6.6, 4.6, 7.0, 0.45
"""Inches; at the least width, the legend still fits beside a cell that is narrow seen from above."""


@typed
def motion_figure(result: RunResult) -> Figure:
    """Return the paths of payload and tips, and the polygon of the tips at six instants, from above.

    Cells that move in space are also drawn from the side (x, z), below the view from above and to the same
    scale.

    Args:
        result: the run.
    """
    views = [(0, 1)] if result.scenario.cell.rows == "planar" else [(0, 1), (0, 2)]
    extent = _extent(result)
    scale = min(_WIDTH / extent[0], _MAX_HEIGHT / sum(extent[second] for _, second in views))
    heights = [scale * extent[second] + _MARGIN for _, second in views]
    size = (max(scale * extent[0], _MIN_WIDTH) + 2.0 * _MARGIN, sum(heights) + 2.0 * _MARGIN)
    shape: Any = {"sharex": True, "squeeze": False, "height_ratios": heights}
    with plain_figure(*size, len(views), **shape) as (figure, grid):
        for panel, view in zip(grid.flat, views, strict=True):
            _draw_motion(panel, result, view)
        grid[-1, 0].set_xlabel("x (m)")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _extent(result: RunResult) -> Array:
    """Return the extent of bases, tips and payload in x, y and z with a margin of 10 % on each side, m."""
    names = ("tip_position", "payload_position", "desired_position")
    bases = [arm.base.xyz for arm in result.scenario.cell.arms.values()]
    points = np.concatenate([bases, *(result.data[name].values.reshape(-1, 3) for name in names)])
    return 1.2 * np.maximum(np.ptp(points, axis=0), 0.1)


def _draw_motion(panel: Axes, result: RunResult, view: tuple[int, int]) -> None:
    data, first, second = result.data, *view
    tips, actual, desired = (
        data[name].values for name in ("tip_position", "payload_position", "desired_position")
    )
    samples = np.unique(np.linspace(0, len(tips) - 1, _INSTANTS).round().astype(int))
    for age, sample in enumerate(samples):
        corners = np.concatenate((tips[sample], tips[sample, :1]))
        style: dict[str, Any] = {"color": palette.LOAD, "alpha": 0.25 + 0.75 * age / len(samples)}
        panel.plot(corners[:, first], corners[:, second], linewidth=2.5, **style)
    panel.plot(desired[:, first], desired[:, second], label="desired path", **DESIRED)
    panel.plot(actual[:, first], actual[:, second], label="actual path", **ACTUAL)
    for number, (name, arm) in enumerate(result.scenario.cell.arms.items()):
        base, colour = arm.base.xyz, palette.arm(number)
        panel.plot(tips[:, number, first], tips[:, number, second], color=colour, linewidth=0.6)
        panel.plot(base[first], base[second], "^", color=colour, label=f"base of {as_written(name)}")
    panel.set_aspect("equal", adjustable="box")
    label(panel, "from above" if second == 1 else "from the side", f"{'xyz'[second]} (m)")
