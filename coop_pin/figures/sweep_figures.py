"""Figures of sweeps: lines over one field, maps over two, and Pareto fronts of two metrics."""

from __future__ import annotations

import itertools
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from coop_pin.base.arrays import Array, typed
from coop_pin.base.errors import FieldError, NameNotFoundError
from coop_pin.figures import palette
from coop_pin.figures.style import (
    as_written,
    is_log_spaced,
    label,
    plain_figure,
    scale_to_field,
    scale_to_metric,
    spans_large_ratio,
)
from coop_pin.results.metrics import METRIC_TEXTS, SIMULATION_SOUND, TASK_KEPT, measure_text
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.table import FAILED


def metric_table(result: SweepResult, metric: str) -> xr.Dataset:
    """Return the values of a metric over the dimensions of a sweep.

    Its variables are ``value``, NaN for runs that failed, are missing, or have no finite value, ``failed``,
    and of the others ``unsound`` where the simulation is not sound, ``unkept`` where the task is not kept.

    Raises:
        NameNotFoundError: no run has the metric.
    """
    values, failed = _scaled(result, metric), result.data["status"] == FAILED
    values = values.where(np.isfinite(values))
    marks = {
        mark: (result.values(name) == 0.0) & ~failed if name in result.metric_names else xr.zeros_like(failed)
        for mark, name in (("unsound", SIMULATION_SOUND), ("unkept", TASK_KEPT))
    }
    return xr.Dataset({"value": values, "failed": failed} | marks, attrs={"metric": measure_text(metric)})


def _scaled(result: SweepResult, metric: str) -> xr.DataArray:
    """Return the values of a metric in the unit of its text: mm and mrad, not m and rad."""
    return result.values(metric) * (METRIC_TEXTS[metric][2] if metric in METRIC_TEXTS else 1.0)


_UNITS = {
    "Nm": "N m",
    "N": "N",
    "m": "m",
    "rad": "rad",
    "s": "s",
    "J": "J",
    "B": "B",
    "hz": "Hz",
    "mass": "kg",
}
"""Units by the last part of a name; the duration of a run is in s."""


def field_label(field: str) -> str:
    """Return the words of a field and its unit, for an axis: "payload mass (kg)" for cell.payload.mass."""
    *_, group, last = ("", *field.split("."))
    words = last.removesuffix("_hz").replace("_", " ")
    unit = "s" if last == "duration" else _UNITS.get(last.rsplit("_", 1)[-1], "")
    named = words if group in ("", "gains") else f"{group.replace('_', ' ')} {words}"
    return f"{named} ({unit})" if unit else named


_MARKERS = "osDv^P"
_MARK: Any = {"linestyle": "", "fillstyle": "none", "color": palette.LIMIT}
_DOUBTS: dict[str, Any] = {
    "unsound": _MARK | {"marker": "o", "markersize": 9.0, "label": "simulation not sound"},
    "unkept": _MARK | {"marker": "s", "markersize": 11.0, "label": "task not kept"},
}
"""Ring or square around a run, by its mark."""
_MOST_MAPS, _MAPS_IN_A_ROW = 12, 4
_HATCHED: Any = {"facecolor": "#f3f4f6", "edgecolor": palette.EVENT, "hatch": "////", "linewidth": 0.0}


def lines_figure(table: xr.Dataset, field: str) -> Figure:
    """Return a line over a field for each combination of the other dimensions.

    Failed runs have crosses at the top, those that are not sound a ring, those that lost their task a square.

    Args:
        table: the metric.
        field: a numeric dimension.

    Raises:
        FieldError: there are more lines than distinguishable colours.
    """
    table = table.sortby(field)
    x, others = table[field].values, [str(name) for name in table["value"].dims if name != field]
    series = list(itertools.product(*(table[name].values.tolist() for name in others)))
    if len(series) > len(palette.SERIES):
        raise FieldError(
            f"would need {len(series)} lines; a figure has colours for {len(palette.SERIES)}. "
            "Show a part of the sweep: --at FIELD=VALUE, or result.at",
            field,
        )
    with plain_figure(7.6, 4.0) as (figure, panel):
        for values, colour, marker in zip(series, palette.SERIES, _MARKERS, strict=False):
            coordinates = dict(zip(others, values, strict=True))
            line = table.sel(coordinates)
            text = as_written(", ".join(_written(name, value) for name, value in coordinates.items()))
            panel.plot(x, line["value"], color=colour, marker=marker, markersize=4.0, label=text or None)
            crosses = x[line["failed"].values]
            at_top: dict[str, Any] = {"transform": panel.get_xaxis_transform(), "clip_on": False}
            panel.plot(crosses, np.full(crosses.size, 0.97), "x", color=colour, **at_top)
            for mark, style in _DOUBTS.items():
                is_marked = line[mark].values
                panel.plot(x[is_marked], line["value"].values[is_marked], **style | {"label": None})
        scale_to_field(panel, "x", x)
        scale_to_metric(panel, "y", table["value"].values)
        panel.set_xlabel(as_written(field_label(field)))
        label(panel, "", as_written(table.attrs["metric"]))
        if table["failed"].any():
            panel.plot([], [], "x", color=palette.EVENT, label="failed")
        for mark, style in _DOUBTS.items():
            if table[mark].any():
                panel.plot([], [], **style)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


def _written(field: str, value: Any) -> str:
    """Return a coordinate as text: a case by its name, a number after the words of its field."""
    return value if isinstance(value, str) else f"{field_label(field).partition(' (')[0]} {value:g}"


def map_figure(table: xr.Dataset) -> Figure:
    """Return a map over two dimensions, or one for each value of a third, the shortest of three.

    Failed runs are hatched and their boundary is drawn; runs that are not sound have a ring, those whose task
    is not kept a square. All maps
    have one scale of colours.

    Args:
        table: the metric; all of its two or three dimensions are numeric.

    Raises:
        FieldError: there are more than twelve maps.
    """
    sizes = table["value"].sizes
    third = [str(name) for name in sorted(sizes, key=lambda name: sizes[name])[: len(sizes) - 2]]
    maps = [part for _, part in table.groupby(third[0])] if third else [table]
    if len(maps) > _MOST_MAPS:
        raise FieldError(
            f"would need {len(maps)} maps; a figure has room for {_MOST_MAPS}. Show a part of the sweep:"
            f" --at {third[0]}=VALUE, or result.at",
            third[0],
        )
    finite = table["value"].values[np.isfinite(table["value"].values)]
    scale = {"vmin": finite.min(), "vmax": finite.max()} if finite.size else {}
    is_verdict = bool(finite.size) and set(np.unique(finite)) <= {0.0, 1.0}
    norm = (LogNorm if spans_large_ratio(finite) else Normalize)(
        **{"vmin": 0.0, "vmax": 1.0} if is_verdict else scale
    )
    columns = min(len(maps), _MAPS_IN_A_ROW)
    rows = -(-len(maps) // columns)
    size = (5.8, 4.2) if len(maps) == 1 else (1.4 + 2.9 * columns, 0.7 + 2.5 * rows)
    with plain_figure(*size, rows, columns, sharex=True, sharey=True, squeeze=False) as (figure, grid):
        for panel, part in zip(grid.flat, maps, strict=False):
            mesh = _draw_map(panel, part.squeeze(third, drop=True), norm)
            if third:
                label(panel, as_written(_written(third[0], part[third[0]].item())), panel.get_ylabel())
        for number, panel in enumerate(grid.flat):
            panel.set_visible(number < len(maps))
            panel.label_outer()
        bar = figure.colorbar(mesh, ax=list(grid.flat), label=as_written(table.attrs["metric"]))
        if is_verdict:  # two colours, no scale between them
            mesh.set_cmap(mpl.colormaps["cividis"].resampled(2))
            bar.set_ticks([0.25, 0.75], labels=["no", "yes"])
        handles: list[Any] = [Patch(label="failed", **_HATCHED)] if table["failed"].any() else []
        handles += [Line2D([], [], **style) for mark, style in _DOUBTS.items() if table[mark].any()]
        if handles:
            figure.legend(handles=handles, loc="outside upper left", ncols=2)
    return figure


def _draw_map(panel: Axes, table: xr.Dataset, norm: Normalize) -> QuadMesh:
    """Draw a map over two dimensions and return its mesh."""
    across, up = (str(name) for name in table["value"].dims)
    table = table.sortby([across, up]).transpose(up, across)
    failed = table["failed"].values
    panel.grid(visible=False)
    x, y = (_edges(table[name].values) for name in (across, up))
    mesh = panel.pcolormesh(x, y, np.ma.masked_invalid(table["value"].values), norm=norm, cmap="cividis")
    for row, column in np.argwhere(failed):
        (left, right), (low, high) = x[column : column + 2], y[row : row + 2]
        panel.fill([left, right, right, left], [low, low, high, high], **_HATCHED)
    _draw_boundary(panel, x, y, failed)
    for axis, edges, name in (("x", x, across), ("y", y, up)):
        scale_to_field(panel, axis, table[name].values)
        panel.set(**{f"{axis}lim": (edges[0], edges[-1])})
    panel.set_xlabel(as_written(field_label(across)))
    label(panel, "", as_written(field_label(up)))
    for mark, style in _DOUBTS.items():
        rows, columns = np.nonzero(table[mark].values)
        panel.plot(table[across].values[columns], table[up].values[rows], **style)
    return mesh


def _draw_boundary(panel: Axes, x: Array, y: Array, failed: Array) -> None:
    """Draw the edges between failed cells and others."""
    style: dict[str, Any] = {"color": palette.INTERNAL, "linewidth": 2.0, "solid_capstyle": "round"}
    for row, column in np.argwhere(failed[1:] != failed[:-1]):
        panel.plot(x[column : column + 2], [y[row + 1]] * 2, **style)
    for row, column in np.argwhere(failed[:, 1:] != failed[:, :-1]):
        panel.plot([x[column + 1]] * 2, y[row : row + 2], **style)


def _edges(values: Array) -> Array:
    """Return the edges of cells around sorted values: midpoints on the scale that the values are drawn on."""
    values = values.astype(float)
    if values.size == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    drawn = np.log(values) if is_log_spaced(values) else values
    middle = (drawn[1:] + drawn[:-1]) / 2.0
    edges = np.concatenate(([2.0 * drawn[0] - middle[0]], middle, [2.0 * drawn[-1] - middle[-1]]))
    return np.exp(edges) if is_log_spaced(values) else edges


@typed
def sweep_figure(result: SweepResult, metric: str, over: str | None = None) -> Figure:
    """Return a metric over the fields that vary: maps if two or three fields with numbers vary, else lines.

    Args:
        result: the sweep.
        metric: name.
        over: a numeric field: draw lines over it, one for each combination of the other dimensions.

    Raises:
        NameNotFoundError: no run has the metric, or no dimension has the name ``over``.
        FieldError: no finished run has a number, no numeric field varies, or there are more lines than
            distinguishable colours or more maps than there is room for.
    """
    table = metric_table(result, metric)
    if not (np.isfinite(table["value"]) | table["failed"]).any():
        raise FieldError("has no finite value in any finished run; choose another metric", metric)
    fields = [name for name in map(str, table.dims) if name != "sample" and table[name].dtype.kind in "iuf"]
    if over is None and len(fields) == table["value"].ndim in (2, 3):
        return map_figure(table)
    if over is not None and over not in table.dims:
        raise NameNotFoundError("dimension", over, [str(name) for name in table.dims], "the sweep")
    if (not fields) if over is None else (over not in fields):
        raise FieldError(
            "has no numbers to draw a line over; use pareto_figure, or result.best", over or "the sweep"
        )
    return lines_figure(table, over or max(fields, key=lambda name: table.sizes[name]))


_LABEL_PT = np.array((16.0, 9.0))
"""Room of a label, points."""


def apart(points: Array) -> list[int]:
    """Return the points that have room for a label: both ends, and then those whose boxes are free.

    Args:
        points: points of a front in its order, in points of the figure, shape (n, 2).
    """
    order, labelled = range(len(points)), list[int]()
    for k in (*order[:1], *order[:0:-1][:1], *order[1:-1]):
        if all((np.abs(points[k] - points[other]) >= _LABEL_PT).any() for other in labelled):
            labelled.append(k)
    return sorted(labelled)


@typed
def pareto_figure(result: SweepResult, metric_a: str, metric_b: str) -> Figure:
    """Return all runs by two metrics, for example tracking and internal force, with their Pareto front.

    Args:
        result: the sweep.
        metric_a: along the horizontal axis; smaller is better.
        metric_b: along the vertical axis; smaller is better.

    Raises:
        NameNotFoundError: no run has one of the metrics.
    """
    a, b = (_scaled(result, name).values.ravel() for name in (metric_a, metric_b))
    front = result.pareto(metric_a, metric_b)
    scales = [METRIC_TEXTS[name][2] if name in METRIC_TEXTS else 1.0 for name in (metric_a, metric_b)]
    edge = np.array([[run.metrics[metric_a], run.metrics[metric_b]] for run in front]).reshape(-1, 2) * scales
    shown = np.isfinite(a) & np.isfinite(b)
    dots: dict[str, Any] = {"color": palette.EVENT, "markersize": 3.5, "alpha": 0.7}
    line: dict[str, Any] = {"color": palette.ACTUAL, "marker": "o", "markersize": 4.5}
    with plain_figure(5.4, 3.8) as (figure, panel):
        panel.plot(a[shown], b[shown], "o", label=f"{np.count_nonzero(shown)} runs", **dots)
        panel.step(edge[:, 0], edge[:, 1], where="post", label="front", **line)
        scale_to_metric(panel, "x", a[shown])
        scale_to_metric(panel, "y", b[shown])
        for k in apart(panel.transData.transform(edge) * 72.0 / figure.dpi):
            style: Any = {"xytext": (4, 4), "textcoords": "offset points", "fontsize": 7.0}
            panel.annotate(f"{front[k].number}", edge[k], **style)
        panel.set_xlabel(as_written(measure_text(metric_a)))
        label(panel, "numbers at the front: runs of the sweep", as_written(measure_text(metric_b)))
        panel.legend(loc="best")
    return figure
