"""Metrics of a run: settling time, tracking error, internal force, energy balance.

Functions of a run's arrays by name, such as its dataset; those that average state their window. The arrays
may have axes before that of time, such as the runs of a batch with the same times; so have the metrics then.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask, mean, rms
from coop_pin.base.spatial import internal_wrenches
from coop_pin.base.spatial.internal_wrench import (
    constraint_consistent_internal_wrenches,
    determinate_grasp,
    minimum_norm_internal_wrenches,
    nonsqueezing_internal_wrenches,
    symmetric_internal_wrenches,
    virtual_linkage_internal_wrenches,
)
from coop_pin.description.cell.payload import Payload
from coop_pin.results.energies import start_energy, unexplained_energy
from coop_pin.results.quantities import Arrays
from coop_pin.results.window import SETTLING_S, Window, Windows, samples_of

if TYPE_CHECKING:  # slow to load
    import xarray as xr

POSITION_BAND_M = 5e-3
ORIENTATION_BAND_RAD = 5e-3
FORCE_BAND_N, FORCE_BAND_SHARE = 1.0, 0.1
"""Errors of the internal force, N and as a share of what is desired, that count as small."""
_ROUNDING, _TRACE_ROUNDING = 1e-9, 1e-12
"""Rounding of times, s, and of traces of rotations."""
DRIFT_S, REST = 1.0, 1e-3
"""Time over which joints drift, s, and speed at which the payload rests in any case, m/s and rad/s."""
NO_STEADY_METRICS = f"the run ends, or an event occurs, before {SETTLING_S:g} s"

STEADY_METRICS = (
    "position_rms_m",
    "orientation_rms_rad",
    "internal_axial_mean_N",
    "internal_axial_rms_error_N",
    "internal_shear_rms_N",
    "internal_moment_rms_error_Nm",
)
"""Metrics over the steady window; ``after_event_`` and their names are those after the last event."""

METRIC_TEXTS = {
    "settling_time_s": ("settles to 5 mm and 5 mrad after the start", "s", 1.0),
    "resettling_time_s": ("settles again after the first event", "s", 1.0),
    "event_peak_position_error_m": ("largest position error from the first event on", "mm", 1e3),
    "position_rms_m": ("position error, rms", "mm", 1e3),
    "orientation_rms_rad": ("orientation error, rms", "mrad", 1e3),
    "internal_axial_mean_N": ("internal force along the line between the tips, mean", "N", 1.0),
    "internal_axial_rms_error_N": ("internal force along the line, rms of its error", "N", 1.0),
    "internal_shear_rms_N": ("internal force across the line, rms of its error", "N", 1.0),
    "internal_moment_rms_error_Nm": ("internal moment about P, rms of its error", "N m", 1.0),
    "torque_peak_Nm": ("largest drive torque", "N m", 1.0),
    "joint_drift_rad": ("drift of a joint in the last second, the payload at rest", "mrad", 1e3),
    "closure_error_max_m": ("closure error, largest distance", "m", 1.0),
    "closure_error_max_rad": ("closure error, largest angle", "rad", 1.0),
    "energy_balance_max_J": ("energy minus work, largest", "J", 1.0),
    "squeeze_reserve_min_N": ("normal force of a patch or pad beyond what friction needs, least", "N", 1.0),
    "dropped_at_s": ("nothing holds the payload from", "s", 1.0),
}
"""Text of each metric, its unit as shown, and the scale from the SI value to that unit."""

METRIC_TEXTS |= {
    f"after_event_{name}": (f"{text}, after the last event", unit, scale)
    for name, (text, unit, scale) in METRIC_TEXTS.items()
    if name in STEADY_METRICS
}


def all_metrics(data: Arrays, windows: Windows, *, turns: bool) -> dict[str, Any]:
    """Return all metrics by name but ``trustworthy``; see RunResult.metrics, and in_band for ``turns``."""
    after, (distance, angle) = windows.after_event, closure_error_max(data)
    return {
        "settling_time_s": settling_time(data, Window(0.0, windows.event.start), turns=turns),
        "resettling_time_s": resettling_time(data, windows, turns=turns),
        "event_peak_position_error_m": event_peak_position_error(data, windows),
        **steady_metrics(data, windows.steady),
        "closure_error_max_m": distance,
        "closure_error_max_rad": angle,
        "energy_balance_max_J": np.abs(energy_balance(data)).max(axis=-1),
        "torque_peak_Nm": np.fmax.reduce(np.abs(np.asarray(data["torque"])), axis=(-3, -2, -1)),
        "joint_drift_rad": np.fmax.reduce(joint_drift(data, windows), axis=(-2, -1)),
        "window_start_s": windows.steady.start,
        "window_end_s": windows.steady.end,
        **{f"after_event_{name}": value for name, value in steady_metrics(data, after).items()},
        "after_event_window_start_s": after.start if windows.has_events else math.nan,
        "after_event_window_end_s": after.end if windows.has_events else math.nan,
    }


# ------------------------------------------------------------ tracking


def in_band(data: Arrays, *, turns: bool) -> Mask:
    """Return the mask of the samples with errors of at most 5 mm and 5 mrad, shape (..., n).

    Args:
        data: arrays of a run.
        turns: whether the task rows control the orientation; otherwise its error does not count.
    """
    if "pose_entries" in data and (inside := _in_band_by_trace(data, turns)) is not None:
        return inside
    distances, angles = error_norms(data)
    return np.asarray((distances <= POSITION_BAND_M) & ((angles <= ORIENTATION_BAND_RAD) | (not turns)))


def _in_band_by_trace(data: Arrays, turns: bool) -> Mask | None:
    """Return in_band by the trace of R R_d^T, 1 + 2 cos(angle): less work; None if rounding decides."""
    X, X_d = data["pose_entries"], data["desired_pose"]
    x, y, z = (X[i][3] - X_d[..., i, 3] for i in range(3))
    inside = np.asarray(np.sqrt(x * x + y * y + z * z) <= POSITION_BAND_M)
    trace = sum(X[i][j] * X_d[..., i, j] for i in range(3) for j in range(3)) if turns else 3.0
    excess = trace - (1.0 + 2.0 * math.cos(ORIENTATION_BAND_RAD))
    return inside & (excess > 0.0) if np.all(np.abs(excess) > _TRACE_ROUNDING) else None


def start_decay(data: Arrays, windows: Windows, *, turns: bool) -> float:
    """Return the time until the errors that a run starts with have decayed, s.

    They have where the pose error is in the band, the internal force within 1 N or 10 % of what is desired,
    and its error grows for the first time; at the latest at the first event. 0 for a run that starts in the
    bands, or never gets there.

    Args:
        data: arrays of a run.
        windows: windows of the run.
        turns: whether the task rows control the orientation.
    """
    force, desired = (
        np.hypot(*(np.nan_to_num(data[f"{name}_{part}"]) for part in parts)).max(axis=-1)
        for name, parts in (
            ("internal", ("axial_error", "shear_error")),
            ("desired_internal", ("axial", "shear")),
        )
    )
    is_near = in_band(data, turns=turns) & (force <= np.maximum(FORCE_BAND_N, FORCE_BAND_SHARE * desired))
    if is_near[0] or not is_near.any():
        return 0.0
    near = int(is_near.argmax())
    grows = np.append(np.diff(force[near:]) > 0.0, True)
    return min(float(np.asarray(data["time"])[near + grows.argmax()]), windows.event.start)


def error_norms(data: Arrays) -> tuple[Array, Array]:
    """Return the norms of the position and orientation errors, m and rad, shapes (..., n)."""
    x, y, z, rx, ry, rz = np.moveaxis(np.asarray(data["pose_error"]), -1, 0)
    return np.sqrt(x * x + y * y + z * z), np.sqrt(rx * rx + ry * ry + rz * rz)


def settling_time(data: Arrays, window: Window, *, turns: bool) -> Array:
    """Return the time from the window's start after which the errors stay in the band; inf if they do not."""
    inside, time = samples_of(data, window), np.asarray(data["time"])
    out = inside & ~in_band(data, turns=turns)
    times = np.append(np.where(inside, time - window.start, np.inf), np.inf)
    return np.where(out.any(axis=-1), times[len(time) - np.argmax(out[..., ::-1], axis=-1)], 0.0)


def resettling_time(data: Arrays, windows: Windows, *, turns: bool) -> Array:
    """Return the settling time after the first event, s; NaN without one, or if the band is not left."""
    if not windows.has_events:
        return np.array(np.nan)
    is_left = np.any(samples_of(data, windows.event) & ~in_band(data, turns=turns), axis=-1)
    return np.where(is_left, settling_time(data, windows.event, turns=turns), np.nan)


def event_peak_position_error(data: Arrays, windows: Windows) -> Array:
    """Return the largest position error from the first event on, m; NaN without an event."""
    if not windows.has_events:
        return np.array(np.nan)
    return error_norms(data)[0][..., samples_of(data, windows.event)].max(axis=-1, initial=0.0)


def steady_metrics(data: Arrays, window: Window) -> dict[str, Array]:
    """Return STEADY_METRICS over a window; NaN if it is empty."""
    if window.is_empty:
        return dict.fromkeys(STEADY_METRICS, np.array(np.nan))
    inside = samples_of(data, window)
    errors = (rms(np.compress(inside, values, axis=-1)) for values in error_norms(data))
    internal: tuple[Any, ...] = internal_force(data, window)
    return dict(zip(STEADY_METRICS, (*errors, *internal), strict=True))


# ------------------------------------------------------------ internal force


class InternalForceMetrics(NamedTuple):
    """Internal force over a window and over all arms; NaN for a single arm, which has none.

    The axial direction of an arm is the line from its own tip to the middle of the other tips: for two arms,
    the line between the tips.

    Attributes:
        axial_mean: mean force along the axial direction, N; negative where the arms squeeze.
        axial_rms_error: rms of its error, N.
        shear_rms: rms of the force error across the axial direction, N.
        moment_rms_error: rms of the moment error about P, N m.
    """

    axial_mean: float
    axial_rms_error: float
    shear_rms: float
    moment_rms_error: float

    @property
    def force_rms_error(self) -> float:
        """Rms of the force error, axial and shear together, N."""
        return math.hypot(self.axial_rms_error, self.shear_rms)


def internal_force(data: Arrays, window: Window) -> InternalForceMetrics:
    """Return the metrics of the internal wrench over a window; arrays of them for several runs."""
    if len(data["arm"]) == 1:
        return InternalForceMetrics(*[math.nan] * 4)
    inside, parts = samples_of(data, window), ("axial", "axial_error", "shear_error", "moment_error")
    taken = [np.compress(inside, np.asarray(data[f"internal_{part}"]), axis=-2) for part in parts]
    axial, *errors = (values.reshape(*values.shape[:-2], -1) for values in taken)
    values: list[Any] = [mean(axial), *map(rms, errors)]
    return InternalForceMetrics(*values)


# ------------------------------------------------------------ energy


def energy_balance(data: Arrays) -> Array:
    """Return the energy minus all work done, less the same at the start, J, shape (..., n).

    It is zero for an exact integration. The work of an event at the start is done at the first sample.
    """
    return unexplained_energy(data, start_energy(data))


def closure_error_max(data: Arrays) -> tuple[Array, Array]:
    """Return the largest distance (m) and angle (rad) between a tip and its grasp."""
    distance, angle = (np.asarray(data[f"closure_{part}"]) for part in ("distance", "angle"))
    return np.fmax.reduce(distance, axis=(-2, -1)), np.fmax.reduce(angle, axis=(-2, -1))


def joint_drift(data: Arrays, windows: Windows) -> Array:
    """Return how far all joints drift in the last second, rad or m, shape (..., m, k).

    NaN unless the reference rests since 4 s, after all events, and the payload moves at less than a tenth of
    what the joints do: joints that move are then the spare ones of redundant arms.
    """
    time, shape = np.asarray(data["time"]), np.shape(data["joint_position"])
    settled = windows.after_event if windows.has_events else windows.steady
    late, last = (time >= time[-1] - span - _ROUNDING for span in (SETTLING_S, DRIFT_S))
    rests = np.full(shape[:-3], settled.start <= time[-1] - DRIFT_S)
    if rests.any():
        rests &= ~np.compress(late, np.asarray(data["desired_twist"]), axis=-2).any(axis=(-2, -1))
    if not rests.any():
        return np.full((*shape[:-3], *shape[-2:]), np.nan)
    speeds, twist = (np.asarray(data[name]) for name in ("joint_velocity", "payload_twist"))
    drift = DRIFT_S * np.abs(np.compress(last, speeds, axis=-3).mean(axis=-3))
    moved = np.abs(np.compress(last, twist, axis=-2).mean(axis=-2)).max(axis=-1)
    rests &= moved <= REST + np.fmax.reduce(drift, axis=(-2, -1)) / 10.0
    return np.where(rests[..., None, None], drift, np.nan)


# ------------------------------------------------------------ texts and definitions


def metric_text(value: float) -> str:
    """Return a metric as text; a word stands for what is no number."""
    if math.isnan(value):
        return "does not apply"
    return "never" if math.isinf(value) else f"{value:.4g}"


def internal_wrench_definitions(data: xr.Dataset, load_shares: Array, payload: Payload) -> xr.Dataset:
    """Return the internal wrench by every definition of the literature, about P in world axes.

    Rows that rigid bodies do not determine count as zero, and the tips then lie in the plane of the others.
    The virtual bodies of the constraint-consistent definition share the payload's mass, and the third of the
    trace of its inertia, by the load shares.

    Args:
        data: data of a run.
        load_shares: c_i, shape (m,).
        payload: payload, for the virtual bodies.
    """
    r = data["tip_position"].values - data["payload_position"].values[:, None]
    is_determined = data["wrench_is_determined"].values
    F, r = determinate_grasp(data["interaction_wrench"].values, r)
    inertia = float(np.trace(payload.inertia_matrix)) / 3.0
    definitions = {
        "load_shares": internal_wrenches(F, load_shares),
        "minimum_norm": minimum_norm_internal_wrenches(F, r),
        "nonsqueezing": nonsqueezing_internal_wrenches(F, r),
        "virtual_linkage": virtual_linkage_internal_wrenches(F, r),
        "constraint_consistent": constraint_consistent_internal_wrenches(
            F, r, load_shares * payload.mass, load_shares * inertia
        ),
    }
    if F.shape[1] == 2:
        definitions["symmetric"] = symmetric_internal_wrenches(F)
    dims = data["interaction_wrench"].dims
    labelled = {name: (dims, np.where(is_determined, value, np.nan)) for name, value in definitions.items()}
    return type(data)(labelled, {dim: data[dim] for dim in dims}, {"units": "N, N m"})
