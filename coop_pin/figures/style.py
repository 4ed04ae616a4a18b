"""Style and parts that all figures share: panels, labels, event marks, axis limits and scales."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.description.events import PayloadEvent
from coop_pin.figures import palette
from coop_pin.figures.layout import CAPTION_LINE, PanelLayout, write_decades
from coop_pin.results.run_result import RunResult

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.titlesize": 10.0,
    "figure.titleweight": "bold",
}

ACTUAL: dict[str, Any] = {"color": palette.ACTUAL}
DESIRED: dict[str, Any] = {"color": palette.DESIRED, "linestyle": (0, (4, 2)), "linewidth": 1.0}
MEASURED: dict[str, Any] = {"color": palette.MEASURED, "linewidth": 0.8}

_CAPTION_CHARACTER = 0.057
"""Width of a character of a caption, rather too large than too small, inches."""

_WINDOW: dict[str, Any] = {"alpha": 0.06, "linewidth": 0.0, "zorder": 0.3}
"""Shade of the times at which the reference moves."""

Grid: TypeAlias = NDArray[Any]
"""Axes in rows and columns."""


def styled() -> AbstractContextManager[None]:
    """Return a context manager in which matplotlib draws in the style of this package."""
    return mpl.rc_context(STYLE)


@contextmanager
def plain_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Yield an empty figure of a size in inches, and the axes in it; options as of ``Figure.subplots``."""
    with styled():
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, figure.subplots(rows, columns, **options)


@contextmanager
def run_figure(
    rows: int, columns: int, result: RunResult, title: str, panel: tuple[float, float] = (3.6, 2.0)
) -> Iterator[tuple[Figure, Grid]]:
    """Yield an empty figure of a run and its axes, shape (rows, columns), which share the time axis.

    At the end, the events and the times at which the reference moves are marked in every panel, and the time
    axes are labelled.

    Args:
        rows: number of rows of panels.
        columns: number of columns of panels.
        result: the run; its name is in the title, its caption below the panels.
        title: title above all panels.
        panel: width and height of a panel, inches.
    """
    scenario = result.scenario
    with styled():
        windows = result.windows_of("moving")
        shaded = ("blue shade: the reference moves",) if windows else ()
        caption = "; ".join((*((scenario.caption,) if scenario.caption else ()), *shaded))
        lines = textwrap.wrap(caption, int(panel[0] * columns / _CAPTION_CHARACTER))
        height = panel[1] * rows + 0.6 + CAPTION_LINE * max(len(lines) - 1, 0)
        figure = Figure(figsize=(panel[0] * columns, height))
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        heading = figure.suptitle(f"{as_written(scenario.name)}: {title}", va="top")
        text = as_written("\n".join(lines))
        below = figure.supxlabel(text, fontsize=7.5, color=palette.CAPTION, va="bottom")
        figure.set_layout_engine(PanelLayout(heading, below))
        yield figure, axes
        for panel_axes in axes.flat:
            for window in windows:
                panel_axes.axvspan(window.start, window.end, color=palette.ACTUAL, **_WINDOW)
            for event in scenario.events:
                _mark_event(panel_axes, event)
            panel_axes.set_xlim(0.0, max(result.end, scenario.clock.period))
            write_decades(panel_axes)
        for panel_axes in axes[-1]:
            panel_axes.set_xlabel("time (s)")


def as_written(text: object) -> str:
    """Return a user's text as matplotlib draws it unchanged; between two $ it would expect a formula."""
    return str(text).replace("$", r"\$")


def label(panel: Axes, title: str, unit: str) -> None:
    """Set the title of a panel and the label of its vertical axis."""
    panel.set_title(title, loc="left", fontsize=STYLE["axes.titlesize"], y=1.0)
    panel.yaxis.set_offset_position("right")  # a factor such as 1e-5 does not meet the title
    panel.set_ylabel(unit)


def legend_above(panel: Axes) -> None:
    """Put the legend of a panel above the curves, in the line of its title."""
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.1,
        columnspacing=1.0,
        handlelength=1.3,
        handletextpad=0.5,
    )


_PEAK_S = (0.3, 0.9)
"""Time that an inset shows before and after a peak, s."""
_PEAK_RATIO = 1.8
"""Ratio of all values' range to that without the peak above which the peak gets an inset."""


def inset_peak(panel: Axes, time: Array) -> None:
    """Show the curves without their highest peak, and the peak in an inset, if it would flatten the rest.

    Args:
        panel: axes with curves over time.
        time: times of their samples, s, shape (n,).
    """
    curves = [line for line in panel.lines if np.size(line.get_xdata()) == time.size]
    values = np.array([np.asarray(line.get_ydata(), dtype=float) for line in curves])
    if not np.isfinite(values).any():
        return
    away = np.nanmax(np.abs(values - np.nanmedian(values, axis=1, keepdims=True)), axis=0)
    peak = float(time[np.nanargmax(away)])
    inside = (time >= peak - _PEAK_S[0]) & (time <= peak + _PEAK_S[1])
    rest = values[:, ~inside]
    if not np.isfinite(rest).any() or np.nanmax(rest) - np.nanmin(rest) < 1e-9:
        return
    low, high = float(np.nanmin(rest)), float(np.nanmax(rest))
    if np.nanmax(values) - np.nanmin(values) < _PEAK_RATIO * (high - low):
        return
    panel.set_ylim(low - 0.1 * (high - low), high + 1.3 * (high - low))  # with room for the inset
    left = 0.62 if peak < 0.55 * time[-1] else 0.1
    inset = panel.inset_axes((left, 0.55, 0.36, 0.4))
    for line in curves:
        inset.plot(
            time[inside],
            np.asarray(line.get_ydata())[inside],
            color=line.get_color(),
            linestyle=line.get_linestyle(),
            linewidth=0.9,
        )
    inset.tick_params(labelsize=6.0, length=2.0, pad=1.5)
    inset.set_xlim(max(peak - _PEAK_S[0], 0.0), min(peak + _PEAK_S[1], float(time[-1])))


def frame_decades(panel: Axes, values: Array) -> None:
    """Limit a logarithmic panel, from below because values that cross zero extend to minus infinity."""
    positive = values[values > 0.0]
    if positive.size:
        panel.set_ylim(float(np.percentile(positive, 1.0)) / 3.0, 2.0 * float(positive.max()))


def _mark_event(panel: Axes, event: PayloadEvent) -> None:
    panel.axvline(event.time, color=palette.EVENT, linewidth=0.8, linestyle=":", zorder=0.5)
    if event.end > event.time:
        panel.axvspan(event.time, event.end, color=palette.EVENT, alpha=0.25, linewidth=0.0, zorder=0.4)


_LARGE_RATIO = 30.0
"""Ratio of the largest to the smallest value above which a scale is logarithmic."""
_MAX_TICKS = 8
"""Up to so many values of a field have ticks of their own."""


def scale_to_metric(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic if the values of a metric span a large ratio.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: metric of the runs, any shape; those that are not finite are ignored.
    """
    if spans_large_ratio(values):
        panel.set(**{f"{axis}scale": "log"})


def scale_to_field(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic if the values of a field are spaced so; up to eight have a tick each.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: numbers, shape (n,).
    """
    if is_log_spaced(values):
        panel.set(**{f"{axis}scale": "log"})
    if np.unique(values).size <= _MAX_TICKS:
        side = panel.xaxis if axis == "x" else panel.yaxis
        side.set_ticks(values.tolist(), [f"{value:g}" for value in values])
        side.set_ticks([], minor=True)


def spans_large_ratio(values: Array) -> bool:
    """Return whether the finite values are positive and span a large ratio."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0.0 and finite.max() > _LARGE_RATIO * finite.min())


def is_log_spaced(values: Array) -> bool:
    """Return whether at least three positive values are spaced more evenly in ratio than in difference."""
    ordered = np.unique(values).astype(float)
    if ordered.size < 3 or ordered[0] <= 0.0:
        return False
    steps, ratios = np.diff(ordered), np.diff(np.log(ordered))
    return bool(np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean() - 1e-9)
