"""One page that tells a whole run: what was run, how it went, what the arms did to each other, and the motion in 3-D.

Everything is loaded on first use: the figures and the replay take their time.
"""

from __future__ import annotations

from typing import Any

from coop_pin.lazy import load_public

_PUBLIC = {
    "internal_force_figure": "coop_pin.figures.run_figures",
    "motion_figure": "coop_pin.figures.motion_figure",
    "report_html": "coop_pin.report.report",
    "save_report": "coop_pin.report.report",
    "singularity_figure": "coop_pin.figures.run_figures",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    return load_public(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    """List the public names."""
    return list(__all__)
