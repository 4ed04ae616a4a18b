"""Filtered samples of a record: positions, wrenches and torques through one low-pass, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter, savgol_coeffs, savgol_filter
from scipy.spatial.transform import Rotation
from scipy.special import binom

from coop_pin.base.arrays import Array
from coop_pin.grasps.spring_damper import SpringDamper
from coop_pin.logs.record import ArmRecord, Record

WINDOW = 0.2
"""Width of the Hann kernel, s; what is faster is in no equation of motion that is fitted."""
EXACT_ANGLE = 1e-6
"""Angle to which no chain of links is true, rad, however much its noise is smoothed."""
_POSES, APART = 600, 3
"""Poses that are fitted, and samples from one to the next, at least."""
_SOLVES, _SPRUNG = 30, 1e-3
"""Steps to the turn of a spring, and the part of its largest deflection to which its law is true."""
_DAMPED = 0.1
"""Part of a spring's damping to which a ratio states it: the mobility changes with load and configuration."""
MARGIN = 0.25
"""Time at both ends of a record that clocks may shift, s."""
_EXACT = 3e-5
"""Part of the largest force or moment to which even a sensor without noise, or a simulated one, is true."""
_SPACING = 0.6
"""Distance of the samples that are kept, in windows, at which their noise is nearly independent."""


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
        give: acceleration of the tip in its grasp frame by a spring, m/s^2 and rad/s^2, shape (n, 6).
    """

    time: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    wrench: Array
    noise: Array
    give: Array


def smoothing(times: Array) -> int:
    """Return the samples of a cubic fit over a window, which leaves what a slow motion does as it is."""
    return max(round(WINDOW / float(np.median(np.diff(times)))) | 1, 5)


def deflection(
    arm: ArmRecord, spring: SpringDamper, free: tuple[float, float] | None
) -> tuple[CubicSpline, Array]:
    """Return where a spring lets the tip be in its grasp frame, and the noise of it smoothed.

    Position and rotation vector by the equation of CompliantGrasp, with the wrench turned from axes of the
    tip.

    Args:
        arm: record of the arm.
        spring: one spring and damper.
        free: interval whose mean reading is no load of the spring, s.

    Returns:
        m and rad, shapes (n, 6) and (6,).
    """
    time, kept = np.unique(arm.wrench_time, return_index=True)
    read = arm.free_wrench(free)
    wrench = arm.wrench[kept] - read.sum(axis=0) / max(len(read), 1)
    force, moment = wrench[:, :3], wrench[:, 3:]
    stiffness, turn = spring.stiffness[0], np.zeros_like(force)
    lag = spring.damping[0] / stiffness
    for _ in range(_SOLVES):
        turned = Rotation.from_rotvec(turn)
        R, p = turned.as_matrix(), -turned.apply(force) / stiffness[:3]
        missing = spring.elastic(p, R)[:, 3:] - turned.apply(moment)
        turn = turn + missing / stiffness[3:]
    off, step = np.hstack((p, turn)), float(np.median(np.diff(time)))
    late = np.exp(-step / np.maximum(lag, 1e-9))
    damped = [
        lfilter((0.0, 1.0 - a), (1.0, -a), one - one[0]) + one[0] for a, one in zip(late, off.T, strict=True)
    ]
    width = smoothing(time)
    law = _SPRUNG * np.repeat(np.linalg.norm(off.reshape(-1, 2, 3), axis=2).max(axis=0), 3)
    rates = savgol_filter(off, width, 3, deriv=1, delta=step, axis=0)
    noise = _scatter(wrench) / stiffness * np.linalg.norm(savgol_coeffs(width, 3))
    noise = np.sqrt(noise**2 + law**2 + (_DAMPED * lag) ** 2 * (rates**2).mean(axis=0))
    return CubicSpline(time, np.transpose(damped)), noise


def filtered(
    record: Record,
    late: Mapping[str, float],
    spacing: float = _SPACING,
    springs: Mapping[str, CubicSpline] | None = None,
) -> dict[str, Filtered]:
    """Return filtered samples of all arms at common times.

    A sum of wrenches equals a rate of momentum at every frequency; filtered alike, both sides stay equal, and
    what noise in the loop shakes at high frequency drops out.

    Args:
        record: record of the arms.
        late: delay of the clock of each arm, s.
        spacing: distance of the samples that are kept, in windows.
        springs: deflections of the arms that have a spring, as of ``deflection``.
    """
    start, end = record.held_span
    step = max(float(np.median(np.diff(arm.time))) for arm in record.arms.values())
    width = max(round(WINDOW / step), 4)
    kernel = np.hanning(width + 2)[1:-1]
    kernel /= kernel.sum()
    grid = np.arange(start, end, step)
    kept = slice(width, max(len(grid) - width, width + 1), max(int(spacing * width), 1))
    return {
        name: _filtered(arm, grid, kernel, kept, late.get(name, 0.0), (springs or {}).get(name))
        for name, arm in record.arms.items()
    }


def _filtered(
    arm: ArmRecord, grid: Array, kernel: Array, kept: slice, late: float, spring: CubicSpline | None
) -> Filtered:
    step = float(grid[1] - grid[0])

    def smooth(time: Array, values: Array) -> Array:
        columns = [np.interp(grid + late, time, column) for column in values.T]
        return np.array([np.convolve(column, kernel, "same") for column in columns]).T

    q = smooth(arm.time, arm.position)
    v = np.gradient(q, step, axis=0)
    off = np.zeros((len(grid), 6)) if spring is None else smooth(spring.x, spring(spring.x))
    a, give = np.zeros_like(q), np.zeros_like(off)
    a[1:-1], give[1:-1] = (np.diff(each, 2, axis=0) / step**2 for each in (q, off))
    wrench, noise = np.full((len(grid), 6), np.nan), np.full(6, np.nan)
    if len(arm.wrench_time):
        wrench = smooth(arm.wrench_time, arm.wrench)
        largest = np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0)
        scatter = np.maximum(_scatter(arm.wrench), 1e-6) * np.linalg.norm(kernel)
        noise = np.hypot(scatter, _EXACT * np.repeat(largest, 3))
    tau = smooth(arm.time, arm.effort)
    time, q, v, a, tau, wrench, give = (each[kept] for each in (grid, q, v, a, tau, wrench, give))
    return Filtered(time, q, v, a, tau, wrench, noise, give)


def _scatter(values: Array, order: int = 1) -> Array:
    """Return the standard deviation of samples by their differences, shape (k,)."""
    spread = np.median(np.abs(np.diff(values, order, axis=0)), axis=0) / 0.6745
    return np.asarray(spread / np.sqrt(binom(2 * order, order)))


def position_noise(position: Array) -> Array:
    """Return the standard deviation of positions: of their counts, or of what is not smooth.

    Counts are seen if most steps are multiples of the smallest one.

    Args:
        position: positions of drives over time, rad or m, shape (n, nv).
    """
    roughs = np.zeros(position.shape[1]) if len(position) < 4 else _scatter(position, 3)
    sds = []
    for q, rough in zip(position.T, roughs, strict=True):
        steps = np.abs(np.diff(q))
        steps = steps[steps > 1e-12]
        count = float(steps.min()) if len(steps) else 0.0
        ratios = steps / count if count else np.ones(1)
        is_counted = bool(np.mean(np.abs(ratios - np.round(ratios)) < 0.02) > 0.98)
        sds.append(count / np.sqrt(12.0) if is_counted else rough)
    return np.array(sds)


def sample_times(record: Record, apart: int = APART) -> Array:
    """Return times that are spread over the movement of the joints, without gaps and free hands.

    Equal parts of the path of all joints: at rest, errors of counts would repeat.

    Args:
        record: record of the arms.
        apart: samples of the first arm from one time to the next, at least.
    """
    start, end = record.held_span
    first = next(iter(record.arms.values())).time
    grid = np.linspace(start + MARGIN, end - MARGIN, 4 * _POSES)
    is_near = np.ones(len(grid), dtype=bool)
    path = np.zeros(len(grid))
    for arm in record.arms.values():
        after = np.clip(np.searchsorted(arm.time, grid), 1, len(arm.time) - 1)
        is_near &= arm.time[after] - arm.time[after - 1] < 5.0 * float(np.median(np.diff(arm.time)))
        q = np.array([np.interp(grid, arm.time, one) for one in arm.position.T])
        path[1:] += np.abs(np.diff(q, axis=1)).sum(axis=0)
    path = np.cumsum(path) + 1e-9 * (grid - grid[0]) / max(float(np.ptp(first)), 1e-9)
    equal = np.interp(np.linspace(0.0, path[-1], _POSES), path, grid)
    kept = np.interp(equal, grid, is_near) == 1.0
    # where nothing of the first arm is interpolated; interpolations of the others share their samples' noise
    stamps = np.unique(first)[::apart]
    return np.unique(stamps[np.clip(np.searchsorted(stamps, equal[kept]), 0, len(stamps) - 1)])
