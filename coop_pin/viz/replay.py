"""Replay of a run, or of two on one clock: one HTML file that plays offline, or a view in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from coop_pin.arrays import typed
from coop_pin.model.visuals import CellVisuals
from coop_pin.results import RunResult
from coop_pin.viz.arrows import recorded_scales
from coop_pin.viz.cell_scene import cell_scene
from coop_pin.viz.curves import Curve, cell_curves, curve_rows, thinned_rows
from coop_pin.viz.frames import FRAMES_PER_SECOND, CellFrames, frame_samples, run_samples
from coop_pin.viz.highlights import instants, spans, telling_instant, trust_text
from coop_pin.viz.page import packed_run, page_frame, page_html, save_page


@typed
def replay_html(result: RunResult, other: RunResult | None = None, *, times: Iterable[float] = ()) -> str:
    """Return a page that replays a run: the cell in 3-D with its forces, tiles and time plots, on one clock.

    It opens paused at the instant of the largest error of the internal force. It needs no network and no
    server; building it starts no process and opens no port.

    Args:
        result: the run.
        other: a second run, shown as ghost arms and dashed curves on the same clock.
        times: further instants of which the page has the recorded sample, s.
    """
    runs = [result] if other is None else [result, other]
    start, chips = telling_instant(result).time, instants(result)
    shown = [start, *(chip.time for chip in chips), *times]
    curves = [cell_curves(run_samples(run), list(run.scenario.cell.arms)) for run in runs]
    packed = [_packed(*run, shown) for run in zip(runs, curves, strict=True)]
    if len(packed) > 1 and packed[1]["scene"]["meshes"] == packed[0]["scene"]["meshes"]:
        packed[1]["scene"]["meshes"] = None  # the page takes those of the first run
    data: dict[str, Any] = {
        "runs": packed,
        "duration": max(run.end for run in runs),
        "start": start,
        "spans": spans(result),
        "breaches": [{"time": breach.time, "text": str(breach)} for breach in result.breaches()],
        "instants": [chip._asdict() for chip in chips],
        "pushes": bool(result.data["external_wrench"].values.any()),
    }
    return page_html(
        "replay",
        " against ".join(dict.fromkeys(run.scenario.name for run in runs)),
        result.scenario.summary,
        told=_told(runs),
        scales=recorded_scales(result.scenario.cell, result.data),
        curves=curves,
        data=data,
    )


@typed
def save_replay(result: RunResult, path: str | Path, other: RunResult | None = None) -> None:
    """Write the replay page of a run; an existing file is replaced only by a complete one.

    Args:
        result: the run.
        path: the file, for example "replay.html".
        other: a second run to compare it with.
    """
    save_page(replay_html(result, other), path)


@typed
def notebook_view(result: RunResult, other: RunResult | None = None, *, height: int = 620) -> NotebookView:
    """Return a replay of a run that a notebook displays.

    Args:
        result: the run.
        other: a second run to compare it with.
        height: height of the view, pixels.
    """
    return NotebookView(replay_html(result, other), height)


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


def _packed(result: RunResult, curves: tuple[Curve, ...], instants: list[float]) -> dict[str, Any]:
    """Return a run as the page reads it, with the frames of some instants."""
    cell, samples = result.scenario.cell, run_samples(result)
    frames = CellFrames(cell, CellVisuals(cell, result.scenario.plant.payload))
    kept = frame_samples(samples["time"], FRAMES_PER_SECOND, instants)
    moving = {name: value[kept] for name, value in samples.items() if len(value) == len(samples["time"])}
    tips, path = samples["tip_position"], samples["payload_position"]
    k = int(np.abs(samples["time"] - instants[0]).argmin())
    scene = cell_scene(
        cell, frames.visuals.bodies, tips=tips[k], points=np.concatenate((path, *np.moveaxis(tips, 1, 0)))
    )
    return packed_run(
        frames,
        scene,
        list(cell.arms),
        samples["desired_position"],
        frames.rows(moving),
        thinned_rows(curve_rows(curves, samples), kept.tolist()),
    )


def _told(runs: list[RunResult]) -> str:
    """Return verdict and sentence of runs, as HTML; the sentence leads to its instant."""
    lines = []
    for run in runs:
        name = html.escape(f"{run.scenario.name}: ") if len(runs) > 1 else ""
        kind, instant = "verdict" if run.trustworthy else "verdict broken", telling_instant(run)
        lines += [
            f'<p class="{kind}">{name}{html.escape(trust_text(run))}</p>',
            f'<button class="told" data-time="{instant.time:g}"><small>largest error of the internal force '
            f"(click to go there)</small>{name}{html.escape(instant.text)}</button>",
        ]
    return "\n".join(lines)
