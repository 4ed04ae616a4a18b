"""Heat map of a table: one HTML page with filters, keyboard, and the numbers and the command of each cell."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from coop_pin.base.atomic_write import write_atomically
from coop_pin.description.scenario import Scenario

REPLAYS = "replays"
"""Folder of replays beside the page."""
_BETWEEN = " | "
_UNSAFE = re.compile("[^A-Za-z0-9.-]+")


def cell_text(names: Sequence[str]) -> str:
    """Return the name of a cell as the page and the command write it."""
    return _BETWEEN.join(names)


def cell_names(text: str) -> list[str]:
    """Return the names in the text of a cell."""
    return [name.strip() for name in text.split(_BETWEEN.strip())]


def replay_file(cells: Sequence[Sequence[str]]) -> str:
    """Return the file of the replay of one cell, or of several side by side, in the folder of replays."""
    return "--".join(_UNSAFE.sub("-", cell_text(names)) for names in cells) + ".html"


SERVED = '"served":false'
"""What a page says of itself; served pages say true: any cell opens its replay."""
_TIMES = 21


def wanted_squeeze(scenario: Scenario) -> float:
    """Return the largest desired internal force of a run, N; NaN where code of a user says it."""
    if scenario.squeeze.kind == "function":
        return float("nan")
    grasps = scenario.cell.grasps
    wrenches = [scenario.squeeze.at(t, grasps) for t in np.linspace(0.0, scenario.duration, _TIMES)]
    return float(np.linalg.norm(np.array(wrenches)[..., :3], axis=-1).max())


def write_heat_map(
    table: pd.DataFrame,
    path: Path,
    *,
    title: str,
    names: Sequence[str],
    rivals: Sequence[str],
    measures: Mapping[str, str],
    filters: Sequence[str] = (),
    notes: Sequence[str] = (),
    forces: Sequence[str] = (),
    squeezes: Sequence[float] = (),
    command: str,
    replay: str = "{cells}",
) -> None:
    """Write the heat map of a table as one page that loads nothing from elsewhere.

    The colour of a cell is the logarithm of its value over the least one among its rivals, that of an error
    of the internal force over the squeeze that is wanted, from 1 % on. The first measure is shown first.
    Replays that exist in the folder ``replays`` beside the page are linked; that of two cells has the one
    above first. Notes of which no row has a value are left out.

    Args:
        table: one row for each cell: names, measures (no value: not finite) with ``<measure>_low`` and
            ``<measure>_high`` if there are intervals, ``unsound`` and ``unkept``, whether some
            simulation is not sound and some task not kept, and ``failure``, the error of a run, or an empty
            text.
        path: the page.
        title: heading.
        names: columns that name a cell; the last one has the columns of the map.
        rivals: names in which cells differ that are compared with each other.
        measures: text and unit of each measure.
        filters: further columns that cells can be chosen by.
        notes: further columns that are shown with a cell.
        forces: measures that are errors of the internal force, N.
        squeezes: squeeze that is wanted in each row, N; NaN where none is known.
        command: command of a cell; "{scenario}" stands for that name or note of the cell, "{cells}" for the
            text of the cell, or of two, "{numbers}" for the note "number" likewise.
        replay: file of the replay, in the same way.
    """
    page = {
        "title": title,
        "names": {name: _coded(table[name]) for name in names},
        "rivals": list(rivals),
        "filters": {name: _coded(table[name]) for name in filters},
        "notes": {name: _coded(table[name]) for name in (*notes, "failure") if table[name].notna().any()},
        "unsound": table["unsound"].astype(int).tolist(),
        "unkept": table["unkept"].astype(int).tolist(),
        "measures": [
            {"text": text, "force": name in forces, **_numbers(table, name)}
            for name, text in measures.items()
        ],
        "wanted": [float(f"{force:.5g}") if force > 0.0 else None for force in squeezes],
        "command": command,
        "replay": replay,
        "replays": sorted(file.name for file in (path.parent / REPLAYS).glob("*.html")),
        "folder": REPLAYS,
        "served": False,
    }
    data = json.dumps(page, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    template = resources.files("coop_pin.sweeps").joinpath("heat_map.html").read_text(encoding="utf-8")
    write_atomically(path, lambda part: part.write_text(template.replace("DATA", data), encoding="utf-8"))


def _coded(column: pd.Series[Any]) -> dict[str, Any]:
    """Return the different texts of a column in their order, and the number of each row's text."""
    codes, texts = pd.factorize(
        column.map(lambda value: f"{value:.9g}" if isinstance(value, float) else str(value))
    )
    return {"texts": texts.tolist(), "codes": codes.tolist()}


def _numbers(table: pd.DataFrame, name: str) -> dict[str, list[float | None]]:
    """Return the values of a measure to five digits, and their intervals if there are any."""
    columns = {"values": table[name].to_numpy(dtype=float)}
    if f"{name}_low" in table:
        ends = {end: table[f"{name}_{end}"].to_numpy(dtype=float) for end in ("low", "high")}
        wide = ends["low"] < ends["high"]
        columns |= {end: np.where(wide, values, np.nan) for end, values in ends.items()}
    return {
        key: [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]
        for key, values in columns.items()
    }
