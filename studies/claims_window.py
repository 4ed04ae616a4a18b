"""Errors of a run over the windows of the study of the paper's claims; stored runs are bound to this file."""

from __future__ import annotations

import numpy as np

import coop_pin as cp

EVENT = 10.0
"""Time of the paper's event, s; a shorter run has none."""
FROM = 4.0
"""Start of the judged window, which ends before the event, s."""
BAND = (5e-3, 5e-3)
"""Position, m, and orientation, rad, within which a run has settled."""
NARROW_BAND = (1e-3, 1e-3)
"""The same for the second rule."""
FORCE_BAND = 0.1
"""Internal-force error, N, below which it has vanished: a hundredth of the desired force."""


def judged(result: cp.RunResult) -> dict[str, float]:
    """Return errors before the event, after it, and over the last second of a run but its last sample.

    Internal force is axial and shear together. A time of settling is the first after which the error stays in
    the band until the event, or the end; infinite if there is none. The internal force has converged when it
    stays within a band: the stated one, or twice the rms of its own window.
    """
    data = result.data
    time, error = data.time.values, data.pose_error.values
    position, angle = (np.linalg.norm(part, axis=1) for part in (error[:, :3], error[:, 3:]))
    force = np.hypot(data.internal_axial_error.values, data.internal_shear_error.values).max(axis=1)
    before, end = time < EVENT - 1e-9, (time > time[-1] - 1.0) & (time < time[-1])
    window = before & (time >= FROM)
    outside, far = ((position > band[0]) | (angle > band[1]) for band in (BAND, NARROW_BAND))
    values = {
        "settled_s": _last(time, outside, before),
        "settled_narrow_s": _last(time, far, before),
        "position_mm": 1e3 * _rms(position[window]),
        "force_N": _rms(force[window]),
        "axial_N": float(data.internal_axial.values[window].mean()),
        "force_converged_s": _last(time, force > 2.0 * _rms(force[window]), before),
        "force_in_band_s": _last(time, force > FORCE_BAND, before),
        "end_position_mm": 1e3 * _rms(position[end]),
        "end_force_N": _rms(force[end]),
        "end_axial_N": float(data.internal_axial.values[end].mean()),
    }
    if before.all():
        return values
    after = ~before
    values["settled_again_s"] = _last(time, outside, after) - EVENT
    values["settled_again_narrow_s"] = _last(time, far, after) - EVENT
    return values | {"event_peak_mm": 1e3 * float(position[after].max())}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _last(time: np.ndarray, outside: np.ndarray, part: np.ndarray) -> float:
    """Return the first time of a part of a run from which on nothing is outside."""
    times, out = time[part], np.flatnonzero(outside[part])
    if out.size == 0:
        return float(times[0])
    return float(times[out[-1] + 1]) if out[-1] + 1 < times.size else float("inf")
