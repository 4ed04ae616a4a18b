"""A sweep as a map over two fields."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled
from coop_pin.viz.figures.scale import is_in_ratios, is_wide, scale_to_places
from coop_pin.viz.figures.sweep_table import MetricTable


def map_figure(table: MetricTable) -> Figure:
    """Return a map over the two dimensions, with failed runs hatched and the boundary around them drawn.

    Args:
        table: the metric; both of its dimensions have numbers.
    """
    across, up = (str(name) for name in table.values.dims)
    values, failed = (entry.sortby([across, up]).transpose(up, across) for entry in (table.values, table.failed))
    with styled():
        figure = Figure(figsize=(5.8, 4.2), layout="constrained")
        panel = figure.subplots()
        panel.grid(visible=False)
        x, y = (_edges(values[name].values) for name in (across, up))
        mesh = panel.pcolormesh(x, y, np.ma.masked_invalid(values.values), norm=_norm(values.values), cmap="cividis")
        for row, column in np.argwhere(failed.values):
            _hatch(panel, x[column : column + 2], y[row : row + 2])
        _draw_boundary(panel, x, y, failed.values)
        for axis, edges, name in (("x", x, across), ("y", y, up)):
            scale_to_places(panel, axis, values[name].values)
            (panel.set_xlim if axis == "x" else panel.set_ylim)(edges[0], edges[-1])
        panel.set_xlabel(across)
        label(panel, "", up)
        figure.colorbar(mesh, label=table.metric)
        if failed.values.any():
            panel.legend(handles=[_failed_patch()], loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return figure


def _draw_boundary(panel: Axes, x: Array, y: Array, failed: Array) -> None:
    """Draw the sides that a failed cell shares with one that did not fail."""
    style: dict[str, Any] = {"color": palette.INTERNAL, "linewidth": 2.0, "solid_capstyle": "round"}
    for row, column in np.argwhere(failed[1:] != failed[:-1]):
        panel.plot(x[column : column + 2], [y[row + 1]] * 2, **style)
    for row, column in np.argwhere(failed[:, 1:] != failed[:, :-1]):
        panel.plot([x[column + 1]] * 2, y[row : row + 2], **style)


def _hatch(panel: Axes, x: Array, y: Array) -> None:
    panel.fill(
        [x[0], x[1], x[1], x[0]], [y[0], y[0], y[1], y[1]], facecolor="#f3f4f6", edgecolor=palette.EVENT, hatch="////", linewidth=0.0
    )


def _failed_patch() -> Patch:
    return Patch(facecolor="#f3f4f6", edgecolor=palette.EVENT, hatch="////", linewidth=0.0, label="failed")


def _norm(values: Array) -> Normalize | None:
    finite = values[np.isfinite(values)]
    return LogNorm(float(finite.min()), float(finite.max())) if is_wide(finite) else None


def _edges(places: Array) -> Array:
    """Return the sides of cells around sorted numbers, half-way between them on the scale that they are drawn on."""
    places = places.astype(float)
    if places.size == 1:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    drawn = np.log(places) if is_in_ratios(places) else places
    middle = (drawn[1:] + drawn[:-1]) / 2.0
    edges = np.concatenate(([2.0 * drawn[0] - middle[0]], middle, [2.0 * drawn[-1] - middle[-1]]))
    return np.exp(edges) if is_in_ratios(places) else edges
