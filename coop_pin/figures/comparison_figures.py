"""Page of figures of a comparison: fronts, ranks with their intervals, and a map of controllers by trials."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.comparison import Comparison
from coop_pin.errors import FieldError
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, styled

_TRACKING = "tracking_rms_mm"
_SHADES = 1e-5
"""Least value that has a shade of its own, as a part of the largest."""


def comparison_figure(comparison: Comparison, scenario: str) -> Figure:
    """Return tracking against internal force, ranks in both, and a map of their values, of one scenario.

    Failed runs have no mark in the front and "failed" in the maps; a cell whose runs are not all
    trustworthy has a star. Ranks are over all scenarios and trials.

    Args:
        comparison: the table.
        scenario: name.

    Raises:
        FieldError: the comparison has no such scenario.
    """
    if scenario not in comparison.data["scenario"].values:
        known = ", ".join(map(str, comparison.data["scenario"].values))
        raise FieldError(f"is {scenario!r}; the comparison has {known}", "scenario")
    own = comparison.data.sel(scenario=scenario)
    force = (own["axial_rms_N"] ** 2 + own["shear_rms_N"] ** 2) ** 0.5
    with styled():
        figure = Figure(figsize=(14.0, 10.0), layout="constrained")
        (front, ranks), (left, right) = figure.subplots(2, 2)
        _draw_front(front, own[_TRACKING], force)
        _draw_ranks(ranks, comparison)
        own = own.assign_coords(label=("controller", comparison.labels(scenario)))
        _draw_map(figure, left, own, own[_TRACKING], "tracking, mm")
        _draw_map(figure, right, own, force, "internal force, N")
        figure.suptitle(as_written(scenario))
    return figure


def _draw_front(panel: Axes, tracking: xr.DataArray, force: xr.DataArray) -> None:
    """Draw one mark for each controller: the medians over the trials, failed ones as infinite."""
    x, y = (np.median(part.transpose("controller", ...).values, axis=1) for part in (tracking, force))
    for place, number in enumerate(np.argsort(x)):  # neighbours are named above and below in turn
        point, name = (x[number], y[number]), tracking["controller"].values[number]
        if np.isfinite(point).all():
            panel.plot(*point, "o", color=palette.ACTUAL)
            offset = (3, 3 if place % 2 else -9)
            panel.annotate(as_written(name), point, offset, textcoords="offset points", fontsize=7)
    panel.set(xscale="log", yscale="log", xlabel="tracking, mm")
    label(panel, "medians over the trials", "internal force, N")


def _draw_ranks(panel: Axes, comparison: Comparison) -> None:
    """Draw the mean ranks in tracking and in axial force with their 95 % intervals."""
    order = comparison.ranks(_TRACKING).index.tolist()[::-1]
    both = ((_TRACKING, palette.ACTUAL, 0.12), ("axial_rms_N", palette.INTERNAL, -0.12))
    for measure, colour, offset in both:
        found = comparison.ranks(measure).loc[order]
        reach: Any = (found["rank"] - found["low"], found["high"] - found["rank"])
        at = np.arange(len(order)) + offset
        panel.errorbar(found["rank"], at, xerr=reach, fmt="o", color=colour, label=as_written(measure))
    panel.set_yticks(range(len(order)), [as_written(name) for name in order])
    panel.set_xlabel("mean rank over all scenarios and trials, 95 % interval")
    panel.legend()


def _draw_map(figure: Figure, panel: Axes, own: xr.Dataset, values: xr.DataArray, title: str) -> None:
    """Draw a map of controllers by trials."""
    shown: Array = values.transpose("trial", "controller").values
    counts = (own[name].transpose("trial", "controller").values for name in ("runs", "trustworthy"))
    runs, trusted = counts
    finite = np.where(np.isfinite(shown) & (shown > 0.0), shown, np.nan)
    panel.set_facecolor("#f3f4f6")
    middle = math.inf
    if np.isfinite(finite).any():
        most = float(np.nanmax(finite))
        least = max(float(np.nanmin(finite)), _SHADES * most)
        mesh = panel.pcolormesh(finite, norm=LogNorm(least, most, clip=True), cmap="viridis_r")
        figure.colorbar(mesh, ax=panel)
        middle = math.sqrt(least * most)
    for (row, column), value in np.ndenumerate(shown):
        text = "" if np.isnan(runs[row, column]) else _written(value) if np.isfinite(value) else "failed"
        star = "*" if np.isfinite(value) and trusted[row, column] < runs[row, column] else ""
        colour = "white" if middle < value < np.inf else "black"  # dark and light cells
        panel.text(column + 0.5, row + 0.5, text + star, ha="center", va="center", fontsize=6, color=colour)
    trials, controllers = ([as_written(x) for x in own[name].values] for name in ("trial", "label"))
    panel.set_yticks(np.arange(len(trials)) + 0.5, trials)
    panel.set_xticks(np.arange(len(controllers)) + 0.5, controllers, rotation=60, ha="right")
    panel.invert_yaxis()
    panel.set_title(title)


def _written(value: float) -> str:
    """Return a number in as many characters as fit into a narrow cell."""
    if 0.0 < value < 1e-2:
        return f"{value:.1e}".replace("e-0", "e-")
    text = f"{value:.2g}"
    return text[1:] if text.startswith("0.") else text
