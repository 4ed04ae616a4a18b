"""Run the notebooks afresh, and store them with light outputs, so that they speak where nobody runs them.

    python tools/notebooks.py [01_your_own_arms ...]

The code of each is that of its ``.py`` twin. Figures and tables are kept; of a 3-D view remains a still
picture, with a line that tells how to get the view. The same code gives the same file: no times, no names of
the machine or of its folders. What would give them away is refused.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import json
import os
import re
import socket
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import v4
from PIL import Image

from coop_pin.viz.export import page_images

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
MOST_BYTES = 300_000
"""Largest size of a stored notebook: hosting sites show larger ones slowly, or not at all."""

STILL = "*Still picture of a 3-D view: run this cell for the view itself, which plays and turns.*"
_MARK = "coop_pin still"
_IFRAME = re.compile(r'<iframe srcdoc="(.*)" style=', re.DOTALL)
_WIDTH, _HEIGHT, _COLOURS = 1160, 580, 200
_LONGEST_S = 600
_TELLTALE = re.compile(r"0x[0-9a-f]{6,}|\b\d+(?:\.\d+)? m?s (?:of )?(?:wall|processor)")


def kind(output: Any) -> str:
    """Return "view", "figure", "table", "text" or "error"; the same of a stored output and of a new one.

    The line below a still picture is "".
    """
    data = output.get("data", {})
    text = "".join(data.get("text/html", ""))
    if "<iframe" in text or output.get("metadata", {}).get(_MARK):
        return "view"
    if "image/png" in data:
        return "figure"
    if "".join(data.get("text/markdown", "")) == STILL:
        return ""
    return "table" if text else "error" if output.output_type == "error" else "text"


def kinds(cell: Any) -> list[str]:
    """Return the kinds of a cell's outputs, in order; several texts in a row are one."""
    each = list(filter(None, map(kind, cell.outputs)))
    return [one for k, one in enumerate(each) if one != "text" or each[k - 1 : k] != ["text"]]


def executed(notebook: Any) -> Any:
    """Return a notebook with the outputs of a run in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook,
            timeout=_LONGEST_S,
            record_timing=False,
            coalesce_streams=True,
            store_widget_state=False,
            resources={"metadata": {"path": folder}},
        ).execute()
        names = (folder, str(NOTEBOOKS.parent), str(Path.home()), socket.gethostname(), sys.prefix)
    for cell in code_cells(notebook):
        kept = (output for output in cell.outputs if output.get("name") != "stderr")
        cell.outputs = [part for output in kept for part in light(output)]
        refuse(cell, names)
    return notebook


def code_cells(notebook: Any) -> Iterator[Any]:
    """Yield the cells with code."""
    return (cell for cell in notebook.cells if cell.cell_type == "code")


def light(output: Any) -> list[Any]:
    """Return an output without what a hosting site does not show, and the line below a still picture."""
    if "data" not in output:
        return [output]
    data, output.metadata = output.data, {}
    view = _IFRAME.search("".join(data.get("text/html", "")))
    if view:
        page = html.unescape(view[1])
        (picture,) = page_images(page, [_opening(page)], _WIDTH, _HEIGHT)
        still = {"image/png": small(picture), "text/plain": STILL.strip("*")}
        return [
            v4.new_output("display_data", still, metadata={_MARK: True}),
            v4.new_output("display_data", {"text/markdown": STILL, "text/plain": STILL.strip("*")}),
        ]
    if "image/png" in data:
        data["image/png"] = small(base64.b64decode(data["image/png"]))
    return [output]


def _opening(page: str) -> float:
    """Return the time at which a page opens, s."""
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return float(json.loads(data[1])["start"]) if data else 0.0


def small(image: bytes) -> str:
    """Return a PNG with few colours, in base64."""
    packed = io.BytesIO()
    picture = Image.open(io.BytesIO(image)).convert("RGB")
    picture.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        packed, "PNG", optimize=True
    )
    return base64.b64encode(packed.getvalue()).decode()


def refuse(cell: Any, names: tuple[str, ...]) -> None:
    """Refuse outputs that name the machine, a folder of it, or how long something took.

    Raises:
        ValueError: one does.
    """
    for output in cell.outputs:
        texts = [output.get("text", ""), *output.get("data", {}).values()]
        for text in ("".join(part) for part in texts if not _is_image(part)):
            telltale = [name for name in names if len(name) > 3 and name in text] + _TELLTALE.findall(text)
            if telltale:
                raise ValueError(f"an output has {telltale[0]!r}; the cell begins with {cell.source[:60]!r}")


def _is_image(part: Any) -> bool:
    return isinstance(part, str) and part.startswith("iVBOR")


def store(path: Path) -> int:
    """Run a notebook's twin, write it with its outputs, and return the size, bytes.

    Raises:
        ValueError: it is too large.
    """
    stored, twin = nbformat.read(path, as_version=4), jupytext.read(path.with_suffix(".py"))
    ids = {cell.source: cell.id for cell in stored.cells}
    for number, cell in enumerate(twin.cells):
        cell.id = ids.pop(cell.source, f"{path.stem[:2]}-{number:02}")
    notebook = executed(twin)
    notebook.metadata = stored.metadata
    text = nbformat.writes(notebook) + "\n"
    if len(text) > MOST_BYTES:
        raise ValueError(f"{path.name} has {len(text)} bytes; at most {MOST_BYTES}")
    path.write_text(text, encoding="utf-8")
    return len(text)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="of notebooks; all when omitted")
    names = parser.parse_args().names or sorted(path.stem for path in NOTEBOOKS.glob("*.py"))
    os.environ["PYTHONPATH"] = os.pathsep.join((str(NOTEBOOKS.parent), os.environ.get("PYTHONPATH", "")))
    for name in names:
        print(f"{name}: {store(NOTEBOOKS / f'{name}.ipynb') / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
