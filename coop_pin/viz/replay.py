"""Replay of a run: one HTML file that plays offline, or a view in a notebook."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.description.events import Event, PayloadChange
from coop_pin.description.scenario import Scenario
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.arrows import recorded_scales
from coop_pin.viz.cell_scene import PLAIN, WARNING_COLOURS, cell_scene, warning_colours
from coop_pin.viz.meshcat_commands import scene_messages
from coop_pin.viz.page import LEGEND, PUSH, WARNINGS, base64_text, page_frame, page_html


def replay_html(result: RunResult) -> str:
    """Return a page that replays a run in 3-D, with the forces drawn, a clock, a time slider and a legend.

    The page needs no network and no server; building it starts no process and opens no port. Its clock is the
    clock of the result.

    Args:
        result: the run.
    """
    scenario, arms = result.scenario, CellVisuals(result.scenario.cell, result.scenario.plant.payload)
    names, changes = [body.name for body in arms.bodies], _warning_changes(result, arms)
    run = {
        "bodies": [f"arms/{name}" for name in names],
        "warning_changes": changes,
        "warning_colours": WARNING_COLOURS,
        "duration": result.end,
        "events": [_event(scenario, event) for event in scenario.events if event.time <= result.end],
        "messages": [base64_text(message) for message in scene_messages(cell_scene(result, arms=arms))],
    }
    shown = {code for _, _, code in changes}
    legend = (
        *LEGEND,
        *([PUSH] if result.data["external_wrench"].values.any() else ()),
        *(line for code, line in WARNINGS.items() if code in shown),
    )
    scales = recorded_scales(scenario.cell, result.data)
    return page_html("replay", scenario.name, scenario.summary, legend, scales, run)


def save_replay(result: RunResult, path: str | Path) -> None:
    """Write the replay page of a run; an existing file is replaced only by a complete one.

    Args:
        result: the run.
        path: the file, for example "replay.html".
    """
    page = replay_html(result)
    write_atomically(Path(path), lambda part: part.write_text(page, encoding="utf-8"))


def notebook_view(result: RunResult, *, height: int = 480) -> NotebookView:
    """Return a replay of a run that a notebook displays.

    Args:
        result: the run.
        height: height of the view, pixels.
    """
    return NotebookView(replay_html(result), height)


class NotebookView:
    """Page that a notebook displays as the result of a cell; without a server, so it works behind any proxy.

    Args:
        page: the page's HTML.
        height: pixels.
    """

    def __init__(self, page: str, height: int) -> None:
        self._page, self._height = page, height

    def _repr_html_(self) -> str:
        """Return the page in an iframe, for IPython."""
        return page_frame(self._height, "coop_pin replay", srcdoc=self._page)


def _warning_changes(result: RunResult, arms: CellVisuals) -> list[tuple[float, int, int]]:
    """Return time, body and code of every change of a warning colour, in order of time."""
    data, names = result.data, [body.name for body in arms.bodies]
    saturated, condition = data["saturated"].values.astype(bool), data["jacobian_condition"].values
    codes, time = warning_colours(names, arms.joints, saturated, condition), data["time"].values
    changes = np.argwhere(np.diff(codes, axis=0, prepend=np.full((1, len(names)), PLAIN, codes.dtype)))
    return [(float(time[sample]), int(body), int(codes[sample, body])) for sample, body in changes]


def _event(scenario: Scenario, event: Event) -> dict[str, Any]:
    """Return start, end and description of an event, for the page's player."""
    if isinstance(event, PayloadChange):
        text = f"mass {scenario.cell.payload.mass:g} \u2192 {event.mass:g} kg"
        return {"start": event.time, "end": event.time, "text": text}
    parts = [
        f"({', '.join(f'{part:g}' for part in vector)}) {unit}"
        for vector, unit in ((event.wrench[:3], "N"), (event.wrench[3:], "N m"))
        if any(vector)
    ]
    text = f"push {' and '.join(parts)} for {event.duration:g} s"
    return {"start": event.time, "end": event.end, "text": text}
