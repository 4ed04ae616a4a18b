"""Figures of a blame: causes by newtons with intervals, and the views of the arms over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, legend_above, plain_figure
from coop_pin.identification.answer import Blame

_BARS = 14
"""Most causes that are drawn."""


@typed
def blame_figure(answer: Blame) -> Figure:
    """Return the causes as bars, the largest first, with their 95 % intervals.

    Args:
        answer: answer with newtons.
    """
    causes = [cause for cause in answer.causes if cause.high > 0.0][:_BARS]
    with plain_figure(7.2, 0.9 + 0.28 * len(causes)) as (figure, panel):
        at = np.arange(len(causes))
        newtons, low, high = (
            np.array([getattr(one, part) for one in causes]) for part in ("newtons", "low", "high")
        )
        colours = [palette.INTERNAL if one.is_seen else palette.FREE for one in causes]
        panel.barh(at, newtons, color=colours, height=0.7)
        panel.hlines(at, low, high, color=palette.LIMIT, linewidth=1.0)
        names = [", ".join(filter(None, (one.name, one.size * one.is_one))) for one in causes]
        panel.set_yticks(at, [as_written(name) for name in names], fontsize=7)
        panel.invert_yaxis()
        panel.set_xlabel("internal force, mean over the log (N); grey: known by its prior alone")
    return figure


@typed
def views_figure(answer: Blame) -> Figure:
    """Return how far the views of the arms are from that of the first one, before and after the fit.

    Args:
        answer: answer with estimates.
    """
    closure, fit = answer.fitted
    linear = np.tile(closure.rows.are_linear, len(closure.arms) - 1)
    with plain_figure(7.2, 2.6, 1, 2, sharex=True) as (figure, panels):
        for panel, rows, unit in zip(panels, (linear, ~linear), ("mm", "mrad"), strict=True):
            for name, style, r in (
                ("as logged", palette.INTERNAL, closure.mismatch()),
                ("without the errors", palette.ACTUAL, closure.mismatch(fit.x)),
            ):
                panel.plot(closure.times, 1e3 * np.linalg.norm(r[:, rows], axis=1), color=style, label=name)
            label(panel, "views apart", unit)
            panel.set_xlabel("time (s)")
        legend_above(panels[0])
    return figure
