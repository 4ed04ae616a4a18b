"""Replay of a run, or of several side by side: one HTML file that plays offline, or a view in a notebook."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.errors import FieldError
from coop_pin.figures import palette
from coop_pin.model.visuals import CellVisuals
from coop_pin.results.breaches import in_time
from coop_pin.results.quantity import Samples
from coop_pin.results.run_result import RunResult
from coop_pin.viz.camera import arrow_ends, link_points, travels
from coop_pin.viz.cell_scene import cell_scene
from coop_pin.viz.curves import PLOTS, Curve, cell_curves, curve_rows, thinned_rows
from coop_pin.viz.frames import FRAMES_PER_SECOND, CellFrames, frame_samples, run_samples, strut_columns
from coop_pin.viz.highlights import (
    VerdictLine,
    events_text,
    instants,
    spans,
    telling_instant,
    verdict_lines,
)
from coop_pin.viz.page import (
    DATA,
    SCRIPTS,
    json_text,
    packed_run,
    page_frame,
    page_html,
    page_licences,
    page_parts,
    page_scripts,
    save_page,
    web_file,
)
from coop_pin.viz.scene import LINEAR_M, ArrowScales, base64_floats, recorded_scales

_MOST_RUNS = 4
_FALLS_S = 0.2
"""Time over which the camera shows a payload that falls, s."""
_MOST_NUMBERS = 200_000
"""Numbers of the frames of a page, 1.1 MB of at most 3: frames of long runs are further apart."""


@typed
def replay_html(
    result: RunResult, *others: RunResult, names: Sequence[str] = (), times: Iterable[float] = ()
) -> str:
    """Return a page that replays a run: the cell in 3-D with its forces, tiles and time plots, on one clock.

    Several runs stand side by side, with arrows of one scale, linked cameras and common plots. The page opens
    paused at the instant of the largest error of the internal force, of the run that has it. It needs no
    network and no server; building it starts no process and opens no port.

    Args:
        result: the run.
        *others: up to three runs beside it.
        names: headings of several runs; what they differ in when omitted.
        times: further instants of which the page has the recorded sample, s.

    Raises:
        FieldError: there are more than four runs, or not as many names as runs.
    """
    if not others:
        scales = recorded_scales(result.scenario.cell, result.data)
        return page_html(*_replay(result, times, scales, _curves(result), _MOST_NUMBERS))
    runs = (result, *others)
    names = names or run_names(runs)
    if len(runs) > _MOST_RUNS or len(names) != len(runs):
        raise FieldError(f"are {len(runs)}, and {len(names)} names; a page has up to {_MOST_RUNS}", "runs")
    return _side_by_side(runs, names, list(times))


@typed
def save_replay(result: RunResult, path: str | Path, *others: RunResult, names: Sequence[str] = ()) -> None:
    """Write the replay page of a run; an existing file is replaced only by a complete one.

    Args:
        result: the run.
        path: the file, for example "replay.html".
        *others: up to three runs beside it.
        names: headings of several runs.
    """
    save_page(replay_html(result, *others, names=names), path)


@typed
def notebook_view(result: RunResult, *others: RunResult, height: int = 620) -> NotebookView:
    """Return a replay of a run that a notebook displays.

    Args:
        result: the run.
        *others: up to three runs beside it.
        height: height of the view, pixels.
    """
    return NotebookView(replay_html(result, *others), height)


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


def _packed(
    result: RunResult, curves: tuple[Curve, ...], instants: list[float], scales: ArrowScales, most: int
) -> dict[str, Any]:
    """Return a run as the page reads it, with the frames of some instants; the camera frames the first."""
    cell, samples = result.scenario.cell, run_samples(result)
    partners = result.scenario.partners
    nearest, visuals = "nearest_points" in samples, CellVisuals(cell, result.scenario.plant.payload)
    frames = CellFrames(cell, visuals, partners, nearest=nearest)
    numbers = sum(frames.blocks.values()) + 1 + len(curves)
    rate = min(FRAMES_PER_SECOND, most / (numbers * max(result.end, 1.0)))
    kept = frame_samples(samples["time"], rate, instants)
    moving = {name: value[kept] for name, value in samples.items() if len(value) == len(samples["time"])}
    scene = cell_scene(
        cell,
        frames.visuals.bodies,
        partners,
        nearest=nearest,
        **_framed(frames, result, samples, instants, scales),
    )
    plotted = thinned_rows(curve_rows(curves, samples), kept.tolist())
    return packed_run(frames, scene, cell, samples["desired_position"], frames.rows(moving), plotted)


def _framed(
    frames: CellFrames, result: RunResult, samples: Samples, instants: list[float], scales: ArrowScales
) -> dict[str, Array]:
    """Return what the camera frames: links and tips at the first instant, and the arrows at all instants."""
    time, path = samples["time"], samples["payload_position"]
    held = time <= result.dropped_at + _FALLS_S if np.isfinite(result.dropped_at) else slice(None)
    seen = np.array([int(np.abs(time - instant).argmin()) for instant in instants])
    at, now = path[seen[0]], {name: value[seen] for name, value in samples.items() if len(value) == len(time)}
    ends = arrow_ends(now, scales)
    (links,) = frames.visuals.poses(now["configuration"][:1])
    if is_followed := travels(path[held], at):
        ends += (at - path[seen])[:, None]
    tips = samples["tip_position"][seen[0] if is_followed else held].reshape(-1, 3)
    return {
        "tips": samples["tip_position"][seen[0]],
        "path": path[held],
        "at": at,
        "shown": np.concatenate((link_points(frames.visuals.bodies, links), ends.reshape(-1, 3), tips)),
    }


def _curves(result: RunResult) -> tuple[Curve, ...]:
    return cell_curves(run_samples(result), result.scenario.cell)


def _replay(
    result: RunResult, times: Iterable[float], scales: ArrowScales, curves: tuple[Curve, ...], most: int
) -> tuple[str, dict[str, Any]]:
    """Return the parts of the page of one run."""
    start, chips = telling_instant(result).time, instants(result)
    data: dict[str, Any] = {
        "runs": [_packed(result, curves, [start, *(chip.time for chip in chips), *times], scales, most)],
        "duration": result.end,
        "start": start,
        "spans": spans(result),
        "breaches": [
            {"time": breach.time, "text": str(breach)}
            for breach in in_time([*result.breaches(), *result.task.deviations])
        ],
        "instants": [chip._asdict() for chip in chips],
        "pushes": bool(result.data["external_wrench"].values.any()),
        "peak": float(
            np.abs(strut_columns(run_samples(result), result.scenario.cell)[0][..., 0]).max(initial=0.0)
        ),
    }
    return page_parts(
        "replay",
        result.scenario.name,
        result.scenario.caption,
        verdict=_verdict(result),
        scales=scales,
        curves=curves,
        data=data,
    )


def _verdict(result: RunResult) -> str:
    """Return sentence and verdict of a run, as HTML; the sentence leads to its instant."""
    instant = telling_instant(result)
    known = [VerdictLine(f"known before the run: {finding}", is_good=False) for finding in result.findings]
    lines = "\n".join(map(_verdict_line, [*verdict_lines(result), *known]))
    happened = events_text(result)
    return (
        f'<div id="verdicts">\n{lines}\n</div>\n'
        + f'<p class="happened">{html.escape(happened)}</p>\n' * bool(happened)
        + f'<button class="told" data-time="{instant.time:g}"><small>largest error of the internal force '
        f"(click to go there)</small>{html.escape(instant.text)}</button>"
    )


def _verdict_line(line: VerdictLine) -> str:
    """Return a verdict as HTML; a click on it shows what was judged."""
    kind, text = "verdict" if line.is_good else "verdict broken", html.escape(line.text)
    if not line.numbers:
        return f'<p class="{kind}">{text}</p>'
    return f'<details class="{kind}"><summary>{text}</summary>{html.escape(line.numbers)}</details>'


# ---------------------------------------------------------------- side by side


def run_names(runs: Sequence[RunResult]) -> list[str]:
    """Return headings of runs: what they differ in of scenario and law, otherwise numbers."""
    scenarios = [run.scenario for run in runs]
    for names in ([one.name for one in scenarios], [str(one.controller.kind) for one in scenarios]):
        if len(set(names)) == len(names):
            return names
    return [f"run {number}" for number in range(1, len(runs) + 1)]


def _side_by_side(runs: Sequence[RunResult], names: Sequence[str], times: list[float]) -> str:
    """Return the page of several runs: panes with one copy of the scripts and of equal meshes."""
    scales = [recorded_scales(run.scenario.cell, run.data) for run in runs]
    moments = [moment for _, moment in scales if moment is not None]
    # Of the run with the least forces: its arrows are seen, too, and long ones are shortened.
    common = ArrowScales(min(force for force, _ in scales), min(moments) if moments else None)
    tellings = [telling_instant(run).time for run in runs]
    errors = [float(np.nan_to_num(np.abs(run.data["internal_axial_error"].values)).max()) for run in runs]
    most = _MOST_NUMBERS // len(runs)
    tiles = {plot.key for plot in PLOTS if plot.tile}  # a pane has no plots
    panes = [
        _replay(
            run, [*tellings, *times], common, tuple(one for one in _curves(run) if one.plot in tiles), most
        )
        for run in runs
    ]
    peak = max(pane["peak"] for _, pane in panes)
    for _, pane in panes:
        pane["peak"] = peak  # of one scale of struts
    first = panes[0][1]["runs"][0]["scene"]["meshes"]
    for scene in (pane["runs"][0]["scene"] for _, pane in panes[1:]):
        scene["meshes"] = None if scene["meshes"] == first else scene["meshes"]  # None: those of the first
    page = {
        "names": names,
        "colours": [palette.series(number) for number in range(len(runs))],
        "panes": panes,
        "scripts": SCRIPTS,
        "mark": DATA,
        "curves": [base64_floats(_common_curves(run)) for run in runs],
        "duration": max(run.end for run in runs),
        "start": tellings[int(np.argmax(errors))],
    }
    return Template(web_file("side_by_side.html")).substitute(
        title=html.escape(" | ".join(names)),
        count=len(runs),
        shared=html.escape(shared_caption([run.scenario.caption for run in runs])),
        scale=f"{0.1 * common.newtons_per_metre:g} N in every pane, beyond "
        f"{LINEAR_M * common.newtons_per_metre:g} N arrows are shortened and their numbers tell",
        style=web_file("uplot/uPlot.min.css"),
        licences=page_licences(),
        scripts=page_scripts(),
        data=json_text(page),
    )


def shared_caption(captions: Sequence[str]) -> str:
    """Return what all captions say, as one line; empty if they have nothing in common."""
    first, *others = (re.split("; |changed: ", caption) for caption in captions)
    common = [text for text in first if text and all(text in other for other in others)]
    return f"in all: {'; '.join(common)}" if common else ""


def _common_curves(run: RunResult) -> Array:
    """Return time, s, the largest axial internal force, N, and the position error, mm, shape (n, 3)."""
    axial = np.nan_to_num(run.data["internal_axial"].values)
    largest = np.take_along_axis(axial, np.abs(axial).argmax(axis=1)[:, None], axis=1)
    distance = 1e3 * np.linalg.norm(run.data["pose_error"].values[:, :3], axis=1)
    return thinned_rows(np.column_stack((run.data["time"].values, largest, distance)))
