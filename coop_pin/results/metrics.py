"""Metrics of a run: settling time, tracking error, internal force, energy balance, limit violations.

Functions of a run's arrays by name, such as its dataset; those that average state their window.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from coop_pin.arrays import Array, Mask
from coop_pin.description.payload import Payload
from coop_pin.errors import ArgumentError, OutOfRangeError
from coop_pin.spatial import internal_wrenches
from coop_pin.spatial.internal_wrench import (
    constraint_consistent_internal_wrenches,
    minimum_norm_internal_wrenches,
    nonsqueezing_internal_wrenches,
    symmetric_internal_wrenches,
    virtual_linkage_internal_wrenches,
)

POSITION_BAND_M = 5e-3
ORIENTATION_BAND_RAD = 5e-3
SETTLING_S = 4.0
"""Time that a run has to settle after its start and after its last event before it is called steady, s."""
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
    "closure_error_max_m": ("closure error, largest distance", "m", 1.0),
    "closure_error_max_rad": ("closure error, largest angle", "rad", 1.0),
    "energy_balance_max_J": ("energy minus work, largest", "J", 1.0),
}
"""Text of each metric, its unit as shown, and the scale from the SI value to that unit."""

METRIC_TEXTS |= {
    f"after_event_{name}": (f"{text}, after the last event", unit, scale)
    for name, (text, unit, scale) in METRIC_TEXTS.items()
    if name in STEADY_METRICS
}

Arrays: TypeAlias = Mapping[Any, Any] | xr.Dataset
"""Arrays of a run by name: numpy's, or labelled ones."""
_SLACK = 1e-9
"""Differences below it, in time or beyond a limit, are rounding."""


class Window(NamedTuple):
    """A span of time.

    Attributes:
        start: s.
        end: s.
    """

    start: float
    end: float

    @property
    def is_empty(self) -> bool:
        """Whether it ends before it starts, or has no length."""
        return self.start >= self.end

    def __str__(self) -> str:
        """Return it as text."""
        return "empty window" if self.is_empty else f"{self.start:g} to {self.end:g} s"


def checked_window(window: tuple[float, float], end: float) -> Window:
    """Return a window that a caller asks for.

    Raises:
        ArgumentError: it is not a pair of numbers.
        OutOfRangeError: it is empty, or not within the run, which ends at ``end``.
    """
    try:
        start, stop = map(float, window)
    except (TypeError, ValueError):
        raise ArgumentError(f"window is {window!r}; it must be a pair of times in s, start and end") from None
    if not 0.0 <= start < end:
        raise OutOfRangeError("start of the window", start, f"from 0 to the end of the run, {end:g} s")
    if not start < stop <= end + _SLACK:
        raise OutOfRangeError("end of the window", stop, f"after its start {start:g} s, at most {end:g} s")
    return Window(start, stop)


def samples_of(data: Arrays, window: Window) -> Mask:
    """Return the mask of the samples with start <= t < end, shape (n,).

    The last sample of a run is in a window that reaches the end of the run.
    """
    time = np.asarray(data["time"])
    return np.asarray(
        (time >= window.start - _SLACK)
        & ((time < window.end - _SLACK) | (time == time[-1]) & (window.end >= time[-1] - _SLACK))
    )


def rms(values: Array) -> float:
    """Return the root of the mean square over all entries; NaN when there are none."""
    return math.sqrt(float(np.mean(np.square(values)))) if values.size else math.nan


# ------------------------------------------------------------ tracking


def in_band(data: Arrays) -> Mask:
    """Return the mask of the samples with errors of at most 5 mm and 5 mrad, shape (n,)."""
    error = np.asarray(data["pose_error"])
    near = np.linalg.norm(error[:, :3], axis=1) <= POSITION_BAND_M
    aligned = np.linalg.norm(error[:, 3:], axis=1) <= ORIENTATION_BAND_RAD
    return np.asarray(near & aligned)


def settling_time(data: Arrays, window: Window) -> float:
    """Return the time from the window's start after which the errors stay in the band; inf if they do not."""
    inside, time = samples_of(data, window), np.asarray(data["time"])
    out = np.flatnonzero(inside & ~in_band(data))
    if out.size == 0:
        return 0.0
    after = np.flatnonzero(inside & (np.arange(len(time)) > out[-1]))
    return float(time[after[0]] - window.start) if after.size else math.inf


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
    """Return the metrics of the internal wrench over a window."""
    if len(data["arm"]) == 1:
        return InternalForceMetrics(*[math.nan] * 4)
    inside = samples_of(data, window)
    axial = np.asarray(data["internal_axial"])[inside]
    errors = (np.asarray(data[f"internal_{part}_error"])[inside] for part in ("axial", "shear", "moment"))
    return InternalForceMetrics(float(axial.mean()) if axial.size else math.nan, *map(rms, errors))


# ------------------------------------------------------------ energy


def energy_balance(data: Arrays) -> Array:
    """Return energy minus its start minus all work done, J, shape (n,): zero for an exact integration."""
    energy = np.asarray(data["kinetic_energy"]) + np.asarray(data["potential_energy"])
    work = sum(
        np.asarray(data[f"work_{channel}"])
        for channel in ("actuation", "friction", "external", "payload_change")
    )
    return np.asarray(energy - energy[0] - work)


# ------------------------------------------------------------ limits


class LimitViolation(NamedTuple):
    """A limit that a run exceeded.

    Attributes:
        arm: the arm.
        joint: the joint; for a torque the drive of that number.
        kind: "position", "velocity" or "torque" (asked of the drive by controller and gravity compensation;
            what is applied never exceeds the limit).
        worst: the value furthest beyond, rad or m, rad/s or m/s, N m.
        limit: the limit that was exceeded.
        first_time: when it was exceeded first, s.
    """

    arm: str
    joint: str
    kind: Literal["position", "velocity", "torque"]
    worst: float
    limit: float
    first_time: float


def limit_violations(data: Arrays) -> tuple[LimitViolation, ...]:
    """Return the limits that were exceeded, by arm, joint and kind; the plant stops no joint at its limit."""
    found = []
    for a, arm in enumerate(np.asarray(data["arm"])):
        for j, joint in enumerate(np.asarray(data["joint_name"])[a]):
            if not joint:
                continue
            for kind, values, lower, upper in _limited(data, a, j):
                over = np.maximum(values - upper, lower - values)  # NaN, so never exceeded, without a limit
                beyond = np.flatnonzero(over > _SLACK)
                if beyond.size:
                    worst = float(values[beyond[np.argmax(over[beyond])]])
                    limit = upper if worst > upper else lower
                    first = float(np.asarray(data["time"])[beyond[0]])
                    found.append(LimitViolation(str(arm), str(joint), kind, worst, limit, first))
    return tuple(found)


def _limited(
    data: Arrays, a: int, j: int
) -> list[tuple[Literal["position", "velocity", "torque"], Array, float, float]]:
    """Return kind, values over time, lower and upper limit of one joint."""
    lower, upper, speed, torque = (
        float(np.asarray(data[name])[a, j])
        for name in ("position_lower", "position_upper", "velocity_limit", "torque_limit")
    )
    asked = "requested_torque" if "requested_torque" in data else "commanded_torque"
    return [
        ("position", np.asarray(data["joint_position"])[:, a, j], lower, upper),
        ("velocity", np.asarray(data["joint_velocity"])[:, a, j], -speed, speed),
        ("torque", np.asarray(data[asked])[:, a, j], -torque, torque),
    ]


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
        data: of a run.
        load_shares: c_i, shape (m,).
        payload: for the virtual bodies.
    """
    F = data["interaction_wrench"].values
    p_WP = data["payload_position"].values[:, None]
    is_determined = data["wrench_is_determined"].values
    F, r = (
        np.where(is_determined, F, 0.0),
        np.where(is_determined[:3], data["tip_position"].values - p_WP, 0.0),
    )
    inertia = float(np.trace(payload.inertia_matrix)) / 3.0
    found = {
        "load_shares": internal_wrenches(F, load_shares),
        "minimum_norm": minimum_norm_internal_wrenches(F, r),
        "nonsqueezing": nonsqueezing_internal_wrenches(F, r),
        "virtual_linkage": virtual_linkage_internal_wrenches(F, r),
        "constraint_consistent": constraint_consistent_internal_wrenches(
            F, r, load_shares * payload.mass, load_shares * inertia
        ),
    }
    if F.shape[1] == 2:
        found["symmetric"] = symmetric_internal_wrenches(F)
    dims = data["interaction_wrench"].dims
    labelled = {name: (dims, np.where(is_determined, value, np.nan)) for name, value in found.items()}
    return xr.Dataset(labelled, {dim: data[dim] for dim in dims}, {"units": "N, N m"})
