"""HTML of the pages: 3-D scene, time plots and tiles on one clock; one file that needs no other."""

from __future__ import annotations

import base64
import gzip
import html
import importlib.util
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from coop_pin.base.arrays import Array
from coop_pin.base.atomic_write import write_atomically
from coop_pin.description.cell.cell import Cell
from coop_pin.figures import palette
from coop_pin.viz.curves import Curve, plot_table
from coop_pin.viz.frames import WARNING_COLOURS, CellFrames
from coop_pin.viz.scene import (
    LINEAR_M,
    LOGARITHMIC,
    LONGEST_M,
    ArrowScales,
    Scene,
    base64_floats,
    packed_scene,
)

_PATH_POINTS = 240
SCRIPTS, DATA = "<!--scripts-->", "<!--data-->"
"""Where scripts and data of a page go; no text of a run has them, since its < are escaped."""
_COLOURS = {
    "payload": palette.ACTUAL,
    "squeezed": "#06263d",
    "torn": "#f0883e",
    "internal": palette.INTERNAL,
    "wanted": palette.DESIRED,
    "load": palette.LOAD,
    "external": palette.EXTERNAL,
    "saturated": palette.SATURATED,
    "singular": palette.SINGULAR,
    "free": palette.FREE,
    "slides": palette.SLIDES,
    "floor": palette.FLOOR,
    "floor_lines": palette.FLOOR_LINES,
}


def packed_run(
    frames: CellFrames, scene: Scene, cell: Cell, desired: Array, rows: Array, curves: Array
) -> dict[str, Any]:
    """Return a run as the page reads it.

    Args:
        frames: layout of the rows.
        scene: scene of the run.
        cell: the cell.
        desired: desired path of P, m, shape (p, 3).
        rows: frames, shape (n, columns).
        curves: time and values of the curves, shape (k, 1 + curves).
    """
    return {
        "arms": list(cell.arms),
        "bases": [arm.base.xyz for arm in cell.arms.values()],
        "arm_colours": [palette.arm(number) for number in range(len(cell.arms))],
        "desired": base64_floats(desired[:: max(len(desired) // _PATH_POINTS, 1)]),
        "scene": packed_scene(scene),
        "nodes": frames.nodes,
        "blocks": frames.blocks,
        "frames": base64_floats(rows),
        "columns": curves.shape[1],
        "curves": base64_floats(curves),
    }


def page_html(layout: str, page: Mapping[str, Any]) -> str:
    """Return a self-contained page from its parts, as of ``page_parts``."""
    return layout.replace(DATA, json_text(page)).replace(SCRIPTS, page_scripts())


def inside_page(replay: str) -> str:
    """Return a replay as elements of another page: packed, and the script that unpacks it."""
    page = replay.replace('class="replay"', 'class="replay inside"', 1).encode()
    packed = base64.b64encode(gzip.compress(page, mtime=0)).decode("ascii")
    return (
        f'<iframe class="screen" title="replay in 3-D" loading="lazy" data-page="{packed}"></iframe>\n'
        '<canvas class="paper" id="picture" role="img" aria-label="the cell and its forces" hidden></canvas>'
        f"<script>\n{web_file('inside.js')}</script>"
    )


def page_parts(
    kind: str,
    title: str,
    summary: str,
    *,
    verdict: str = "",
    scales: ArrowScales,
    curves: Sequence[Curve],
    data: Mapping[str, Any],
) -> tuple[str, dict[str, Any]]:
    """Return a page with marks where its scripts and data go, and its data.

    Args:
        kind: "replay" or "live".
        title: heading.
        summary: sentence below the heading; may be empty.
        verdict: HTML above the tiles: verdict and sentence.
        scales: scales of the arrows.
        curves: curves of the plots.
        data: entries of the page's data besides plots, colours and scales.
    """
    forces, moments = scales
    thickest = LINEAR_M * forces * math.exp((LONGEST_M / LINEAR_M - 1.0) / LOGARITHMIC)
    page = {
        "plots": plot_table(curves),
        "colours": _COLOURS,
        "warning_colours": WARNING_COLOURS,
        "scales": {
            "forces": forces,
            "moments": moments,
            "linear": LINEAR_M,
            "logarithmic": LOGARITHMIC,
            "longest": LONGEST_M,
        },
        **{
            "spans": [],
            "breaches": [],
            "instants": [],
            "start": 0.0,
            "live": False,
            "still": "",
            "pushes": True,
            "peak": thickest,
        },
        **data,
    }
    layout = Template(web_file("page.html")).substitute(
        kind=kind,
        style=web_file("uplot/uPlot.min.css") + web_file("page.css"),
        licences=page_licences(),
        scripts=SCRIPTS,
        player=(web_file("push.js") if kind == "live" else "") + web_file("player.js"),
        title=html.escape(title),
        summary=html.escape(summary),
        verdict=verdict,
        **_COLOURS,
        scale=f"0.1 m of arrow: {0.1 * forces:g} N" + ("" if moments is None else f", {0.1 * moments:g} N m"),
        linear=f"{LINEAR_M * forces:g}",
        data=DATA,
    )
    return layout, page


def page_scripts() -> str:
    """Return the scripts that a page runs before its data are read."""
    scripts = ("uplot/uPlot.iife.min.js", "labels.js", "forces.js", "stage.js", "plots.js")
    return "\n".join((_viewer_file("main.min.js"), *map(web_file, scripts)))


def page_licences() -> str:
    """Return the licences of the scripts."""
    return _viewer_file("main.min.js.LICENSE.txt") + "\nuPlot:\n" + web_file("uplot/LICENSE")


def json_text(value: Any) -> str:
    """Return a value as JSON that can stand in a page."""
    return json.dumps(value).replace("<", "\\u003c")


def save_page(page: str, path: str | Path) -> None:
    """Write a page; an existing file is replaced only by a complete one."""
    write_atomically(Path(path), lambda part: part.write_text(page, encoding="utf-8"))


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


def _viewer_file(name: str) -> str:
    """Return a file of meshcat's viewer, which holds three.js."""
    meshcat: Any = importlib.util.find_spec("meshcat")  # not loaded: its server takes a quarter of a second
    return Path(meshcat.origin).with_name("viewer").joinpath("dist", name).read_text(encoding="utf-8")


def web_file(name: str) -> str:
    """Return the text of a file in the folder ``web``."""
    return resources.files("coop_pin.viz").joinpath("web", name).read_text(encoding="utf-8")
