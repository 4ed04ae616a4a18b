"""Page of figures of a comparison: front, ranks with their intervals, and maps of controllers by trials."""

from __future__ import annotations

import math
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.base.errors import FieldError
from coop_pin.comparison.table import Comparison
from coop_pin.figures import palette
from coop_pin.figures.style import STYLE, as_written, label, legend_above, scale_to_metric

_TRACKING, _FORCE = "tracking_rms_mm", "internal_force"
_TITLES = {_TRACKING: "tracking error, rms (mm)", _FORCE: "internal-force error, rms (N)"}
_RANKED: Any = {
    _TRACKING: {"label": "tracking error", "color": palette.ACTUAL},
    "axial_rms_N": {"label": "axial internal force", "color": palette.INTERNAL},
}
_LEADER: Any = {
    "arrowstyle": "-",
    "color": palette.EVENT,
    "linewidth": 0.5,
    "shrinkB": 2.5,
    "relpos": (0.0, 0.5),
}
"""Line from a name at the side of the front to its mark."""
_ROW, _ROWS, _TRIALS = 0.19, 16, 6
"""Height of a row, inches; least rows that the front has room for; most trials of maps side by side."""
_SHADES = 1e-5
"""Least value that has a shade of its own, as a part of the largest."""


@typed
def comparison_figure(comparison: Comparison, scenario: str) -> Figure:
    """Return tracking against internal force, ranks in both, and a map of their values, of one scenario.

    Controllers stand in the order of their ranks in tracking, which are over all scenarios and trials. A
    controller that failed in half of the trials has no mark in the front. In the maps, a cell with a
    simulation that is not sound has a star, one with a task that is not kept a dagger. Trials that the
    scenario does not have are left out.

    Args:
        comparison: the table.
        scenario: name.

    Raises:
        FieldError: the comparison has no such scenario.
    """
    if scenario not in comparison.data["scenario"].values:
        names = map(str, comparison.data["scenario"].values)
        raise FieldError(f"is {scenario!r}; the comparison has {', '.join(names)}", "scenario")
    table = comparison.data.sel(scenario=scenario)
    table = table.assign({_FORCE: (table["axial_rms_N"] ** 2 + table["shear_rms_N"] ** 2) ** 0.5})
    classes = zip(comparison.labels(scenario), comparison.information(scenario), strict=True)
    labels = [f"{as_written(name)}: {information}" for name, information in classes]
    table = table.assign_coords(label=("controller", labels))
    table = table.sel(controller=comparison.ranks(_TRACKING).index).dropna(
        "trial", how="all", subset=["runs"]
    )
    rows, grid = table.sizes["controller"], (1, 2) if table.sizes["trial"] <= _TRIALS else (2, 1)
    heights = (0.8 + _ROW * max(rows, _ROWS), 1.8 + grid[0] * (0.3 + _ROW * rows))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, sum(heights)), layout="constrained")
        (upper,), (lower,) = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)
        front, ranks = upper.subplots(1, 2)
        _draw_front(front, table)
        _draw_ranks(ranks, comparison)
        maps = lower.subplots(*grid, sharex="col", sharey="row")
        for panel, name in zip(maps, _TITLES, strict=True):
            _draw_map(panel, table, name)
        lower.supxlabel(
            "darker: larger; *: not all simulations are sound; \u2020: not all tasks are kept;"
            " failed: half of the runs or more",
            fontsize=7.5,
            color=palette.CAPTION,
        )
        figure.suptitle(as_written(scenario))
    return figure


def _draw_front(panel: Axes, table: xr.Dataset) -> None:
    """Draw a mark for each controller, the medians over the trials, and its name at the side."""
    medians = table[list(_TITLES)].median("trial").to_array().values.T
    has_mark = np.isfinite(medians).all(axis=1)
    panel.plot(*medians[has_mark].T, "o", color=palette.ACTUAL)
    for axis, values in zip("xy", medians.T, strict=True):
        scale_to_metric(panel, axis, values[has_mark])
    panel.autoscale_view()
    heights = np.ones(len(medians))  # of the marks, as parts of the panel's
    heights[has_mark] = (panel.transScale + panel.transLimits).transform(medians[has_mark])[:, 1]
    upwards = np.argsort(heights, kind="stable")
    steps = np.arange(len(heights)) / max(len(heights), _ROWS)
    spread = np.maximum.accumulate(heights[upwards] - steps) + steps
    for number, height in zip(upwards, np.minimum(spread, 1.0 - steps[::-1]), strict=True):
        name, side = table["label"].values[number], (1.04, height)
        style: Any = {"textcoords": "axes fraction", "va": "center", "fontsize": 7.5}
        if has_mark[number]:
            panel.annotate(name, medians[number], side, arrowprops=_LEADER, **style)
        else:
            panel.annotate(f"{name}: failed", side, side, xycoords="axes fraction", **style)
    panel.set_xlabel(_TITLES[_TRACKING])
    label(panel, f"medians over the trials: {table.sizes['trial']}", _TITLES[_FORCE])


def _draw_ranks(panel: Axes, comparison: Comparison) -> None:
    """Draw the mean ranks in tracking and in axial force with their 95 % intervals."""
    order = comparison.ranks(_TRACKING).index
    for (measure, style), offset in zip(_RANKED.items(), (-0.14, 0.14), strict=True):
        ranks = comparison.ranks(measure).loc[order]
        reach: Any = (ranks["rank"] - ranks["low"], ranks["high"] - ranks["rank"])
        panel.errorbar(
            ranks["rank"], np.arange(len(order)) + offset, xerr=reach, fmt="o", markersize=4.5, **style
        )
    panel.set_yticks(range(len(order)), [as_written(name) for name in order])
    panel.invert_yaxis()
    panel.set_xlabel("mean rank over all scenarios and trials,\nwith its 95 % interval")
    legend_above(panel)


def _draw_map(panel: Axes, table: xr.Dataset, name: str) -> None:
    """Draw a map of controllers by trials."""
    shown, runs, sound, kept = (
        table[part].transpose("controller", "trial").values for part in (name, "runs", "sound", "kept")
    )
    shades = np.ma.masked_where(~(np.isfinite(shown) & (shown > 0.0)), shown)
    most = float(shades.max()) if shades.count() else 1.0
    least = max(float(shades.min()), _SHADES * most) if shades.count() else 0.1
    colours = mpl.colormaps["viridis_r"].with_extremes(bad="#f3f4f6")
    norm = LogNorm(least, most, clip=True)
    panel.pcolormesh(shades, norm=norm, cmap=colours, edgecolors="white", linewidth=0.5)
    for (row, column), value in np.ndenumerate(shown):
        text = "" if np.isnan(runs[row, column]) else _written(value) if np.isfinite(value) else "failed"
        doubts = (("*", sound), ("\u2020", kept)) if np.isfinite(value) else ()
        star = "".join(mark for mark, count in doubts if count[row, column] < runs[row, column])
        colour = "white" if math.sqrt(least * most) < value < np.inf else "black"  # dark and light cells
        panel.text(column + 0.5, row + 0.5, text + star, ha="center", va="center", fontsize=6.5, color=colour)
    trials = [as_written(trial) for trial in table["trial"].values]
    panel.set_yticks(np.arange(len(shown)) + 0.5, table["label"].values)
    panel.set_xticks(np.arange(len(trials)) + 0.5, trials, rotation=35, ha="right")
    panel.set(ylim=(len(shown), 0.0), frame_on=False)
    panel.tick_params(length=0.0)
    panel.grid(visible=False)
    label(panel, _TITLES[name], "")


def _written(value: float) -> str:
    """Return a number with two digits in as few characters."""
    if value >= 1e4 or 0.0 < value < 1e-2:
        return f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e")
    return f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"
