"""What all figures share: size, lines, titles, and how events are marked."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
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

Grid: TypeAlias = NDArray[Any]
"""Axes in rows and columns."""


def styled() -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in our style; outside it nothing is changed."""
    return mpl.rc_context(STYLE)


def grid_figure(
    rows: int, columns: int, result: RunResult, title: str, panel: tuple[float, float] = (3.6, 2.0)
) -> tuple[Figure, Grid]:
    """Return an empty figure and its axes, shape (rows, columns), which share the time axis.

    Args:
        rows: of panels.
        columns: of panels.
        result: the run; its name stands in the title, its summary below the panels.
        title: above all panels.
        panel: width and height of a panel, inches.
    """
    scenario = result.scenario
    with styled():
        figure = Figure(figsize=(panel[0] * columns, panel[1] * rows + 0.6), layout="constrained")
        axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
        figure.suptitle(f"{scenario.name}: {title}")
        if scenario.summary:
            figure.supxlabel(scenario.summary, fontsize=7.5, color=palette.CAPTION)
    return figure, axes


def finish(figure: Figure, axes: Grid, result: RunResult) -> None:
    """Mark the events in every panel, label the time axis at the bottom, and line up the rest."""
    with styled():
        figure.align_ylabels()
        for panel in axes.flat:
            for event in result.scenario.events:
                _mark_event(panel, event)
            panel.set_xlim(0.0, max(result.end, result.scenario.clock.period))
        for panel in axes[-1]:
            panel.set_xlabel("time (s)")


def label(panel: Axes, title: str, unit: str) -> None:
    """Write what a panel shows, and its unit."""
    panel.set_title(title, loc="left", fontsize=STYLE["axes.titlesize"])
    panel.set_ylabel(unit)


def legend_above(panel: Axes) -> None:
    """Name the lines of a panel beside its title, where no curve passes."""
    panel.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        borderaxespad=0.1,
        columnspacing=1.0,
        handlelength=1.3,
        handletextpad=0.5,
    )


def without_zeros(values: Array) -> Array:
    """Return values with zeros left out: a logarithmic axis has no place for them."""
    return np.where(values > 0.0, values, np.nan)


def frame_bulk(panel: Axes, values: Array, unit: str) -> None:
    """Limit a panel to the middle 98 % of its values, and say so where a short peak leaves the picture."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return
    low, high = (float(edge) for edge in np.percentile(finite, (1.0, 99.0)))
    margin = max(0.25 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-9)
    if finite.min() >= low - margin and finite.max() <= high + margin:
        return
    panel.set_ylim(low - margin, high + margin)
    least, most = (
        0.0 if abs(edge) < 1e-6 * np.abs(finite).max() else float(edge)
        for edge in (finite.min(), finite.max())
    )
    text = f"peaks cut off: {least:.3g} to {most:.3g} {unit}"
    backing = {"facecolor": "white", "alpha": 0.85, "linewidth": 0.0, "pad": 1.5}
    panel.text(
        0.99,
        0.03,
        text,
        transform=panel.transAxes,
        ha="right",
        va="bottom",
        fontsize=7.0,
        color=palette.CAPTION,
        bbox=backing,
    )


def frame_decades(panel: Axes, values: Array) -> None:
    """Limit a logarithmic panel from below: where a value crosses zero its logarithm has nothing to say."""
    positive = values[values > 0.0]
    if positive.size:
        panel.set_ylim(bottom=float(np.percentile(positive, 1.0)) / 3.0)


def _mark_event(panel: Axes, event: PayloadChange | WrenchPulse) -> None:
    panel.axvline(event.time, color=palette.EVENT, linewidth=0.8, linestyle=":", zorder=0.5)
    if isinstance(event, WrenchPulse):
        panel.axvspan(event.time, event.end, color=palette.EVENT, alpha=0.25, linewidth=0.0, zorder=0.4)


_LARGE_RATIO = 30.0
"""Ratio of largest to smallest from which a scale is logarithmic."""
_FEW_PLACES = 8
"""Up to so many places a logarithmic field shows each of them."""


def scale_to_values(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic where the values of a metric reach over large ratios.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: shape (n,), or any; what is not finite is left out.
    """
    if is_wide(values):
        (panel.set_xscale if axis == "x" else panel.set_yscale)("log")


def scale_to_places(panel: Axes, axis: str, places: Array) -> None:
    """Make an axis logarithmic where the places of a field are spaced in ratios, and show each of a few.

    Args:
        panel: the axes.
        axis: "x" or "y".
        places: shape (n,).
    """
    if not is_in_ratios(places):
        return
    (panel.set_xscale if axis == "x" else panel.set_yscale)("log")
    if len(set(places.tolist())) <= _FEW_PLACES:
        side = panel.xaxis if axis == "x" else panel.yaxis
        side.set_ticks(places.tolist(), [f"{place:g}" for place in places])
        side.set_ticks([], minor=True)


def is_wide(values: Array) -> bool:
    """Say whether positive values reach over large ratios; what is not finite is left out."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0.0 and finite.max() > _LARGE_RATIO * finite.min())


def is_in_ratios(values: Array) -> bool:
    """Say whether numbers are spaced more evenly in ratio than in difference."""
    places = np.unique(values).astype(float)
    if places.size < 3 or places[0] <= 0.0:
        return False
    steps, ratios = np.diff(places), np.diff(np.log(places))
    return bool(np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean() - 1e-9)


_DPI = 150
_METADATA: dict[str, dict[str, Any]] = {".png": {"Software": None}, ".svg": {"Date": None}}


def save_figure(figure: Figure, stem: str | Path) -> tuple[Path, Path]:
    """Write a figure as PNG and as SVG; good files at those paths are never destroyed half-way.

    Args:
        figure: the figure.
        stem: path of the files without their suffix.

    Returns:
        The two paths.
    """
    png, svg = Path(f"{stem}.png"), Path(f"{stem}.svg")
    for path in (png, svg):
        write_atomically(path, lambda part: _write(figure, part))
    return png, svg


def _write(figure: Figure, part: Path) -> None:
    # matplotlib salts the names inside an SVG with a random number unless it is told one.
    with mpl.rc_context({"svg.hashsalt": "coop_pin"}):
        figure.savefig(part, dpi=_DPI, metadata=_METADATA[part.suffix])
