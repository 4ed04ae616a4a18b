"""Saving of figures, as PNG, SVG and PDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import matplotlib as mpl
from matplotlib.backend_bases import get_registered_canvas_class
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.errors import NameNotFoundError

_DPI = 150
_COLUMN, _PAGE = 3.5, 7.16
"""Widths of one and of two columns of a paper, inches."""
Format: TypeAlias = Literal["png", "svg", "pdf"]


@typed
def save_figure(
    figure: Figure,
    stem: str | Path,
    *,
    formats: Sequence[Format] | None = None,
    paper: bool = False,
) -> tuple[Path, ...]:
    """Write a figure as PNG, SVG or PDF; if writing fails, older files at these paths stay.

    It is laid out once, and drawn once for each format: Figure.savefig does both twice.

    Args:
        figure: the figure.
        stem: path of the files without their suffix, or with that of a format.
        formats: formats to write; when omitted that of the suffix, or else PNG and SVG, for a paper PDF.
        paper: make it as wide as one or two columns of a paper (3.5 or 7.16 inches), without a title inside,
            with fonts that can be searched; text keeps its size.

    Returns:
        The paths.

    Raises:
        NameNotFoundError: there is no such format.
    """
    stem, suffix = Path(stem), Path(stem).suffix[1:]
    named = [kind for kind in get_args(Format) if kind == suffix]
    formats = formats or named or (("pdf",) if paper else ("png", "svg"))
    for kind in formats:
        if kind not in get_args(Format):
            raise NameNotFoundError("format", str(kind), get_args(Format), "save_figure")
    stem = stem.with_suffix("") if named else stem
    paths = tuple(stem.with_name(f"{stem.name}.{kind}") for kind in formats)
    if paper:
        figure.suptitle("")
        figure.supxlabel("")
        width, height = figure.get_size_inches()
        fitted = _COLUMN if width < 6.0 else _PAGE
        figure.set_size_inches(fitted, height * fitted / width)
    engine, dpi, canvas = figure.get_layout_engine(), figure.dpi, figure.canvas
    # Without a fixed salt, matplotlib makes the ids inside an SVG random.
    with mpl.rc_context({"svg.hashsalt": "coop_pin", "pdf.fonttype": 42}):
        try:
            figure.dpi = _DPI
            if engine is not None:
                engine.execute(figure)
            figure.set_layout_engine("none")
            for path in paths:
                write_atomically(path, lambda part: _write(figure, part))
        finally:
            figure.dpi = dpi
            figure.set_layout_engine(engine)
            figure.set_canvas(canvas)
    return paths


def _write(figure: Figure, part: Path) -> None:
    kind = part.suffix[1:]
    canvas: Any = get_registered_canvas_class(kind)(figure)  # loads the backend: that of PDF takes 0.2 s
    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}
    getattr(canvas, f"print_{kind}")(part, metadata=metadata[kind])
