"""The page that replay and live view have in common; they differ in their controls, their data and their player."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from string import Template
from typing import Any

from coop_pin.figures import palette
from coop_pin.viz.arrows import ArrowScales
from coop_pin.viz.cell_scene import NEAR_SINGULAR
from coop_pin.viz.meshcat_commands import viewer_licences, viewer_script

LEGEND = (
    (palette.ACTUAL, "box", "payload and its path"),
    (palette.DESIRED, "box", "desired pose and path"),
    (palette.INTERNAL, "", "internal part, on each arm"),
    (palette.LOAD, "", "load-carrying part, on each arm"),
)
PUSH = (palette.EXTERNAL, "", "push on the payload")
SATURATED = (palette.SATURATED, "box", "link whose drive is at its torque limit")
SINGULAR = (palette.SINGULAR, "box", f"arm near a singular pose (condition over {NEAR_SINGULAR:g})")

FORCE, MOMENT, WHOSE = "force", "moment", "whose"
"""What the notes on arrows are about."""

_NOTED_LENGTH_M = 0.1
_ICONS = {
    FORCE: '<svg viewBox="0 0 22 8"><path d="M0 4h14M14 0l8 4-8 4z"/></svg>',
    MOMENT: '<svg viewBox="0 0 22 8"><path d="M0 4h9M8 0l7 4-7 4zM15 0l7 4-7 4z"/></svg>',
    WHOSE: "",
}


def page_html(
    kind: str,
    title: str,
    summary: str,
    entries: Sequence[tuple[str, str, str]],
    scales: ArrowScales,
    data: Any,
) -> str:
    """Return a page that needs nothing but itself.

    Args:
        kind: whose controls and player: "replay" or "live".
        title: its heading.
        summary: a sentence below; may be empty.
        entries: colour, kind of swatch and text of every line of the legend.
        scales: what the length of an arrow means.
        data: what the player reads, as JSON.
    """
    parts: Mapping[str, str] = {
        "style": _file("page.css"),
        "licences": viewer_licences(),
        "viewer": viewer_script(),
        "stage": _file("stage.js"),
        "controls": _file(f"{kind}.html"),
        "player": _file(f"{kind}.js"),
        "title": html.escape(title),
        "summary": html.escape(summary),
        "legend": "\n".join(
            f'<li><i class="{swatch}" style="background:{colour}"></i>{html.escape(text)}</li>'
            for colour, swatch, text in entries
        ),
        "arrows": "\n".join(
            f"<li>{_ICONS[about]}{html.escape(note)}</li>" for about, note in arrow_notes(scales).items()
        ),
        "data": json.dumps(data).replace("<", "\\u003c"),
    }
    return Template(_file("page.html")).substitute(parts)


def as_text(message: bytes) -> str:
    """Return bytes in base64."""
    return base64.b64encode(message).decode("ascii")


def arrow_notes(scales: ArrowScales) -> dict[str, str]:
    """Return what the arrows mean, by what each note is about: forces, moments where there are any, and whose they are."""
    notes = {FORCE: f"force: {_NOTED_LENGTH_M:g} m is {_NOTED_LENGTH_M * scales.newtons_per_metre:g} N"}
    whose = "arrows are by the payload on the arm, drawn at its grasp"
    if scales.newton_metres_per_metre is None:
        return {**notes, WHOSE: whose}
    moment = f"moment: {_NOTED_LENGTH_M:g} m is {_NOTED_LENGTH_M * scales.newton_metres_per_metre:g} N m"
    return {**notes, MOMENT: moment, WHOSE: f"{whose}; moments are about the payload's centre of mass"}


def _file(name: str) -> str:
    """Return a file of the folder ``page``."""
    return resources.files("coop_pin.viz").joinpath("page", name).read_text(encoding="utf-8")
