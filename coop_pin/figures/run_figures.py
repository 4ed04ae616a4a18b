"""How well the payload followed, and how the arms squeezed it: in the manner of Fig. 2 of Gueaieb et al. (2007)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import (
    ACTUAL,
    DESIRED,
    finish,
    frame_bulk,
    frame_decades,
    grid_figure,
    label,
    legend_above,
    styled,
    without_zeros,
)
from coop_pin.results import RunResult
from coop_pin.results.metrics import ORIENTATION_BAND_RAD, POSITION_BAND_M, axial_directions, energy_balance


def tracking_figure(result: RunResult) -> Figure:
    """Return actual against desired payload pose, and the first arm's internal force along the line to the other tips.

    Planar cells show x, y and psi (degrees); others x, y, z, the rotation-vector error (mrad), and the
    internal force across the line too.

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
    time, actual, desired = (
        data["time"].values,
        data["payload_position"].values,
        data["desired_position"].values,
    )
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
    panel.annotate(
        text, (0.995, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7.5
    )


def internal_force_figure(result: RunResult) -> Figure:
    """Return axial force, shear force and moment of the internal wrench: a column for each arm, actual and desired.

    Axial is along the line from the arm's tip to the middle of the other tips, negative where the arms
    squeeze; shear is the size of what lies across that line; the moment's size is about P. Rows that rigid
    bodies do not determine count as zero.

    Args:
        result: the run.
    """
    data, arms = result.data, result.data["arm"].values
    time, axis = data["time"].values, axial_directions(data)
    figure, axes = grid_figure(3, len(arms), result, "internal wrench on each arm", panel=(3.6, 1.6))
    with styled():
        for name, style, text in (
            ("internal_wrench", ACTUAL, "actual"),
            ("desired_internal_wrench", DESIRED, "desired"),
        ):
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
            for panel, part, unit in zip(
                column, ("axial", "shear", "moment about P"), ("N", "N", "N m"), strict=True
            ):
                label(panel, f"arm {arm}, {part}", unit)
        legend_above(axes[0, 0])
    finish(figure, axes, result)
    return figure


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
            panel.plot(
                data["time"].values,
                condition,
                color=palette.SERIES[arm % len(palette.SERIES)],
                label=f"arm {arms[arm]}",
            )
        if np.nanmax(conditions) > 10.0 * np.nanmin(conditions):
            panel.set_yscale("log")
        label(panel, "condition number of the payload Jacobian", "")
        legend_above(panel)
    finish(figure, axes, result)
    return figure
