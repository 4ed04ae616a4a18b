"""A replay inside a notebook."""

from __future__ import annotations

import html

from coop_pin.results import RunResult
from coop_pin.viz.replay import replay_html


class NotebookView:
    """A page that a notebook shows where a cell returns it; it needs no server, so it works behind any proxy.

    Args:
        page: the page's HTML.
        height: pixels.
    """

    def __init__(self, page: str, height: int) -> None:
        self._page, self._height = page, height

    def _repr_html_(self) -> str:
        """Return the page in a frame of its own, for IPython."""
        return page_frame(self._page, self._height, "coop_pin replay")


def page_frame(page: str, height: int, title: str) -> str:
    """Return a whole page as a frame inside another.

    Args:
        page: the page's HTML.
        height: pixels.
        title: for those who hear pages read.
    """
    return f'<iframe srcdoc="{html.escape(page)}" style="width: 100%; height: {height}px; border: 0" title="{title}"></iframe>'


def notebook_view(result: RunResult, height: int = 480) -> NotebookView:
    """Return a replay of a run that a notebook displays.

    Args:
        result: the run.
        height: of the view, pixels.
    """
    return NotebookView(replay_html(result), height)
