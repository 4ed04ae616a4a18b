"""Layout of the panels of a figure of a run: margins in inches, from the numbers at the ticks."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, NullLocator

_CHARACTER, _LINE, _LEAST_CHARACTERS = 0.08, 0.13, 3
"""Width and height of a digit at the ticks, inches; numbers of fewer characters have the room of three."""
_TICK, _LABEL, _EDGE, _RIGHT = 0.12, 0.16, 0.1, 0.18
"""Room of a tick mark, a label beside its numbers, an edge, and half a number at the right, inches."""
_TITLE, _FIGURE_TITLE, _CAPTION, CAPTION_LINE = 0.22, 0.22, 0.18, 0.13
"""Room of the titles of a panel and of the figure, and of its caption and each further line of it, inches."""
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class PanelLayout(LayoutEngine):
    """Layout of equal panels in rows and columns, with room for titles, labels and the widest tick numbers.

    matplotlib's constrained layout measures every text that is drawn, twice: that takes longer than drawing.
    """

    _adjust_compatible = True
    _colorbar_gridspec = True

    def __init__(self, title: Text, caption: Text) -> None:
        """Lay out between a title and a caption of the figure; without their text they take no room."""
        super().__init__()
        self._title, self._caption = title, caption

    def execute(self, fig: Figure) -> None:
        """Lay out a figure whose panels were all made by one call of ``subplots``."""
        panels = [panel for panel in fig.axes if panel.get_visible()]
        width, height = fig.get_size_inches()
        rows, columns = fig.axes[0].get_subplotspec().get_gridspec().get_geometry()  # type: ignore[union-attr]
        side = _LABEL + _TICK + _CHARACTER * max(map(_characters, panels))
        top = _EDGE + _TITLE + _FIGURE_TITLE * bool(self._title.get_text())
        caption = self._caption.get_text()
        bottom = (
            _EDGE + _TICK + _LINE + _LABEL + _CAPTION * bool(caption) + CAPTION_LINE * caption.count("\n")
        )
        between = side + _EDGE
        panel_width = (width - columns * between - _RIGHT) / columns
        panel_height = (height - top - bottom - (rows - 1) * (_TITLE + _TICK)) / rows
        fig.subplots_adjust(
            left=between / width,
            right=1.0 - _RIGHT / width,
            bottom=bottom / height,
            top=1.0 - top / height,
            wspace=between / panel_width,
            hspace=(_TITLE + _TICK) / panel_height,
        )
        for panel in panels:
            panel.yaxis.set_label_coords((_LABEL - side) / panel_width, 0.5)
            panel.xaxis.set_label_coords(0.5, -(_TICK + _LINE) / panel_height)
        self._title.set_y(1.0 - _EDGE / height)
        self._caption.set_y(_EDGE / height)


def _characters(panel: Axes) -> int:
    """Return the number of characters of the longest number at the vertical axis that is in view."""
    low, high = sorted(panel.get_ylim())
    lengths, axis = [_LEAST_CHARACTERS], panel.yaxis
    for locator, formatter in (
        (axis.get_major_locator(), axis.get_major_formatter()),
        (axis.get_minor_locator(), axis.get_minor_formatter()),
    ):
        texts: Iterable[str] = formatter.format_ticks([at for at in locator() if low <= at <= high])
        lengths += [len(re.sub(r"\\\w+|[${}^]", "", text)) for text in texts]
    return max(lengths)


def write_decades(panel: Axes) -> None:
    """Mark the powers of ten alone on a logarithmic vertical axis of several decades, written without TeX."""
    low, high = panel.get_ylim()
    if panel.get_yscale() == "log" and high >= 100.0 * low:
        panel.yaxis.set_major_formatter(
            FuncFormatter(lambda value, _: "10" + str(round(np.log10(value))).translate(_SUPERSCRIPTS))
        )
        panel.yaxis.set_minor_locator(NullLocator())
