"""Metrics of the studies: rms errors from 4 s to the end of a run, when what it starts with has decayed."""

from __future__ import annotations

import coop_pin as cp


def errors(result: cp.RunResult) -> dict[str, float]:
    """Return rms errors of the position, m, and of the internal force along and across, N."""
    window = (4.0, result.end)
    force = result.internal_force(window=window)
    return {
        "settled_position_rms_m": result.position_rms(window=window),
        "settled_axial_rms_error_N": force.axial_rms_error,
        "settled_shear_rms_N": force.shear_rms,
    }
