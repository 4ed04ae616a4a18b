"""HTML page of the 3-D views: template and legend of replay and live view, and the iframe around a page.

The pages differ in their controls, their data and their player (``page/replay.*`` and ``page/live.*``). Every
page is one file that needs no other.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib import resources
from string import Template
from typing import Any

from coop_pin.figures import palette
from coop_pin.viz.arrows import ArrowScales
from coop_pin.viz.cell_scene import NEAR_SINGULAR, SATURATED, SINGULAR
from coop_pin.viz.meshcat_commands import viewer_file

LEGEND = (
    (palette.ACTUAL, "box", "payload and its path"),
    (palette.DESIRED, "box", "desired pose and path"),
    (palette.INTERNAL, "", "internal part, on each arm"),
    (palette.LOAD, "", "load-carrying part, on each arm"),
)
"""Colour, CSS class and text of the lines that every legend has."""

PUSH = (palette.EXTERNAL, "", "push on the payload")
WARNINGS = {
    SATURATED: (palette.SATURATED, "box", "link whose drive is at its torque limit"),
    SINGULAR: (palette.SINGULAR, "box", f"arm near a singularity (condition number over {NEAR_SINGULAR:g})"),
}
"""Legend of the warning colours, by code."""

_NOTED_LENGTH_M = 0.1
_FORCE_ICON = '<svg viewBox="0 0 22 8"><path d="M0 4h14M14 0l8 4-8 4z"/></svg>'
_MOMENT_ICON = '<svg viewBox="0 0 22 8"><path d="M0 4h9M8 0l7 4-7 4zM15 0l7 4-7 4z"/></svg>'


def page_html(
    kind: str,
    title: str,
    summary: str,
    legend: Sequence[tuple[str, str, str]],
    scales: ArrowScales,
    data: Any,
) -> str:
    """Return a self-contained page.

    Args:
        kind: controls and player: "replay" or "live".
        title: heading.
        summary: sentence below the heading; may be empty.
        legend: colour, CSS class and text of each line of the legend.
        scales: scales of the arrows.
        data: input of the player, written as JSON.
    """
    return Template(_file("page.html")).substitute(
        style=_file("page.css"),
        licences=viewer_file("main.min.js.LICENSE.txt"),
        viewer=viewer_file("main.min.js"),
        stage=_file("stage.js"),
        controls=_file(f"{kind}.html"),
        player=_file(f"{kind}.js"),
        title=html.escape(title),
        summary=html.escape(summary),
        legend="\n".join(
            f'<li><i class="{shape}" style="background:{colour}"></i>{html.escape(text)}</li>'
            for colour, shape, text in legend
        ),
        arrows="\n".join(f"<li>{icon}{html.escape(note)}</li>" for icon, note in _arrow_notes(scales)),
        data=json.dumps(data).replace("<", "\\u003c"),
    )


def base64_text(message: bytes) -> str:
    """Return bytes in base64."""
    return base64.b64encode(message).decode("ascii")


def page_frame(height: int, title: str, **source: str) -> str:
    """Return a page as a frame inside another page.

    Args:
        height: pixels.
        title: description for screen readers.
        **source: ``srcdoc`` with the page's HTML, or ``src`` with its address.
    """
    ((attribute, value),) = source.items()
    style = f"width: 100%; height: {height}px; border: 0"
    return f'<iframe {attribute}="{html.escape(value)}" style="{style}" title="{title}"></iframe>'


def _arrow_notes(scales: ArrowScales) -> list[tuple[str, str]]:
    """Return icon and text of the notes on arrows: scale of forces, scale of moments, convention."""
    force = f"force: {_NOTED_LENGTH_M:g} m is {_NOTED_LENGTH_M * scales.newtons_per_metre:g} N"
    convention = "arrows are by the payload on the arm, drawn at its grasp"
    if scales.newton_metres_per_metre is None:
        return [(_FORCE_ICON, force), ("", convention)]
    moment = f"moment: {_NOTED_LENGTH_M:g} m is {_NOTED_LENGTH_M * scales.newton_metres_per_metre:g} N m"
    convention += "; moments are about the payload's centre of mass"
    return [(_FORCE_ICON, force), (_MOMENT_ICON, moment), ("", convention)]


def _file(name: str) -> str:
    """Return a file of the folder ``page``."""
    return resources.files("coop_pin.viz").joinpath("page", name).read_text(encoding="utf-8")
