"""A replay of a run: one HTML file that plays offline."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

from coop_pin.description.events import Event, PayloadChange
from coop_pin.description.scenario import Scenario
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.arrows import recorded_scales
from coop_pin.viz.cell_scene import COLOURS, IS_SATURATED, IS_SINGULAR, body_tints, cell_scene, tint_changes
from coop_pin.viz.meshcat_commands import scene_messages
from coop_pin.viz.page import LEGEND, PUSH, SATURATED, SINGULAR, as_text, page_html


def replay_html(result: RunResult) -> str:
    """Return a page that replays a run in 3-D: meshcat's viewer, the scene, a clock, a slider and a legend.

    The page needs no network and no server, and building it starts neither a process nor a port. Its clock is
    the clock of the result; wrenches hold from tick to tick.

    Args:
        result: the run.
    """
    scenario, arms = result.scenario, CellVisuals(result.scenario.cell, result.scenario.plant.payload)
    scene, warned = cell_scene(result, arms=arms), _tints(result, arms)
    run = {
        **warned,
        "colours": COLOURS,
        "duration": result.end,
        "events": [_event(scenario, event) for event in scenario.events if event.time <= result.end],
        "messages": [as_text(message) for message in scene_messages(scene)],
    }
    legend = _legend(result, {code for _, _, code in warned["tints"]})
    return page_html(
        "replay", scenario.name, scenario.summary, legend, recorded_scales(scenario.cell, result.data), run
    )


def save_replay(result: RunResult, path: str | Path) -> None:
    """Write the replay page of a run; a good file at that path is never destroyed half-way.

    Args:
        result: the run.
        path: the file, for example "replay.html".
    """
    page = replay_html(result)
    write_atomically(Path(path), lambda part: part.write_text(page, encoding="utf-8"))


def _tints(result: RunResult, arms: CellVisuals) -> dict[str, Any]:
    """Return the bodies whose colour can change and every change of it."""
    data, names = result.data, [body.name for body in arms.bodies]
    codes = body_tints(
        names, arms.joints, data["saturated"].values.astype(bool), data["jacobian_condition"].values
    )
    return {"bodies": [f"arms/{name}" for name in names], "tints": tint_changes(data["time"].values, codes)}


def _legend(result: RunResult, codes: set[float]) -> tuple[tuple[str, str, str], ...]:
    """Return the legend: what never shows is left out."""
    shown = (
        (bool(result.data["external_wrench"].values.any()), PUSH),
        (IS_SATURATED in codes, SATURATED),
        (IS_SINGULAR in codes, SINGULAR),
    )
    return (*LEGEND, *(entry for is_shown, entry in shown if is_shown))


def _event(scenario: Scenario, event: Event) -> dict[str, Any]:
    """Return what the page's player shows of an event."""
    if isinstance(event, PayloadChange):
        return {
            "start": event.time,
            "end": event.time,
            "text": f"mass {scenario.cell.payload.mass:g} \u2192 {event.mass:g} kg",
        }
    force, moment = event.wrench[:3], event.wrench[3:]
    parts = [
        f"({', '.join(f'{part:g}' for part in vector)}) {unit}"
        for vector, unit in ((force, "N"), (moment, "N m"))
        if any(vector)
    ]
    return {
        "start": event.time,
        "end": event.end,
        "text": f"push {' and '.join(parts)} for {event.duration:g} s",
    }


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
