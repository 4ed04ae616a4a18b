"""The internal wrench of every arm, taken apart: along the line to the other tips, across it, and about P."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.figures.style import ACTUAL, DESIRED, finish, frame_bulk, grid_figure, label, legend_above, styled
from coop_pin.results import RunResult
from coop_pin.results.metrics import axial_directions


def internal_force_figure(result: RunResult) -> Figure:
    """Return axial force, shear force and moment of the internal wrench: a column for each arm, actual and desired.

    Axial is along the line from the arm's tip to the middle of the other tips, negative where the arms squeeze; shear is the
    size of what lies across that line; the moment's size is about P. Rows that rigid bodies do not determine count as zero.

    Args:
        result: the run.
    """
    data, arms = result.data, result.data["arm"].values
    time, axis = data["time"].values, axial_directions(data)
    figure, axes = grid_figure(3, len(arms), result, "internal wrench on each arm", panel=(3.6, 1.6))
    with styled():
        for name, style, text in (("internal_wrench", ACTUAL, "actual"), ("desired_internal_wrench", DESIRED, "desired")):
            wrench = np.nan_to_num(data[name].values)
            force, moment = wrench[..., :3], np.linalg.norm(wrench[..., 3:], axis=2)
            axial = np.einsum("nmi,nmi->nm", force, axis)
            shear = np.linalg.norm(force - axial[..., None] * axis, axis=2)
            for row, values in enumerate((axial, shear, moment)):
                for arm, panel in enumerate(axes[row]):
                    panel.plot(time, values[:, arm], label=text, **style)
                    if name == "internal_wrench":
                        frame_bulk(panel, values[:, arm], "N m" if row == 2 else "N")
        for arm, column in zip(arms, axes.T, strict=True):
            for panel, part, unit in zip(column, ("axial", "shear", "moment about P"), ("N", "N", "N m"), strict=True):
                label(panel, f"arm {arm}, {part}", unit)
        legend_above(axes[0, 0])
    finish(figure, axes, result)
    return figure
