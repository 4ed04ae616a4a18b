"""Figures as files that are the same bytes for the same figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from coop_pin.results.atomic_write import write_atomically

_DPI = 150
_METADATA: dict[str, dict[str, Any]] = {".png": {"Software": None}, ".svg": {"Date": None}}


def save_figure(figure: Figure, stem: str | Path) -> tuple[Path, Path]:
    """Write a figure as PNG and as SVG; good files at those paths are never destroyed half-way.

    Args:
        figure: the figure.
        stem: path of the files without their suffix.

    Returns:
        The two paths.
    """
    png, svg = Path(f"{stem}.png"), Path(f"{stem}.svg")
    for path in (png, svg):
        write_atomically(path, lambda part: _write(figure, part))
    return png, svg


def _write(figure: Figure, part: Path) -> None:
    # matplotlib salts the names inside an SVG with a random number unless it is told one.
    with mpl.rc_context({"svg.hashsalt": "coop_pin"}):
        figure.savefig(part, dpi=_DPI, metadata=_METADATA[part.suffix])
