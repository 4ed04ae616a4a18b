"""The motion as a drawing: for paper, where nothing moves."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.results import RunResult
from coop_pin.viz import palette
from coop_pin.viz.figures.style import ACTUAL, DESIRED, label, styled

_MOMENTS = 6


def motion_figure(result: RunResult) -> Figure:
    """Return the paths of the payload and of the tips, and the polygon between the tips at six moments, seen from above.

    Cells that move in space are drawn from the side (x, z) as well.

    Args:
        result: the run.
    """
    views = [(0, 1)] if result.scenario.cell.rows == "planar" else [(0, 1), (0, 2)]
    with styled():
        figure = Figure(figsize=(7.8, 3.4 if len(views) > 1 else 3.0), layout="constrained")
        for panel, view in zip(figure.subplots(1, len(views), squeeze=False)[0], views, strict=True):
            _draw(panel, result, view)
    return figure


def _draw(panel: Axes, result: RunResult, view: tuple[int, int]) -> None:
    data, first, second = result.data, *view
    tips, actual, desired = (data[name].values for name in ("tip_position", "payload_position", "desired_position"))
    chosen = np.unique(np.linspace(0, len(tips) - 1, _MOMENTS).round().astype(int))
    for age, sample in enumerate(chosen):
        corners = np.concatenate((tips[sample], tips[sample, :1]))
        panel.plot(corners[:, first], corners[:, second], color=palette.LOAD, alpha=0.25 + 0.75 * age / len(chosen), linewidth=2.5)
    panel.plot(desired[:, first], desired[:, second], label="desired path", **DESIRED)
    panel.plot(actual[:, first], actual[:, second], label="payload's path", **ACTUAL)
    for arm, (name, described) in enumerate(result.scenario.cell.arms.items()):
        base, colour = described.base.xyz, palette.SERIES[(arm + 1) % len(palette.SERIES)]
        panel.plot(tips[:, arm, first], tips[:, arm, second], color=colour, linewidth=0.6)
        panel.plot(base[first], base[second], "^", color=colour, label=f"base of {name}")
    panel.set_aspect("equal", adjustable="box")
    label(panel, "from above" if second == 1 else "from the side", f"{'xyz'[second]} (m)")
    panel.set_xlabel(f"{'xyz'[first]} (m)")
    panel.legend(loc="best")
