"""Figures: matplotlib figures of runs, sweeps and comparisons, made without a display.

Open first: ``run_figures`` (tracking, torques, errors, internal wrench, friction), ``sweep_figures`` (maps,
lines, Pareto fronts), ``style`` (parts that all share).

- ``motion_views`` (paths), ``law_figures`` (root locus, convergence proof), ``comparison_figures``,
  ``blame_figures``.
- ``layout`` (panels), ``palette`` (colours, also of 3-D views), ``saving`` (PNG, SVG, PDF).

Names are loaded on first use: matplotlib takes its time, and ``palette`` does not need it.

Imports ``base``, ``comparison``, ``description``, ``identification``, ``results``, ``stability``
and ``sweeps``.
"""

from coop_pin import lazy_names

__all__, __getattr__, __dir__ = lazy_names(
    __name__,
    {
        "blame_figure": "figures.blame_figures",
        "comparison_figure": "figures.comparison_figures",
        "error_figure": "figures.run_figures",
        "friction_figure": "figures.run_figures",
        "internal_force_figure": "figures.run_figures",
        "motion_figure": "figures.motion_views",
        "pareto_figure": "figures.sweep_figures",
        "root_locus_figure": "figures.law_figures",
        "save_figure": "figures.saving",
        "singularity_figure": "figures.run_figures",
        "sweep_figure": "figures.sweep_figures",
        "theorem_figure": "figures.law_figures",
        "torque_figure": "figures.run_figures",
        "tracking_figure": "figures.run_figures",
        "views_figure": "figures.blame_figures",
    },
)
