"""Figure of the grasps of one run: the friction that they use."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, legend_above, run_figure
from coop_pin.results.friction import SHOWN
from coop_pin.results.run_result import RunResult


@typed
def friction_figure(result: RunResult) -> Figure:
    """Return the friction that patches and pads use of what they bear, and the normal force beyond its need.

    Dashed is the part by the force along the plane, dotted that by the moment about the normal; slip is from
    100 % on, and more than 200 % is drawn as 200 %.

    Args:
        result: the run, of a cell with patches or pads.
    """
    use, time, arms = result.friction_use(), result.data["time"].values, list(result.scenario.cell.arms)
    with run_figure(2, 1, result, "friction at the grasps", panel=(7.2, 1.8)) as (figure, axes):
        top, bottom = axes[:, 0]
        for k, arm in enumerate(use.arms):
            style = {"color": palette.arm(arms.index(arm)), "label": f"arm {as_written(arm)}"}
            top.plot(time, 100.0 * np.minimum(use.used[:, k], SHOWN), **style)
            for part, line in ((use.force, "--"), (use.torsion, ":")):
                top.plot(
                    time, 100.0 * np.minimum(part[:, k], SHOWN), line, color=style["color"], linewidth=0.7
                )
            bottom.plot(time, use.reserve[:, k], **style)
        top.axhline(100.0, color=palette.LIMIT, linewidth=0.7)
        bottom.axhline(0.0, color=palette.LIMIT, linewidth=0.7)
        label(top, "friction used (dashed: force, dotted: torsion)", "%")
        label(bottom, "normal force beyond what friction needs", "N")
        legend_above(top)
    return figure
