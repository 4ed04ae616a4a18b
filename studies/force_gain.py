"""Stability boundary of sampled force feedback: K_f over the filter pole p; bound K_f = (1 + p) / (1 - p)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.figures import sweep_figure
from coop_pin.laws import force_gain_bound

ERROR = "settled_axial_rms_error_N"
GAIN = "controller.gains.force_gain"


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return the map, with the theoretical bound."""
    drawn = sweep_figure(results["force_gain"], ERROR)
    panel = drawn.axes[0]
    pole = np.linspace(0.0, 0.94, 200)
    (line,) = panel.plot(
        pole,
        [force_gain_bound(p) for p in pole],
        "k--",
        linewidth=1.2,
        label="$K_f = (1 + p) / (1 - p)$",
        scaley=False,
    )
    patches = [handle for legend in drawn.legends for handle in legend.legend_handles]
    drawn.legends.clear()
    panel.legend(
        handles=[*patches, line], loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False
    )
    return drawn


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return the bound, the simulated boundary, and the growth of the error towards the last stable gain."""
    result = results["force_gain"]
    edges = result.stability_boundary(GAIN)
    lines = ["    p   theory  last stable  first unstable  its error over that of the gain below"]
    for (pole,) in edges.to_dataframe().index.to_frame().itertuples(index=False):
        edge = edges.sel({edges.last_stable.dims[0]: pole})
        error = result.values(ERROR).sel({edges.last_stable.dims[0]: pole}).sortby(GAIN)
        stable = error.where(np.isfinite(error), drop=True).values
        growth = stable[-1] / stable[-2] if len(stable) > 1 else np.nan
        row = (pole, force_gain_bound(pole), edge.last_stable.item(), edge.first_unstable.item(), growth)
        lines.append("{:5.2g} {:8.3g} {:12.2f} {:15.2f} {:10.1f}".format(*row))
    return "\n".join(lines)
