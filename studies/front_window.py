"""Errors of a run over the judged window of the front study; apart, as stored runs are bound to this file."""

from __future__ import annotations

import coop_pin as cp

WINDOWS = {"adept-anchored": (4.0, 10.0), "two-pandas-box": (1.0, 3.0)}
"""start <= t < end of each scenario, s."""


def judged(result: cp.RunResult) -> dict[str, float]:
    """Return the rms errors of a run over its window; the cost counts 1 mm as much as 1 N."""
    window = WINDOWS[result.scenario.name]
    force, position = result.internal_force(window=window), 1e3 * result.position_rms(window=window)
    return {
        "position_mm": position,
        "orientation_mrad": 1e3 * result.orientation_rms(window=window),
        "force_N": force.force_rms_error,
        "moment_Nm": force.moment_rms_error,
        "cost": position + force.force_rms_error,
    }
