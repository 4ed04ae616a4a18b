"""A sweep as a map over two fields."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from coop_pin.arrays import Array
from coop_pin.errors import FieldError, NameNotFoundError
from coop_pin.figures import palette
from coop_pin.figures.style import is_in_ratios, is_wide, label, scale_to_places, scale_to_values, styled
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.table import FAILED


class MetricTable(NamedTuple):
    """One metric with repeats joined.

    Attributes:
        metric: its name.
        values: the median of repeats; not a number where a run failed, is missing, or has no finite value.
        failed: where any repeat failed.
    """

    metric: str
    values: xr.DataArray
    failed: xr.DataArray

    @classmethod
    def of(cls, result: SweepResult, metric: str) -> Self:
        """Return the table of a sweep.

        Raises:
            NameNotFoundError: no run has the metric.
        """
        values, failed = result.values(metric), result.data["status"] == FAILED
        values = values.where(np.isfinite(values))
        if "repeat" in values.dims:
            values, failed = values.median("repeat"), failed.any("repeat")
        return cls(metric, values, failed)

    @property
    def numbered(self) -> list[str]:
        """The dimensions with numbers on them."""
        names = map(str, self.values.dims)
        return [name for name in names if name != "sample" and self.values[name].dtype.kind in "iuf"]


_MARKERS = "osDv^P"


def lines_figure(table: MetricTable, field: str) -> Figure:
    """Return a line along a field for each place along all other dimensions, with crosses where runs failed.

    Args:
        table: the metric.
        field: a dimension with numbers.

    Raises:
        FieldError: there are more lines than a figure can tell apart.
    """
    values, failed = table.values.sortby(field), table.failed.sortby(field)
    others = [str(name) for name in values.dims if name != field]
    series = list(itertools.product(*(values[name].values.tolist() for name in others)))
    if len(series) > len(palette.SERIES):
        raise FieldError(
            f"would need {len(series)} lines; a figure tells {len(palette.SERIES)} apart. Let fewer fields vary",
            field,
        )
    with styled():
        figure = Figure(figsize=(7.6, 4.0), layout="constrained")
        panel = figure.subplots()
        for place, colour, marker in zip(series, palette.SERIES, _MARKERS, strict=False):
            chosen = dict(zip(others, place, strict=True))
            x, y = values[field].values, values.sel(chosen).values
            text = ", ".join(_written(name, value) for name, value in chosen.items())
            panel.plot(x, y, color=colour, marker=marker, markersize=4.0, label=text or None)
            gone = failed.sel(chosen).values
            panel.plot(
                x[gone],
                np.full(gone.sum(), 0.97),
                "x",
                color=colour,
                transform=panel.get_xaxis_transform(),
                clip_on=False,
            )
        scale_to_places(panel, "x", values[field].values)
        scale_to_values(panel, "y", values.values)
        panel.set_xlabel(field)
        label(panel, "", table.metric)
        if failed.any():
            panel.plot([], [], "x", color=palette.EVENT, label="failed")
        if others or failed.any():
            panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


def _written(field: str, value: Any) -> str:
    """Return a case by its name, and a number with the last part of its field before it."""
    if isinstance(value, str):
        return value
    return f"{field.rsplit('.', 1)[-1]} {value:g}"


def map_figure(table: MetricTable) -> Figure:
    """Return a map over the two dimensions, with failed runs hatched and the boundary around them drawn.

    Args:
        table: the metric; both of its dimensions have numbers.
    """
    across, up = (str(name) for name in table.values.dims)
    values, failed = (
        entry.sortby([across, up]).transpose(up, across) for entry in (table.values, table.failed)
    )
    with styled():
        figure = Figure(figsize=(5.8, 4.2), layout="constrained")
        panel = figure.subplots()
        panel.grid(visible=False)
        x, y = (_edges(values[name].values) for name in (across, up))
        mesh = panel.pcolormesh(
            x, y, np.ma.masked_invalid(values.values), norm=_norm(values.values), cmap="cividis"
        )
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
        [x[0], x[1], x[1], x[0]],
        [y[0], y[0], y[1], y[1]],
        facecolor="#f3f4f6",
        edgecolor=palette.EVENT,
        hatch="////",
        linewidth=0.0,
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


def sweep_figure(result: SweepResult, metric: str, over: str | None = None) -> Figure:
    """Return a metric over what varies: a map if exactly two fields with numbers vary, lines otherwise.

    Args:
        result: the sweep.
        metric: name.
        over: a field with numbers: draw lines along it, one for each place along all other dimensions.

    Raises:
        NameNotFoundError: no run has the metric, or no dimension the name ``over``.
        FieldError: nothing that varies has numbers, or there are more lines than a figure can tell apart.
    """
    table = MetricTable.of(result, metric)
    fields = table.numbered
    if over is None and len(fields) == 2 and table.values.ndim == 2:
        return map_figure(table)
    if over is not None and over not in table.values.dims:
        raise NameNotFoundError("dimension", over, [str(name) for name in table.values.dims], "the sweep")
    if (not fields) if over is None else (over not in fields):
        raise FieldError(
            "has no numbers to draw along; use pareto_figure, or result.best", over or "the sweep"
        )
    return lines_figure(table, over or max(fields, key=lambda name: table.values.sizes[name]))


def pareto_figure(result: SweepResult, metric_a: str, metric_b: str) -> Figure:
    """Return all runs by two metrics, for example tracking and internal force, with the front of those that none beats in both.

    Args:
        result: the sweep.
        metric_a: along the horizontal axis; smaller is better.
        metric_b: along the vertical axis; smaller is better.

    Raises:
        NameNotFoundError: no run has one of the metrics.
    """
    a, b = (result.values(name).values.ravel() for name in (metric_a, metric_b))
    front = result.pareto(metric_a, metric_b)
    edge = np.array([[place.metrics[metric_a], place.metrics[metric_b]] for place in front]).reshape(-1, 2)
    shown = np.isfinite(a) & np.isfinite(b)
    with styled():
        figure = Figure(figsize=(5.4, 3.8), layout="constrained")
        panel = figure.subplots()
        panel.plot(
            a[shown],
            b[shown],
            "o",
            color=palette.EVENT,
            markersize=3.5,
            alpha=0.7,
            label=f"{np.count_nonzero(shown)} runs",
        )
        panel.step(
            edge[:, 0],
            edge[:, 1],
            where="post",
            color=palette.ACTUAL,
            marker="o",
            markersize=4.5,
            label="front",
        )
        for place, (x, y) in zip(front, edge, strict=True):
            panel.annotate(f"{place.number}", (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7.0)
        scale_to_values(panel, "x", a[shown])
        scale_to_values(panel, "y", b[shown])
        panel.set_xlabel(metric_a)
        label(panel, "numbers at the front: runs of the sweep", metric_b)
        panel.legend(loc="best")
    return figure
