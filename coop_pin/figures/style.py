"""Style and parts that all figures share: panels, labels, event marks, axis limits and scales, and saving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Literal, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from coop_pin.arrays import Array
from coop_pin.description.events import PayloadChange, WrenchPulse
from coop_pin.figures import palette
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically

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

Grid: TypeAlias = NDArray[Any]
"""Axes in rows and columns."""


def styled() -> AbstractContextManager[None]:
    """Return a context manager in which matplotlib draws in the style of this package."""
    return mpl.rc_context(STYLE)


@contextmanager
def run_figure(
    rows: int, columns: int, result: RunResult, title: str, panel: tuple[float, float] = (3.6, 2.0)
) -> Iterator[tuple[Figure, Grid]]:
    """Yield an empty figure of a run and its axes, shape (rows, columns), which share the time axis.

    At the end, the events are marked in every panel and the time axes are labelled.

    Args:
        rows: of panels.
        columns: of panels.
        result: the run; its name is in the title, its summary below the panels.
        title: above all panels.
        panel: width and height of a panel, inches.
    """
    scenario = result.scenario
    with styled():
        figure = Figure(figsize=(panel[0] * columns, panel[1] * rows + 0.6), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        figure.suptitle(f"{as_written(scenario.name)}: {title}")
        if scenario.summary:
            figure.supxlabel(as_written(scenario.summary), fontsize=7.5, color=palette.CAPTION)
        yield figure, axes
        figure.align_ylabels()
        for panel_axes in axes.flat:
            for event in scenario.events:
                _mark_event(panel_axes, event)
            panel_axes.set_xlim(0.0, max(result.end, scenario.clock.period))
        for panel_axes in axes[-1]:
            panel_axes.set_xlabel("time (s)")


def as_written(text: object) -> str:
    """Return a user's text as matplotlib draws it unchanged; between two $ it would expect a formula."""
    return str(text).replace("$", r"\$")


def label(panel: Axes, title: str, unit: str) -> None:
    """Set the title of a panel and the label of its vertical axis."""
    panel.set_title(title, loc="left", fontsize=STYLE["axes.titlesize"])
    panel.set_ylabel(unit)


def legend_above(panel: Axes) -> None:
    """Put the legend of a panel beside its title, above the curves."""
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.1,
        columnspacing=1.0,
        handlelength=1.3,
        handletextpad=0.5,
    )


def frame_bulk(panel: Axes, values: Array, unit: str) -> None:
    """Limit a panel to the middle 98 % of its values, and note the range of the peaks that it cuts off."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return
    low, high = (float(edge) for edge in np.percentile(finite, (1.0, 99.0)))
    margin = max(0.25 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    if finite.min() >= low - margin and finite.max() <= high + margin:
        return
    panel.set_ylim(low - margin, high + margin)
    ends = np.array((finite.min(), finite.max()))
    least, most = np.where(np.abs(ends) < 1e-6 * np.abs(finite).max(), 0.0, ends)
    style: dict[str, Any] = {"ha": "right", "va": "bottom", "fontsize": 7.0, "color": palette.CAPTION}
    box = {"facecolor": "white", "alpha": 0.85, "linewidth": 0.0, "pad": 1.5}
    text = f"peaks cut off: {least:.3g} to {most:.3g} {unit}"
    panel.text(0.99, 0.03, text, transform=panel.transAxes, bbox=box, **style)


def frame_decades(panel: Axes, values: Array) -> None:
    """Limit a logarithmic panel from below, because values that cross zero extend to minus infinity."""
    positive = values[values > 0.0]
    if positive.size:
        panel.set_ylim(bottom=float(np.percentile(positive, 1.0)) / 3.0)


def _mark_event(panel: Axes, event: PayloadChange | WrenchPulse) -> None:
    panel.axvline(event.time, color=palette.EVENT, linewidth=0.8, linestyle=":", zorder=0.5)
    if isinstance(event, WrenchPulse):
        panel.axvspan(event.time, event.end, color=palette.EVENT, alpha=0.25, linewidth=0.0, zorder=0.4)


_LARGE_RATIO = 30.0
"""Ratio of the largest to the smallest value above which a scale is logarithmic."""
_MAX_TICKS = 8
"""Up to so many values of a field have ticks of their own on a logarithmic scale."""


def scale_to_metric(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic if the values of a metric span a large ratio.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: any shape; those that are not finite are ignored.
    """
    if spans_large_ratio(values):
        panel.set(**{f"{axis}scale": "log"})


def scale_to_field(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic if the values of a field are spaced so; a few values have a tick each.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: shape (n,).
    """
    if not is_log_spaced(values):
        return
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


_DPI = 150


def save_figure(
    figure: Figure, stem: str | Path, *, formats: Sequence[Literal["png", "svg"]] = ("png", "svg")
) -> tuple[Path, ...]:
    """Write a figure as PNG, as SVG or as both; if writing fails, older files at these paths stay.

    It is laid out once, and drawn once for each format: Figure.savefig does both twice.

    Args:
        figure: the figure.
        stem: path of the files without their suffix.
        formats: those that are written.

    Returns:
        The paths.
    """
    paths = tuple(Path(f"{stem}.{kind}") for kind in formats)
    engine, dpi, canvas = figure.get_layout_engine(), figure.dpi, figure.canvas
    # Without a fixed salt, matplotlib makes the ids inside an SVG random.
    with mpl.rc_context({"svg.hashsalt": "coop_pin"}):
        try:
            figure.dpi = _DPI
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine("none")
            for path in paths:
                write_atomically(path, lambda part: _write(figure, part))
        finally:
            figure.dpi = dpi
            figure.set_layout_engine(engine)
            figure.set_canvas(canvas)
    return paths


def _write(figure: Figure, part: Path) -> None:
    canvas: Any = (FigureCanvasAgg if part.suffix == ".png" else FigureCanvasSVG)(figure)
    if part.suffix == ".png":
        canvas.print_png(part, metadata={"Software": None})
    else:
        canvas.print_svg(part, metadata={"Date": None})
