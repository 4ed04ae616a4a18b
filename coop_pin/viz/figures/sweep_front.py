"""All runs of a sweep by two metrics, with the front of the best."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.figures import palette
from coop_pin.figures.style import label, styled
from coop_pin.sweeps.result import SweepResult
from coop_pin.viz.figures.scale import scale_to_values


def pareto_figure(result: SweepResult, metric_a: str, metric_b: str) -> Figure:
    """Return all runs by two metrics, for example tracking and internal force, with the front of those that none beats in both.

    Args:
        result: the sweep.
        metric_a: along the horizontal axis; smaller is better.
        metric_b: along the vertical axis; smaller is better.

    Raises:
        EntryNotFoundError: no run has one of the metrics.
    """
    a, b = (result.values(name).values.ravel() for name in (metric_a, metric_b))
    front = result.pareto(metric_a, metric_b)
    edge = np.array([[place.metrics[metric_a], place.metrics[metric_b]] for place in front]).reshape(-1, 2)
    shown = np.isfinite(a) & np.isfinite(b)
    with styled():
        figure = Figure(figsize=(5.4, 3.8), layout="constrained")
        panel = figure.subplots()
        panel.plot(a[shown], b[shown], "o", color=palette.EVENT, markersize=3.5, alpha=0.7, label=f"{np.count_nonzero(shown)} runs")
        panel.step(edge[:, 0], edge[:, 1], where="post", color=palette.ACTUAL, marker="o", markersize=4.5, label="front")
        for place, (x, y) in zip(front, edge, strict=True):
            panel.annotate(f"{place.number}", (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7.0)
        scale_to_values(panel, "x", a[shown])
        scale_to_values(panel, "y", b[shown])
        panel.set_xlabel(metric_a)
        label(panel, "numbers at the front: runs of the sweep", metric_b)
        panel.legend(loc="best")
    return figure
