"""Figure of the study of the paper's claims: errors over time, over alpha, and over the force gain."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

COLOURS = {
    "printed, α = 0.002": palette.INTERNAL,
    "printed, α = 0.2": palette.EXTERNAL,
    "printed, α = 0": palette.MEASURED,
    "zeroed leaky": palette.LOAD,
    "anchored": palette.ACTUAL,
}
DRAWN = [(law, trial) for trial in ("as published", "bias 0.1 mm") for law in COLOURS]
"""Runs whose errors over time are kept."""


def figure(tables: Mapping[str, pd.DataFrame], force_gain: str) -> Figure:
    """Return the figure.

    Args:
        tables: of the study, by name.
        force_gain: column of the force gain.
    """
    with styled():
        drawn = Figure(figsize=(12.0, 6.6), layout="constrained")
        (first, second, third), (fourth, fifth, sixth) = drawn.subplots(2, 3)
        over_time(first, tables["series"], "as published", "position_mm", "position error, mm")
        over_time(fourth, tables["series"], "as published", "force_N", "internal-force error, N")
        over_time(second, tables["series"], "bias 0.1 mm", "position_mm", "")
        over_time(fifth, tables["series"], "bias 0.1 mm", "force_N", "")
        over_alpha(third, tables["curve"])
        over_force_gain(sixth, tables["force_gain"], force_gain)
        drawn.legend(*first.get_legend_handles_labels(), loc="outside upper center", ncols=len(COLOURS))
    return drawn


def over_time(panel: Axes, series: pd.DataFrame, trial: str, column: str, unit: str) -> None:
    """Draw an error of all laws in one trial; the event is marked."""
    mine = series[series["trial"] == trial]
    for law, colour in COLOURS.items():
        run = mine[mine["law"] == law]
        panel.plot(run["time_s"], run[column], color=colour, label=law, linewidth=1.2)
    panel.axvline(10.0, color=palette.LIMIT, linestyle=":", linewidth=1.0)
    panel.set(yscale="log", xlabel="time, s", xlim=(0.0, 20.0))
    label(panel, trial, unit)


def over_alpha(panel: Axes, curve: pd.DataFrame) -> None:
    """Draw both errors of the printed law over alpha, without event."""
    runs = curve["quiet"].loc[curve.index > 0.0]
    panel.plot(runs.index, runs["force_N"], "o-", color=palette.INTERNAL, label="internal force, N rms")
    panel.plot(runs.index, runs["position_mm"], "s--", color=palette.ACTUAL, label="position, mm rms")
    panel.set(xscale="log", yscale="log", xlabel="α")
    panel.legend()
    label(panel, "printed, 4 to 10 s", "")


def over_force_gain(panel: Axes, runs: pd.DataFrame, gain: str) -> None:
    """Draw level and time of convergence of the internal force over the force gain."""
    stable = runs[runs["status"] == "ok"]
    factor = 1.0 + stable[gain]
    panel.plot(factor, stable["force_N"], "o-", color=palette.INTERNAL, label="internal force, N rms")
    panel.plot(factor, stable["force_converged_s"], "s-", color=palette.DESIRED, label="converged after, s")
    line = stable["force_N"].iloc[0] / factor
    panel.plot(factor, line, ":", color=palette.LIMIT, label="its value at $K_f = 0$, over $1 + K_f$")
    panel.set(xscale="log", yscale="log", xlabel="$1 + K_f$")
    panel.set_xticks([1.0, 2.0, 4.0, 10.0, 16.0], ["1", "2", "4", "10", "16"])
    panel.minorticks_off()
    panel.legend()
    label(panel, "printed, α = 0, pole 0.9", "")
