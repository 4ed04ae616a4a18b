"""Figures of one run: tracking, torques, errors, internal wrench, margin to singular poses, friction.

The tracking figure follows Fig. 2 of Gueaieb et al. (2007).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.base.arrays import Array, typed
from coop_pin.figures import palette
from coop_pin.figures.style import (
    ACTUAL,
    DESIRED,
    MEASURED,
    as_written,
    frame_decades,
    inset_peak,
    label,
    legend_above,
    run_figure,
)
from coop_pin.results.energies import energy_balance
from coop_pin.results.friction import SHOWN
from coop_pin.results.metrics import ORIENTATION_BAND_RAD, POSITION_BAND_M
from coop_pin.results.run_result import RunResult

_STILL, _SMALL_M = 1e-3, 0.01
"""Range of a coordinate, as a share of its value, below which its deviations are drawn; that of mm, m."""


@typed
def tracking_figure(result: RunResult) -> Figure:
    """Return actual and desired payload pose, and the internal force along and across the arms' axes.

    Planar cells show x, y and psi (degrees); others x, y, z, and the errors of position (mm) and rotation
    (mrad). A coordinate that hardly moves is drawn in mm about the desired one. Of two arms, whose internal
    forces mirror each other, the first one is drawn; of more, or where arms let go, all of them. Panels are
    read down the columns.

    Args:
        result: the run.
    """
    data, planar = result.data, result.scenario.cell.rows == "planar"
    with run_figure(3 if planar else 4, 2, result, "payload and internal force") as (figure, axes):
        panels = list(axes.T.flat)
        _draw_positions(data, panels[: 2 if planar else 3])
        if planar:
            for name, style in (("payload", ACTUAL), ("desired", DESIRED)):
                z, w = data[f"{name}_quaternion"].values[:, 2:].T
                heading = np.degrees(np.unwrap(2.0 * np.arctan2(z, w)))
                panels[2].plot(data["time"].values, heading, **style)
            label(panels[2], "payload ψ", "deg")
        else:
            _draw_error(data, panels[3], slice(0, 3), "position error", "mm")
            _draw_error(data, panels[4], slice(3, 6), "rotation-vector error", "mrad")
        arms = [as_written(arm) for arm in data["arm"].values]
        has_all = len(arms) > 2 or bool(result.scenario.grasp_events)
        for part, panel in zip(("moment", "axial", "shear"), panels[-3:], strict=True):
            roles = _roles(result, part, "actual", "desired")
            text, unit = ("moment", "N m") if part == "moment" else (f"force, {part}", "N")
            if not has_all:
                _draw_internal(panel, data, part, roles=roles)
                label(panel, f"arm {arms[0]}: internal {text}", unit)
                continue
            _draw_all_internal(panel, data, part, roles)
            label(panel, f"internal {text}", unit)
            if part == "moment":
                panel.legend(loc="best", fontsize=7.0, handlelength=1.3)
    return figure


def _draw_all_internal(panel: Axes, data: xr.Dataset, part: str, roles: Iterable[str]) -> None:
    """Draw a part of the internal wrench on each arm, in its colour; what is desired is dashed."""
    for arm, name in enumerate(data["arm"].values):
        for role in roles:
            prefix, style = _ROLES[role]
            drawn = {"label": as_written(name)} if role == "actual" else {"alpha": 0.7} | style
            values = data[f"{prefix}internal_{part}"].values[:, arm]
            panel.plot(data["time"].values, values, **drawn | {"color": palette.arm(arm)})


def _draw_positions(data: xr.Dataset, panels: list[Axes]) -> None:
    time, actual, desired = (data[name].values for name in ("time", "payload_position", "desired_position"))
    for axis, panel in enumerate(panels):
        name, values = f"payload {'xyz'[axis]}", np.stack((actual[:, axis], desired[:, axis]))
        is_small = np.ptp(values) < _SMALL_M
        if is_still := np.ptp(values) < _STILL * np.abs(values[1]).max():
            values = values - values[1]
        values = 1e3 * values if is_still or is_small else values
        panel.plot(time, values[0], label="actual", **ACTUAL)
        panel.plot(time, values[1], label="desired", **DESIRED)
        label(
            panel,
            f"{name} about the desired one" if is_still else name,
            "mm" if is_still or is_small else "m",
        )
    panels[0].legend(loc="best")


def _draw_error(data: xr.Dataset, panel: Axes, rows: slice, title: str, unit: str) -> None:
    error = 1e3 * data["pose_error"].values[:, rows]
    for name, values, colour in zip("xyz", error.T, palette.SERIES, strict=False):
        panel.plot(data["time"].values, values, label=name, color=colour)
    label(panel, title, unit)
    legend_above(panel)


def _roles(result: RunResult, part: str, *roles: str) -> tuple[str, ...]:
    """Return the roles to draw of a part: no desired moment where the controlled rows have none."""
    is_desired = part != "moment" or result.scenario.cell.task_rows.has_moments
    return tuple(role for role in roles if role != "desired" or is_desired)


_ROLES: dict[str, Any] = {
    "measured": ("measured_", MEASURED),
    "actual": ("", ACTUAL),
    "desired": ("desired_", DESIRED),
}
"""Prefix of the variables and style of the curves by role."""


def _draw_internal(
    panel: Axes, data: xr.Dataset, part: str, arm: int = 0, roles: Iterable[str] = ("actual", "desired")
) -> None:
    """Draw a part of the internal wrench on an arm, and its peak in an inset if that is high."""
    for role in roles:
        prefix, style = _ROLES[role]
        panel.plot(data["time"].values, data[f"{prefix}internal_{part}"].values[:, arm], label=role, **style)
    inset_peak(panel, data["time"].values)


_NEAR_LIMIT, _LEAST_SPAN = 0.5, 0.01
"""Share of a limit from which it is in sight; least half range, as a share of the largest torque."""


@typed
def torque_figure(result: RunResult) -> Figure:
    """Return the drive torques as held from tick to tick: a column for each arm, a row for each joint.

    The panels of a row have one scale. A limit is in the title, and drawn where a torque comes near it.

    Args:
        result: the run.
    """
    data = result.data
    torque, arms, limits = data["torque"].values, data["arm"].values, data["torque_limit"].values
    shape = (torque.shape[2], len(arms))
    low, high = torque.min(axis=0), torque.max(axis=0)
    low = np.nanmin(np.where(-low > _NEAR_LIMIT * limits, -limits, low), axis=0)
    high = np.nanmax(np.where(high > _NEAR_LIMIT * limits, limits, high), axis=0)
    margin = np.maximum(0.06 * (high - low), _LEAST_SPAN * (np.nanmax(np.abs(torque)) or 1.0))
    with run_figure(*shape, result, "drive torques", panel=(3.6, 1.5)) as (figure, axes):
        for (joint, arm), panel in np.ndenumerate(axes):
            if np.isnan(torque[:, arm, joint]).all():  # an arm with fewer joints than the others
                panel.set_visible(False)
                continue
            panel.plot(data["time"].values, torque[:, arm, joint], drawstyle="steps-post", **ACTUAL)
            limit = limits[arm, joint]
            for level in (-limit, limit):
                panel.axhline(level, color=palette.LIMIT, linewidth=0.8, linestyle="--")
            panel.set_ylim(low[joint] - margin[joint], high[joint] + margin[joint])
            title = f"arm {as_written(arms[arm])}, joint {data['joint'].values[joint]}"
            label(panel, f"{title} (limit {limit:g})" if np.isfinite(limit) else title, "N m")
    return figure


@typed
def error_figure(result: RunResult) -> Figure:
    """Return pose errors with their bands of 5 mm and 5 mrad, closure error, and energy balance.

    Where no grasp is a closure, the error of the internal force stands in the place of theirs.

    Args:
        result: the run.
    """
    data, time = result.data, result.data["time"].values
    error = data["pose_error"].values
    distance, angle = data["closure_distance"].values, data["closure_angle"].values
    with run_figure(2, 2, result, "errors") as (figure, axes):
        position, orientation, closure, energy = axes.flat
        _draw_decades(position, time, 1e3 * np.linalg.norm(error[:, :3], axis=1), **ACTUAL)
        _draw_band(position, 1e3 * POSITION_BAND_M, "5 mm")
        label(position, "position error", "mm")
        _draw_decades(orientation, time, 1e3 * np.linalg.norm(error[:, 3:], axis=1), **ACTUAL)
        _draw_band(orientation, 1e3 * ORIENTATION_BAND_RAD, "5 mrad")
        label(orientation, "orientation error", "mrad")
        if distance.any() or angle.any():
            _draw_decades(closure, time, distance.max(axis=1), color=palette.SERIES[0], label="distance")
            _draw_decades(closure, time, angle.max(axis=1), color=palette.SERIES[1], label="angle")
            frame_decades(closure, np.stack((distance, angle)))
            label(closure, "closure error", "m, rad")
            legend_above(closure)
        else:
            parts = [np.nan_to_num(data[f"internal_{part}_error"].values) for part in ("axial", "shear")]
            _draw_decades(closure, time, np.hypot(*parts).max(axis=1), **ACTUAL)
            label(closure, "internal-force error, of the worst arm", "N")
        _draw_decades(energy, time, np.abs(energy_balance(data)), **ACTUAL)
        label(energy, "energy minus work", "J")
    return figure


def _draw_decades(panel: Axes, time: Array, values: Array, **style: Any) -> None:
    panel.semilogy(time, np.where(values > 0.0, values, np.nan), **style)
    frame_decades(panel, values)


def _draw_band(panel: Axes, limit: float, text: str) -> None:
    panel.axhline(limit, color=palette.LIMIT, linewidth=0.8, linestyle="--")
    panel.set_ylim(top=max(panel.get_ylim()[1], 3.0 * limit))
    corner: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
    panel.annotate(text, (0.995, limit), fontsize=7.5, **corner)


@typed
def internal_force_figure(result: RunResult) -> Figure:
    """Return axial force, shear force and moment of the internal wrench: a column for each arm.

    Two arms whose parts mirror each other have one column. Axial is along the line from the arm's tip to the
    middle of the other tips, negative where the arms squeeze; shear is the norm of the force across that
    line; moment is the norm of the moment about P. Rows that rigid bodies do not determine count as zero.
    What the controller measured is drawn where it differs.

    Args:
        result: the run.
    """
    data, arms = result.data, [as_written(arm) for arm in result.data["arm"].values]
    parts = (("axial", "axial", "N"), ("shear", "shear", "N"), ("moment", "moment about P", "N m"))
    has_measured = "measured_internal_axial" in data
    names = [f"arm {arm}" for arm in arms]
    if not has_measured and _mirrors(data):
        names = [f"arms {' and '.join(arms)}"]
    size, title = (3.6 if len(names) > 1 else 7.2, 1.6), "internal wrench on each arm"
    with run_figure(3, len(names), result, title, panel=size) as (figure, axes):
        for (part, text, unit), row in zip(parts, axes, strict=True):
            for arm, (name, panel) in enumerate(zip(names, row, strict=True)):
                _draw_internal(
                    panel, data, part, arm, _roles(result, part, *list(_ROLES)[not has_measured :])
                )
                label(panel, f"{name}, {text}", unit)
        if has_measured:  # three entries are too wide beside a title
            figure.set_layout_engine("constrained")
            figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right upper")
        else:
            legend_above(axes[0, 0])
    return figure


def _mirrors(data: xr.Dataset) -> bool:
    """Return whether two arms have the same axial force, shear force and moment, to rounding."""
    parts = np.stack([data[f"internal_{part}"].values for part in ("axial", "shear", "moment")])
    if parts.shape[2] != 2:
        return False
    close = 1e-9 + 1e-6 * np.nanmax(np.abs(parts), axis=(1, 2), initial=0.0)[:, None]
    return np.allclose(parts[..., 0], parts[..., 1], rtol=1e-6, atol=close, equal_nan=True)


@typed
def singularity_figure(result: RunResult) -> Figure:
    """Return the condition number of every arm's payload Jacobian over time.

    It is infinite at a singular pose; the axis is logarithmic if it grows tenfold.

    Args:
        result: the run.
    """
    data, conditions = result.data, result.data["jacobian_condition"].values
    title = "margin to singular poses"
    with run_figure(1, 1, result, title, panel=(7.2, 2.2)) as (figure, axes):
        panel = axes[0, 0]
        for index, arm in enumerate(data["arm"].values):
            style = {"color": palette.arm(index), "label": f"arm {as_written(arm)}"}
            panel.plot(data["time"].values, conditions[:, index], **style)
        if np.nanmax(conditions) > 10.0 * np.nanmin(conditions):
            panel.set_yscale("log")
        label(panel, "condition number of the payload Jacobian", "")
        legend_above(panel)
    return figure


@typed
def friction_figure(result: RunResult) -> Figure:
    """Return the friction that patches and pads use of what they bear, and the normal force beyond its need.

    Dashed is the part by the force along the plane, dotted that by the moment about the normal; slip is from
    100 % on, and more than 200 % is drawn as 200 %.

    Args:
        result: the run, of a cell with patches or pads.
    """
    use, time, arms = result.friction_use(), result.data["time"].values, list(result.scenario.cell.arms)
    with run_figure(2, 1, result, "friction at the grasps", panel=(7.2, 1.8)) as (figure, axes):
        top, bottom = axes[:, 0]
        for k, arm in enumerate(use.arms):
            style = {"color": palette.arm(arms.index(arm)), "label": f"arm {as_written(arm)}"}
            top.plot(time, 100.0 * np.minimum(use.used[:, k], SHOWN), **style)
            for part, line in ((use.force, "--"), (use.torsion, ":")):
                top.plot(
                    time, 100.0 * np.minimum(part[:, k], SHOWN), line, color=style["color"], linewidth=0.7
                )
            bottom.plot(time, use.reserve[:, k], **style)
        top.axhline(100.0, color=palette.LIMIT, linewidth=0.7)
        bottom.axhline(0.0, color=palette.LIMIT, linewidth=0.7)
        label(top, "friction used (dashed: force, dotted: torsion)", "%")
        label(bottom, "normal force beyond what friction needs", "N")
        legend_above(top)
    return figure
