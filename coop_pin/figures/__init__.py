"""Figures of runs and sweeps: matplotlib Figures, made without display and pyplot, to be adapted and saved.

Everything is loaded on first use: matplotlib is slow to load, and ``figures.palette`` does not need it.
"""

from __future__ import annotations

from typing import Any

from coop_pin.lazy import load_public

_PUBLIC = {
    "error_figure": "coop_pin.figures.run_figures",
    "internal_force_figure": "coop_pin.figures.run_figures",
    "motion_figure": "coop_pin.figures.run_figures",
    "pareto_figure": "coop_pin.figures.sweep_figures",
    "save_figure": "coop_pin.figures.style",
    "singularity_figure": "coop_pin.figures.run_figures",
    "sweep_figure": "coop_pin.figures.sweep_figures",
    "torque_figure": "coop_pin.figures.run_figures",
    "tracking_figure": "coop_pin.figures.run_figures",
}

__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    """Load a public name on first use."""
    return load_public(__name__, _PUBLIC, name)


def __dir__() -> list[str]:
    """List the public names."""
    return list(__all__)
