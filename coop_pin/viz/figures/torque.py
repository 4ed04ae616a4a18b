"""Drive torques, in the manner of Fig. 3 of Gueaieb et al. (2007)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from coop_pin.figures.style import ACTUAL, finish, grid_figure, label, styled
from coop_pin.results import RunResult


def torque_figure(result: RunResult) -> Figure:
    """Return the drive torques as held from tick to tick: a column for each arm, a row for each joint.

    Args:
        result: the run.
    """
    data = result.data
    torque, arms = data["torque"].values, data["arm"].values
    figure, axes = grid_figure(torque.shape[2], len(arms), result, "drive torques", panel=(3.6, 1.5))
    with styled():
        for (joint, arm), panel in np.ndenumerate(axes):
            if np.isnan(torque[:, arm, joint]).all():  # an arm with fewer joints than the others
                panel.set_visible(False)
                continue
            panel.plot(data["time"].values, torque[:, arm, joint], drawstyle="steps-post", **ACTUAL)
            label(panel, f"arm {arms[arm]}, joint {data['joint'].values[joint]}", "N m")
    finish(figure, axes, result)
    return figure
