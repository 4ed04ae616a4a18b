"""How far each arm stayed from its singular poses."""

from __future__ import annotations

from matplotlib.figure import Figure

from coop_pin.results import RunResult
from coop_pin.viz import palette
from coop_pin.viz.figures.style import finish, grid_figure, label, styled, without_zeros


def singularity_figure(result: RunResult) -> Figure:
    """Return the condition number of every arm's payload Jacobian over time; it is infinite at a singular pose.

    Args:
        result: the run.
    """
    data, arms = result.data, result.data["arm"].values
    figure, axes = grid_figure(1, 1, result, "margin to singular poses", panel=(7.2, 2.2))
    panel = axes[0, 0]
    with styled():
        for arm, condition in enumerate(data["jacobian_condition"].values.T):
            colour = palette.SERIES[arm % len(palette.SERIES)]
            panel.semilogy(data["time"].values, without_zeros(condition), color=colour, label=f"arm {arms[arm]}")
        label(panel, "condition number of the payload Jacobian", "1")
        panel.legend(loc="best", ncols=min(len(arms), 4))
    finish(figure, axes, result)
    return figure
