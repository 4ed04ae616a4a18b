"""Errors of a run on logarithmic axes: of the payload's pose, and of the computation itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import ACTUAL, finish, frame_decades, grid_figure, label, legend_above, styled, without_zeros
from coop_pin.results import RunResult
from coop_pin.results.metrics import ORIENTATION_BAND_RAD, POSITION_BAND_M, energy_balance


def error_figure(result: RunResult) -> Figure:
    """Return position and orientation errors with their bands of 5 mm and 5 mrad, the closure drift, and the energy balance.

    Args:
        result: the run.
    """
    data, time = result.data, result.data["time"].values
    error = data["pose_error"].values
    figure, axes = grid_figure(2, 2, result, "errors")
    position, orientation, closure, energy = axes.flat
    with styled():
        _draw(position, time, np.linalg.norm(error[:, :3], axis=1), **ACTUAL)
        _draw_band(position, POSITION_BAND_M, "5 mm")
        label(position, "position error", "m")
        _draw(orientation, time, np.linalg.norm(error[:, 3:], axis=1), **ACTUAL)
        _draw_band(orientation, ORIENTATION_BAND_RAD, "5 mrad")
        label(orientation, "orientation error", "rad")
        for name, text, colour in (
            ("closure_distance", "distance (m)", palette.SERIES[0]),
            ("closure_angle", "angle (rad)", palette.SERIES[1]),
        ):
            closure.semilogy(time, without_zeros(data[name].values.max(axis=1)), color=colour, label=text)
        frame_decades(closure, np.stack((data["closure_distance"].values, data["closure_angle"].values)))
        label(closure, "closure drift", "m, rad")
        legend_above(closure)
        _draw(energy, time, np.abs(energy_balance(data)), **ACTUAL)
        label(energy, "energy minus work", "J")
    finish(figure, axes, result)
    return figure


def _draw(panel: Axes, time: Array, values: Array, **style: Any) -> None:
    panel.semilogy(time, without_zeros(values), **style)
    frame_decades(panel, values)


def _draw_band(panel: Axes, limit: float, text: str) -> None:
    panel.axhline(limit, color=palette.LIMIT, linewidth=0.8, linestyle="--")
    panel.set_ylim(top=max(panel.get_ylim()[1], 3.0 * limit))
    panel.annotate(text, (0.995, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7.5)
