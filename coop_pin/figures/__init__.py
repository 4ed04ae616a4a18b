"""Figures of results, as matplotlib Figures that need no display and leave pyplot alone; adapt them before saving."""

from coop_pin.figures.run_figures import error_figure, torque_figure, tracking_figure
from coop_pin.figures.study import (
    BiasRun,
    ForceGainRun,
    InternalForceStudy,
    SignGainRun,
    internal_force_study_figure,
)
from coop_pin.figures.style import save_figure
from coop_pin.figures.sweep_figures import pareto_figure, sweep_figure

__all__ = [
    "BiasRun",
    "ForceGainRun",
    "InternalForceStudy",
    "SignGainRun",
    "error_figure",
    "internal_force_study_figure",
    "pareto_figure",
    "save_figure",
    "sweep_figure",
    "torque_figure",
    "tracking_figure",
]
