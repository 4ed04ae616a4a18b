"""How well the payload followed, and how the arms squeezed it: in the manner of Fig. 2 of Gueaieb et al. (2007)."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.results import RunResult
from coop_pin.results.judgements import axial_directions
from coop_pin.viz import palette
from coop_pin.viz.figures.style import ACTUAL, DESIRED, STYLE, frame_bulk, grid_figure, label, mark_time


def tracking_figure(result: RunResult) -> Figure:
    """Return actual against desired payload pose, and the first arm's internal force along the line to the other tips.

    Planar cells show x, y and psi (degrees); others x, y, z, the rotation-vector error (mrad), and the internal force across the line too.

    Args:
        result: the run.
    """
    title = f"{result.scenario.name}: payload and internal force"
    if result.scenario.cell.rows == "planar":
        figure, axes = grid_figure(2, 2, title)
        x, y, psi, axial = axes.flat
        with mpl.rc_context(STYLE):
            _draw_positions(result.data, (x, y))
            _draw_heading(result.data, psi)
            _draw_axial_force(result.data, axial)
    else:
        figure, axes = grid_figure(2, 3, title)
        x, y, z, rotation, axial, across = axes.flat
        with mpl.rc_context(STYLE):
            _draw_positions(result.data, (x, y, z))
            _draw_rotation_error(result.data, rotation)
            _draw_axial_force(result.data, axial)
            _draw_force_across(result.data, across)
    mark_time(axes, result)
    axes[0, 0].legend(loc="best", fontsize=STYLE["legend.fontsize"], frameon=False)
    return figure


def _draw_positions(data: xr.Dataset, panels: tuple[Axes, ...]) -> None:
    time = data["time"].values
    for panel, name, actual, desired in zip(panels, "xyz", data["payload_position"].values.T, data["desired_position"].values.T, strict=False):
        panel.plot(time, actual, label="actual", **ACTUAL)
        panel.plot(time, desired, label="desired", **DESIRED)
        label(panel, f"payload {name}", "m")


def _draw_heading(data: xr.Dataset, panel: Axes) -> None:
    for name, style in (("payload", ACTUAL), ("desired", DESIRED)):
        panel.plot(data["time"].values, _heading_deg(data[f"{name}_quaternion"].values), **style)
    label(panel, "payload $\\psi$", "deg")


def _heading_deg(quaternion: Array) -> Array:
    """Return the turn about z of orientations that turn about z only, without jumps of a whole turn, degrees, shape (n,)."""
    z, w = quaternion[:, 2], quaternion[:, 3]
    return np.degrees(np.unwrap(2.0 * np.arctan2(z, w)))


def _draw_rotation_error(data: xr.Dataset, panel: Axes) -> None:
    error = 1e3 * data["pose_error"].values[:, 3:]
    for name, values, colour in zip(("$e_x$", "$e_y$", "$e_z$"), error.T, palette.SERIES, strict=False):
        panel.plot(data["time"].values, values, label=name, color=colour)
    label(panel, "rotation-vector error", "mrad")
    panel.legend(loc="best", ncols=3)


def _draw_axial_force(data: xr.Dataset, panel: Axes) -> None:
    time, axis = data["time"].values, axial_directions(data)[:, 0]
    actual = np.sum(_force(data, "internal_wrench") * axis, axis=1)
    panel.plot(time, actual, **ACTUAL)
    panel.plot(time, np.sum(_force(data, "desired_internal_wrench") * axis, axis=1), **DESIRED)
    label(panel, f"internal force on arm {data['arm'].values[0]}, along the line to the other tip", "N")
    frame_bulk(panel, actual, "N")


def _draw_force_across(data: xr.Dataset, panel: Axes) -> None:
    time, axis = data["time"].values, axial_directions(data)[:, 0]
    for name, style in (("internal_wrench", ACTUAL), ("desired_internal_wrench", DESIRED)):
        force = _force(data, name)
        across = np.linalg.norm(force - np.sum(force * axis, axis=1, keepdims=True) * axis, axis=1)
        panel.plot(time, across, **style)
    label(panel, "and across it", "N")


def _force(data: xr.Dataset, name: str) -> Array:
    """Return a wrench's force on the first arm, N, shape (n, 3); zero where it is not determined (outside the task rows)."""
    return np.nan_to_num(data[name].values[:, 0, :3])
