"""How far each arm stayed from its singular poses."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.figures import palette
from coop_pin.figures.style import finish, grid_figure, label, legend_above, styled
from coop_pin.results import RunResult


def singularity_figure(result: RunResult) -> Figure:
    """Return the condition number of every arm's payload Jacobian over time; it is infinite at a singular pose.

    The axis is logarithmic where the number grows tenfold.

    Args:
        result: the run.
    """
    data, arms = result.data, result.data["arm"].values
    figure, axes = grid_figure(1, 1, result, "margin to singular poses", panel=(7.2, 2.2))
    panel, conditions = axes[0, 0], data["jacobian_condition"].values
    with styled():
        for arm, condition in enumerate(conditions.T):
            panel.plot(data["time"].values, condition, color=palette.SERIES[arm % len(palette.SERIES)], label=f"arm {arms[arm]}")
        if np.nanmax(conditions) > 10.0 * np.nanmin(conditions):
            panel.set_yscale("log")
        label(panel, "condition number of the payload Jacobian", "")
        legend_above(panel)
    finish(figure, axes, result)
    return figure
