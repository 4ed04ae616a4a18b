"""Figures of results, as matplotlib Figures that need no display and leave pyplot alone; adapt them before saving."""

from coop_pin.figures.run_figures import tracking_figure
from coop_pin.figures.study import BiasRun, ForceGainRun, InternalForceStudy, SignGainRun, internal_force_study_figure
from coop_pin.viz.figures.accuracy import error_figure
from coop_pin.viz.figures.saving import save_figure
from coop_pin.viz.figures.sweep import sweep_figure
from coop_pin.viz.figures.sweep_front import pareto_figure
from coop_pin.viz.figures.torque import torque_figure

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
