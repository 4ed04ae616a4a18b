"""Filtered samples of a record: positions, wrenches and torques through one low-pass, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from coop_pin.base.arrays import Array
from coop_pin.logs.record import ArmRecord, Record

WINDOW = 0.2
"""Width of the Hann kernel, s; what is faster is in no equation of motion that is fitted."""
_EXACT = 3e-5
"""Part of the largest force or moment to which even a sensor without noise, or a simulated one, is true."""
_SPACING = 0.6
"""Distance of the samples that are kept, in windows: their noise is nearly independent."""


def filter_error(values: Array, times: Array, step: float) -> Array:
    """Return the root mean square by which a kernel and stamps miss what a motion demands, shape (k,).

    With the variance s^2 of the kernel, ``s^2 f'' / 2`` is what f of filtered samples misses of the filtered
    f; ``f' step / 2`` what half a sample makes between an acceleration and the wrench that goes with it.
    These errors repeat along a motion and do not average out, so that they count twice.

    Args:
        values: f of filtered samples, shape (n, k).
        times: s, shape (n,).
        step: distance of the samples in the log, s.
    """
    rate = np.gradient(values, times, axis=0)
    curved = np.gradient(rate, times, axis=0) * WINDOW**2 * (1.0 / 12.0 - 0.5 / np.pi**2) / 2.0
    return np.asarray(2.0 * np.sqrt(np.mean((rate * step / 2.0) ** 2 + curved**2, axis=0)))


class Filtered(NamedTuple):
    """Samples of one arm that went through the same kernel.

    Attributes:
        time: s, shape (n,).
        q: joint positions, shape (n, nv).
        v: joint velocities, shape (n, nv).
        a: joint accelerations, shape (n, nv).
        tau: joint torques, shape (n, nv).
        wrench: wrench of the wrist, shape (n, 6).
        noise: standard deviation of the filtered wrench, shape (6,).
        torque_noise: that of the filtered torques, shape (nv,).
    """

    time: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    wrench: Array
    noise: Array
    torque_noise: Array


def deflection(arm: ArmRecord, stiffness: Array) -> tuple[CubicSpline, Array]:
    """Return how far a spring lets a tip off its grasp frame, as a function of time, and its noise.

    ``-F / K`` of the filtered wrench in axes of the tip, m and rad, shapes (n, 6) and (6,).

    Args:
        arm: record of the arm.
        stiffness: K, N/m and N m/rad, shape (6,).
    """
    time, kept = np.unique(arm.wrench_time, return_index=True)
    width = max(round(WINDOW / float(np.median(np.diff(time)))), 4)
    kernel = np.hanning(width + 2)[1:-1]
    smooth = [
        np.convolve(np.pad(one, width, "edge"), kernel / kernel.sum(), "same") for one in arm.wrench[kept].T
    ]
    off = -np.array(smooth)[:, width:-width].T / stiffness
    spread = np.median(np.abs(np.diff(arm.wrench[kept], axis=0)), axis=0) / 0.6745 / np.sqrt(2.0)
    return CubicSpline(time, off), spread / stiffness * np.linalg.norm(kernel / kernel.sum())


def filtered(record: Record, late: Mapping[str, float]) -> dict[str, Filtered]:
    """Return filtered samples of all arms at common times.

    A sum of wrenches equals a rate of momentum at every frequency; filtered alike, both sides stay equal, and
    what noise in the loop shakes at high frequency drops out.

    Args:
        record: record of the arms.
        late: delay of the clock of each arm, s.
    """
    start, end = record.held_span
    step = max(float(np.median(np.diff(arm.time))) for arm in record.arms.values())
    width = max(round(WINDOW / step), 4)
    kernel = np.hanning(width + 2)[1:-1]
    kernel /= kernel.sum()
    grid = np.arange(start, end, step)
    kept = slice(width, max(len(grid) - width, width + 1), max(int(_SPACING * width), 1))
    return {
        name: _filtered(arm, grid, kernel, kept, late.get(name, 0.0)) for name, arm in record.arms.items()
    }


def _filtered(arm: ArmRecord, grid: Array, kernel: Array, kept: slice, late: float) -> Filtered:
    step = float(grid[1] - grid[0])

    def smooth(time: Array, values: Array) -> Array:
        columns = [np.interp(grid + late, time, column) for column in values.T]
        return np.array([np.convolve(column, kernel, "same") for column in columns]).T

    def scatter(values: Array) -> Array:
        differences = np.abs(np.diff(values, axis=0))
        spread = np.median(differences, axis=0) / 0.6745 / np.sqrt(2.0)
        return np.asarray(np.maximum(spread, 1e-6) * np.sqrt((kernel**2).sum()))

    q = smooth(arm.time, arm.position)
    v = np.gradient(q, step, axis=0)
    a = np.zeros_like(q)
    a[1:-1] = np.diff(q, 2, axis=0) / step**2
    wrench, noise = np.full((len(grid), 6), np.nan), np.full(6, np.nan)
    if len(arm.wrench_time):
        wrench = smooth(arm.wrench_time, arm.wrench)
        largest = np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0)
        noise = np.hypot(scatter(arm.wrench), _EXACT * np.repeat(largest, 3))
    tau = smooth(arm.time, arm.effort)
    time, q, v, a, tau, wrench = (each[kept] for each in (grid, q, v, a, tau, wrench))
    return Filtered(time, q, v, a, tau, wrench, noise, scatter(arm.effort))
