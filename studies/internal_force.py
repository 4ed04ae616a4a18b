"""The honest part: what alpha, K_f and a kinematic bias do to the internal force under law (23)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.figures import (
    BiasRun,
    ForceGainRun,
    InternalForceStudy,
    SignGainRun,
    internal_force_study_figure,
)
from coop_pin.results.metrics import axial_directions

ALPHA, RATE, K_F = "controller.gains.sign_gain", "clock.rate_hz", "controller.gains.force_gain"


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return three panels: over alpha at each rate, over 1 / (1 + K_f), and over time under a bias."""
    return internal_force_study_figure(study(results))


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return every number of the figure."""
    found = study(results)
    lines = [
        f"alpha {run.sign_gain:<5g} at {run.rate_hz:>6.0f} Hz: {run.force_rms_error:8.3f} N"
        for run in found.sign_gains
    ]
    slow = results["sign_gain"].values("position_rms_m").sel({RATE: 80.0})
    lines += [
        f"alpha {a:<5g} at     80 Hz: {x * 1e3:8.4f} mm rms off"
        for a, x in zip(slow[ALPHA].values, slow.values, strict=True)
    ]
    for gain in found.force_gains:
        product = gain.force_rms_error * (1.0 + gain.force_gain)
        lines.append(
            f"K_f {gain.force_gain:<5g}: {gain.force_rms_error:8.4f} N, times (1 + K_f): {product:.4f} N"
        )
    for bias in found.biased:
        end = f"{bias.internal_force[-1]:.2f} N along the line between the tips at {bias.time[-1]:g} s"
        lines.append(f"0.1 mm bias, alpha {bias.sign_gain:g}: {end}")
    return "\n".join(lines)


def study(results: Mapping[str, cp.SweepResult]) -> InternalForceStudy:
    """Return what the figure shows."""
    sign_gains = tuple(
        SignGainRun(point[ALPHA], point[RATE], error) for point, error in _force_errors(results["sign_gain"])
    )
    force_gains = tuple(
        ForceGainRun(point[K_F], error) for point, error in _force_errors(results["force_gain"])
    )
    biased = tuple(_biased(results["bias"], number) for number in range(len(results["bias"].plan)))
    return InternalForceStudy(sign_gains, force_gains, biased)


def _force_errors(result: cp.SweepResult) -> Iterator[tuple[dict[str, float], float]]:
    """Yield what was varied in each run, and the rms of its force error, axial and shear together, N."""
    for number in range(len(result.plan)):
        place = result.point(number)
        yield (
            place.parameters,
            math.hypot(place.metrics["internal_axial_rms_error_N"], place.metrics["internal_shear_rms_N"]),
        )


def _biased(result: cp.SweepResult, number: int) -> BiasRun:
    """Return the internal force on the first arm, along the line to the other tip, over time."""
    data = result.open(number).data
    force = np.nan_to_num(data.internal_wrench.values[:, 0, :3])
    axial = np.einsum("ni,ni->n", force, axial_directions(data)[:, 0])
    return BiasRun(result.plan[number].parameters[ALPHA], data.time.values, axial)
