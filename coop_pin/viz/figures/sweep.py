"""What a sweep says about one metric: a map where two fields vary, lines otherwise."""

from __future__ import annotations

from matplotlib.figure import Figure

from coop_pin.errors import EntryNotFoundError, FieldError
from coop_pin.figures.sweep_figures import map_figure
from coop_pin.sweeps.result import SweepResult
from coop_pin.viz.figures.sweep_lines import lines_figure
from coop_pin.viz.figures.sweep_table import MetricTable


def sweep_figure(result: SweepResult, metric: str, over: str | None = None) -> Figure:
    """Return a metric over what varies: a map if exactly two fields with numbers vary, lines otherwise.

    Args:
        result: the sweep.
        metric: name.
        over: a field with numbers: draw lines along it, one for each place along all other dimensions.

    Raises:
        EntryNotFoundError: no run has the metric, or no dimension the name ``over``.
        FieldError: nothing that varies has numbers, or there are more lines than a figure can tell apart.
    """
    table = MetricTable.of(result, metric)
    fields = table.numbered
    if over is None and len(fields) == 2 and table.values.ndim == 2:
        return map_figure(table)
    if over is not None and over not in table.values.dims:
        raise EntryNotFoundError("dimension", over, [str(name) for name in table.values.dims], "the sweep")
    if (not fields) if over is None else (over not in fields):
        raise FieldError("has no numbers to draw along; use pareto_figure, or result.best", over or "the sweep")
    return lines_figure(table, over or max(fields, key=lambda name: table.values.sizes[name]))
