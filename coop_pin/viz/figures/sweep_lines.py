"""A sweep as lines over one field."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from coop_pin.errors import FieldError
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled
from coop_pin.viz.figures.scale import scale_to_places, scale_to_values
from coop_pin.viz.figures.sweep_table import MetricTable

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
        raise FieldError(f"would need {len(series)} lines; a figure tells {len(palette.SERIES)} apart. Let fewer fields vary", field)
    with styled():
        figure = Figure(figsize=(7.6, 4.0), layout="constrained")
        panel = figure.subplots()
        for place, colour, marker in zip(series, palette.SERIES, _MARKERS, strict=False):
            chosen = dict(zip(others, place, strict=True))
            x, y = values[field].values, values.sel(chosen).values
            text = ", ".join(_written(name, value) for name, value in chosen.items())
            panel.plot(x, y, color=colour, marker=marker, markersize=4.0, label=text or None)
            gone = failed.sel(chosen).values
            panel.plot(x[gone], np.full(gone.sum(), 0.97), "x", color=colour, transform=panel.get_xaxis_transform(), clip_on=False)
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
