"""What replay and live page have in common."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

from coop_pin.viz import palette
from coop_pin.viz.meshcat_door import viewer_licences, viewer_script
from coop_pin.viz.tints import NEAR_SINGULAR

LEGEND = (
    (palette.ACTUAL, "box", "payload and its path"),
    (palette.DESIRED, "box", "desired pose and path"),
    (palette.INTERNAL, "", "internal force on each arm"),
    (palette.LOAD, "", "load-carrying force on each arm"),
)
PUSH = (palette.EXTERNAL, "", "push on the payload")
SATURATED = (palette.SATURATED, "box", "link whose drive is at its torque limit")
SINGULAR = (palette.SINGULAR, "box", f"arm near a singular pose (condition over {NEAR_SINGULAR:g})")


def common_parts() -> dict[str, str]:
    """Return what both pages' templates ask for: style, viewer with licences, stage."""
    return {
        "style": page_file("replay.css"),
        "licences": viewer_licences(),
        "viewer": viewer_script(),
        "stage": page_file("stage.js"),
    }


def legend(entries: Sequence[tuple[str, str, str]]) -> str:
    """Return the legend's lines."""
    return "\n".join(f'<li><i class="{kind}" style="background:{colour}"></i>{html.escape(text)}</li>' for colour, kind, text in entries)


def arrow_note(newtons_per_metre: float) -> str:
    """Return what an arrow's length means."""
    return f"Arrows: 0.1 m is {newtons_per_metre * 0.1:g} N; forces on the arm by the payload, drawn at its grasp."


def script_json(value: Any) -> str:
    """Return JSON that can stand inside a script element."""
    return json.dumps(value).replace("<", "\\u003c")


def as_text(message: bytes) -> str:
    """Return bytes in base64."""
    return base64.b64encode(message).decode("ascii")


def page_file(name: str) -> str:
    """Return a file of the folder ``page``."""
    return resources.files("coop_pin.viz").joinpath("page", name).read_text(encoding="utf-8")
