"""One page that tells a whole run: what was run, how it went, what the arms did to each other, and the motion in 3-D.

Everything is loaded on first use: the figures and the replay take their time.
"""

from coop_pin import lazy_names

_PUBLIC = {
    "internal_force_figure": "coop_pin.figures.run_figures",
    "motion_figure": "coop_pin.figures.motion_figure",
    "report_html": "coop_pin.report.report",
    "save_report": "coop_pin.report.report",
    "singularity_figure": "coop_pin.figures.run_figures",
}

__all__ = sorted(_PUBLIC)
__getattr__, __dir__ = lazy_names(__name__, _PUBLIC)
