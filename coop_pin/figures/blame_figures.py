"""Figures of a blame: causes by newtons with intervals, and the views of the arms over time."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, legend_above, plain_figure
from coop_pin.identification.answer import Blame

_BARS = 14
"""Most causes that are drawn."""
_WIDTH, _BAR, _TEXT, _LINE = 5.0, 0.24, 0.15, 72
"""Width of the figure, heights of a bar with its gap and of a line of its name, in; letters of a line."""


@typed
def blame_figure(answer: Blame) -> Figure:
    """Return the causes as bars, the largest first, with their 95 % intervals.

    Args:
        answer: answer with newtons.
    """
    causes = [cause for cause in answer.causes if cause.counts][:_BARS]
    names = [", ".join(filter(None, (one.name, one.size * one.is_one))) for one in causes]
    texts = [fill(name, _LINE) for name in names]
    at = np.cumsum([_BAR + _TEXT * (text.count("\n") + 1) for text in texts])  # in, from the top
    with plain_figure(_WIDTH, 0.6 + at[-1]) as (figure, panel):
        for one, text, y in zip(causes, texts, at.tolist(), strict=True):
            colour = palette.INTERNAL if one.is_seen else palette.FREE
            panel.barh(y, one.newtons, color=colour, height=0.5 * _BAR)
            panel.hlines(y, one.low, one.high, color=palette.LIMIT, linewidth=1.0)
            panel.text(0.0, y - 0.4 * _BAR, as_written(text), fontsize=8, va="bottom")
        panel.set_yticks([])
        panel.set_ylim(at[-1] + 0.5 * _BAR, 0.0)
        panel.set_xlabel("internal force, mean over the log (N); grey: by its prior alone")
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
