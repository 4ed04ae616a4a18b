"""How well the payload followed, and how the arms squeezed it: in the manner of Fig. 2 of Gueaieb et al. (2007)."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import ACTUAL, DESIRED, finish, frame_bulk, grid_figure, label, styled
from coop_pin.results import RunResult
from coop_pin.results.metrics import axial_directions


def tracking_figure(result: RunResult) -> Figure:
    """Return actual against desired payload pose, and the first arm's internal force along the line to the other tips.

    Planar cells show x, y and psi (degrees); others x, y, z, the rotation-vector error (mrad), and the internal force across the line too.

    Args:
        result: the run.
    """
    title = "payload and internal force"
    if result.scenario.cell.rows == "planar":
        figure, axes = grid_figure(2, 2, result, title)
        x, y, psi, axial = axes.flat
        with styled():
            _draw_positions(result.data, (x, y))
            _draw_heading(result.data, psi)
            _draw_axial_force(result.data, axial)
    else:
        figure, axes = grid_figure(3, 2, result, title)
        x, y, z, rotation, axial, across = axes.flat
        with styled():
            _draw_positions(result.data, (x, y, z))
            _draw_rotation_error(result.data, rotation)
            _draw_axial_force(result.data, axial)
            _draw_force_across(result.data, across)
    finish(figure, axes, result)
    return figure


def _draw_positions(data: xr.Dataset, panels: tuple[Axes, ...]) -> None:
    time, actual, desired = data["time"].values, data["payload_position"].values, data["desired_position"].values
    for axis, panel in enumerate(panels):
        panel.plot(time, actual[:, axis], label="actual", **ACTUAL)
        panel.plot(time, desired[:, axis], label="desired", **DESIRED)
        label(panel, f"payload {'xyz'[axis]}", "m")
    panels[0].legend(loc="best")


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
    label(panel, f"internal force on arm {data['arm'].values[0]}, axial", "N")
    frame_bulk(panel, actual, "N")


def _draw_force_across(data: xr.Dataset, panel: Axes) -> None:
    time, axis = data["time"].values, axial_directions(data)[:, 0]
    for name, style in (("internal_wrench", ACTUAL), ("desired_internal_wrench", DESIRED)):
        force = _force(data, name)
        across = np.linalg.norm(force - np.sum(force * axis, axis=1, keepdims=True) * axis, axis=1)
        panel.plot(time, across, **style)
    label(panel, f"internal force on arm {data['arm'].values[0]}, shear", "N")


def _force(data: xr.Dataset, name: str) -> Array:
    """Return a wrench's force on the first arm, N, shape (n, 3); zero where rigid bodies do not determine it."""
    return np.nan_to_num(data[name].values[:, 0, :3])
