"""A replay of a run: one HTML file that plays offline."""

from __future__ import annotations

import base64
import html
import json
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from coop_pin.description.event import Event, PayloadChange
from coop_pin.description.scenario import Scenario
from coop_pin.results import RunResult
from coop_pin.results.storage import write_atomically
from coop_pin.viz import palette
from coop_pin.viz.arrows import newtons_per_metre
from coop_pin.viz.cell_scene import cell_scene
from coop_pin.viz.meshcat_door import scene_messages, viewer_licences, viewer_script

_LEGEND = (
    (palette.ACTUAL, "box", "payload and its path"),
    (palette.DESIRED, "box", "desired pose and path"),
    (palette.INTERNAL, "", "internal force on each arm"),
    (palette.LOAD, "", "load-carrying force on each arm"),
)
_PUSH = (palette.EXTERNAL, "", "push on the payload")


def replay_html(result: RunResult) -> str:
    """Return a page that replays a run in 3-D: meshcat's viewer, the scene, a clock, a slider and a legend.

    The page needs no network and no server, and building it starts neither a process nor a port. Its clock is the clock of the result;
    wrenches hold from tick to tick.

    Args:
        result: the run.
    """
    scenario, scene = result.scenario, cell_scene(result)
    run = {
        "duration": result.end,
        "events": [_event(scenario, event) for event in scenario.events if event.time <= result.end],
        "messages": [base64.b64encode(message).decode("ascii") for message in scene_messages(scene)],
    }
    return Template(_page_file("replay.html")).substitute(
        title=html.escape(scenario.name),
        summary=html.escape(scenario.summary),
        style=_page_file("replay.css"),
        legend=_legend(result),
        note=f"Arrows: 0.1 m is {newtons_per_metre(result.data) * 0.1:g} N; forces on the arm by the payload, drawn at its grasp.",
        licences=viewer_licences(),
        viewer=viewer_script(),
        run=json.dumps(run).replace("<", "\\u003c"),
        player=_page_file("replay.js"),
    )


def save_replay(result: RunResult, path: str | Path) -> None:
    """Write the replay page of a run; a good file at that path is never destroyed half-way.

    Args:
        result: the run.
        path: the file, for example "replay.html".
    """
    page = replay_html(result)
    write_atomically(Path(path), lambda part: part.write_text(page, encoding="utf-8"))


def _legend(result: RunResult) -> str:
    pushed = bool(result.data["external_wrench"].values.any())
    entries = (*_LEGEND, _PUSH) if pushed else _LEGEND
    return "\n".join(f'<li><i class="{kind}" style="background:{colour}"></i>{html.escape(text)}</li>' for colour, kind, text in entries)


def _event(scenario: Scenario, event: Event) -> dict[str, Any]:
    """Return what the page's player shows of an event."""
    if isinstance(event, PayloadChange):
        return {"start": event.time, "end": event.time, "text": f"mass {scenario.cell.payload.mass:g} \u2192 {event.mass:g} kg"}
    force, moment = event.wrench[:3], event.wrench[3:]
    parts = [f"({', '.join(f'{part:g}' for part in vector)}) {unit}" for vector, unit in ((force, "N"), (moment, "N m")) if any(vector)]
    return {"start": event.time, "end": event.end, "text": f"push {' and '.join(parts)} for {event.duration:g} s"}


def _page_file(name: str) -> str:
    return resources.files("coop_pin.viz").joinpath("page", name).read_text(encoding="utf-8")
