"""Figures of runs and sweeps: matplotlib Figures, made without display and pyplot, to be adapted and saved.

Everything is loaded on first use: matplotlib is slow to load, and ``figures.palette`` does not need it.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "comparison_figure": "coop_pin.figures.comparison_figures",
    "error_figure": "coop_pin.figures.run_figures",
    "friction_figure": "coop_pin.figures.grasp_figures",
    "internal_force_figure": "coop_pin.figures.run_figures",
    "motion_figure": "coop_pin.figures.motion_views",
    "pareto_figure": "coop_pin.figures.sweep_figures",
    "root_locus_figure": "coop_pin.figures.locus_figure",
    "save_figure": "coop_pin.figures.saving",
    "singularity_figure": "coop_pin.figures.run_figures",
    "sweep_figure": "coop_pin.figures.sweep_figures",
    "theorem_figure": "coop_pin.figures.proof_figure",
    "torque_figure": "coop_pin.figures.run_figures",
    "tracking_figure": "coop_pin.figures.run_figures",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
