"""What a run's arrays say: settling, tracking, internal force, closure, energy; each with its window stated."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array, Mask

_SLACK = 1e-9


class LimitTable(NamedTuple):
    """Limits of m arms with at most k joints each; NaN where there is none, and beyond an arm's joints.

    Attributes:
        joints: names of each arm's joints.
        position_lower: rad or m, shape (m, k).
        position_upper: rad or m, shape (m, k).
        velocity_limit: rad/s or m/s, shape (m, k).
        torque_limit: of the drives, N m, shape (m, k).
    """

    joints: tuple[tuple[str, ...], ...]
    position_lower: Array
    position_upper: Array
    velocity_limit: Array
    torque_limit: Array


class LimitViolation(NamedTuple):
    """One limit that a run went beyond.

    Attributes:
        arm: the arm.
        joint: the joint; for a torque the drive of that number.
        kind: "position", "velocity" or "torque" (commanded; what is applied never exceeds the limit).
        worst: the value furthest beyond, rad or m, rad/s or m/s, N m.
        limit: the limit it went beyond.
        first_time: when it was first beyond, s.
    """

    arm: str
    joint: str
    kind: Literal["position", "velocity", "torque"]
    worst: float
    limit: float
    first_time: float


def limit_violations(data: xr.Dataset) -> tuple[LimitViolation, ...]:
    """Return every limit that was exceeded, by arm, joint and kind. Joints are not stopped at their limits, only judged."""
    found = []
    for a, arm in enumerate(data["arm"].values):
        for j, joint in enumerate(data["joint_name"].values[a]):
            if not joint:
                continue
            for kind, values, lower, upper in _watched(data, a, j):
                over = np.maximum(
                    values - upper, lower - values
                )  # NaN where there is no limit: then nothing is over it
                beyond = np.flatnonzero(over > _SLACK)
                if beyond.size:
                    worst = int(beyond[np.argmax(over[beyond])])
                    limit = upper if values[worst] > upper else lower
                    first = float(data["time"].values[beyond[0]])
                    found.append(
                        LimitViolation(str(arm), str(joint), kind, float(values[worst]), float(limit), first)
                    )
    return tuple(found)


def _watched(
    data: xr.Dataset, a: int, j: int
) -> list[tuple[Literal["position", "velocity", "torque"], Array, float, float]]:
    """Return kind, values over time, lower and upper limit of one joint."""
    speed, torque = float(data["velocity_limit"].values[a, j]), float(data["torque_limit"].values[a, j])
    lower, upper = float(data["position_lower"].values[a, j]), float(data["position_upper"].values[a, j])
    return [
        ("position", data["joint_position"].values[:, a, j], lower, upper),
        ("velocity", data["joint_velocity"].values[:, a, j], -speed, speed),
        ("torque", data["commanded_torque"].values[:, a, j], -torque, torque),
    ]


POSITION_BAND_M = 5e-3
ORIENTATION_BAND_RAD = 5e-3
STEADY_FROM_S = 4.0


class Window(NamedTuple):
    """A span of time.

    Attributes:
        start: s.
        end: s.
    """

    start: float
    end: float


class InternalForceMetrics(NamedTuple):
    """Internal-wrench errors over a window, over all arms.

    The axis of an arm is the line from its own tip to the middle of the other tips: for two arms, the line
    between the tips.

    Attributes:
        axial_mean: mean internal force along the axis, N; negative where the arms squeeze.
        axial_rms_error: rms of its error, N.
        shear_rms: rms of the force error across the axis, N.
        moment_rms_error: rms of the moment error about P, N m.
    """

    axial_mean: float
    axial_rms_error: float
    shear_rms: float
    moment_rms_error: float

    @property
    def force_rms_error(self) -> float:
        """Axial and shear together, N."""
        return math.hypot(self.axial_rms_error, self.shear_rms)


def rms(values: Array) -> float:
    """Return the root of the mean square over all samples; not a number when there are none."""
    return math.sqrt(float(np.mean(np.square(values)))) if values.size else math.nan


def in_band(data: xr.Dataset) -> Mask:
    """Return for every sample whether position and orientation errors are within 5 mm and 5 mrad, shape (n,)."""
    error = data["pose_error"].values
    near = np.linalg.norm(error[:, :3], axis=1) <= POSITION_BAND_M
    aligned = np.linalg.norm(error[:, 3:], axis=1) <= ORIENTATION_BAND_RAD
    return np.asarray(near & aligned)


def settling_time(data: xr.Dataset, window: Window) -> float:
    """Return the time from the window's start after which the errors stay in the band; inf if they do not."""
    inside, time = samples_of(data, window), data["time"].values
    out = np.flatnonzero(inside & ~in_band(data))
    if out.size == 0:
        return 0.0
    after = np.flatnonzero(inside & (np.arange(len(time)) > out[-1]))
    return float(time[after[0]] - window.start) if after.size else math.inf


def samples_of(data: xr.Dataset, window: Window) -> Mask:
    """Return a mask of the samples with start <= t < end; the last sample of a run belongs to it."""
    time = data["time"].values
    return np.asarray(
        (time >= window.start - 1e-9)
        & ((time < window.end - 1e-9) | (time == time[-1]) & (window.end >= time[-1] - 1e-9))
    )


def axial_directions(data: xr.Dataset) -> Array:
    """Return for every sample and arm the unit vector from its tip to the middle of the other tips, shape (n, m, 3).

    Not a number for a single arm.
    """
    tips = data["tip_position"].values
    if tips.shape[1] == 1:
        return np.full_like(tips, np.nan)
    others = (tips.sum(axis=1, keepdims=True) - tips) / (tips.shape[1] - 1)
    line = others - tips
    length = np.linalg.norm(line, axis=2, keepdims=True)
    return np.divide(line, length, out=np.full_like(line, np.nan), where=length > 0.0)


def internal_force(data: xr.Dataset, window: Window) -> InternalForceMetrics:
    """Judge internal wrenches over a window; not a number for a single arm, which has none."""
    inside, axis = samples_of(data, window), axial_directions(data)
    actual = np.nan_to_num(
        data["internal_wrench"].values
    )  # outside the task rows nothing is known and nothing is judged
    error = np.nan_to_num(data["internal_wrench"].values - data["desired_internal_wrench"].values)
    axial = np.einsum("nmi,nmi->nm", actual[..., :3], axis)[inside]
    axial_error = np.einsum("nmi,nmi->nm", error[..., :3], axis)
    shear_error = np.linalg.norm(error[..., :3] - axial_error[..., None] * axis, axis=2)
    moment_error = np.linalg.norm(error[..., 3:], axis=2)
    mean = float(axial.mean()) if axial.size else math.nan
    return InternalForceMetrics(
        mean, rms(axial_error[inside]), rms(shear_error[inside]), rms(moment_error[inside])
    )


def energy_balance(data: xr.Dataset) -> Array:
    """Return energy minus its start minus all work done, J, shape (n,): zero for an exact integration."""
    energy = data["kinetic_energy"].values + data["potential_energy"].values
    work = sum(
        data[f"work_{channel}"].values for channel in ("actuation", "friction", "external", "payload_change")
    )
    return np.asarray(energy - energy[0] - work)
