"""Internal force under law (23): effect of the sign gain alpha, the force gain K_f and a kinematic bias."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import coop_pin as cp
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

ALPHA, RATE, K_F = "controller.gains.sign_gain", "clock.rate_hz", "controller.gains.force_gain"
BIAS = "cell.arms.left.calibration_error.tip.xyz"


def force_error(result: cp.SweepResult) -> xr.DataArray:
    """Return the rms of the internal-force error of each run, axial and shear together, N."""
    axial, shear = (result.values(f"settled_{part}_N") for part in ("axial_rms_error", "shear_rms"))
    return xr.apply_ufunc(np.hypot, axial, shear)


def biased_runs(result: cp.SweepResult) -> Iterator[tuple[float, xr.DataArray]]:
    """Yield alpha and the axial internal force on the first arm over time, N, of each run with the bias."""
    for number in range(len(result.plan)):
        yield result.plan[number].parameters[ALPHA], result.open(number).data["internal_axial"][:, 0]


def bias_mm(result: cp.SweepResult) -> float:
    """Return the distance by which one arm's kinematics are off, mm."""
    bias: Any = result.plan.changes[BIAS]
    return 1e3 * float(np.linalg.norm(bias))


def figure(results: Mapping[str, cp.SweepResult]) -> Figure:
    """Return three panels: over alpha at each rate, over 1 / (1 + K_f), and over time under a bias."""
    with styled():
        drawn = Figure(figsize=(10.8, 3.2), layout="constrained")
        over_alpha, over_force_gain, over_time = drawn.subplots(1, 3)
        _draw_sign_gains(over_alpha, force_error(results["sign_gain"]))
        _draw_force_gains(over_force_gain, force_error(results["force_gain"]))
        for (alpha, force), colour in zip(biased_runs(results["bias"]), palette.SERIES, strict=False):
            over_time.plot(force["time"], force, color=colour, label=f"$\\alpha$ = {alpha:g}")
        over_time.set_xlabel("time (s)")
        title = f"one arm's kinematics off by {bias_mm(results['bias']):g} mm"
        label(over_time, title, "axial internal force (N)")
        over_time.legend(loc="best")
    return drawn


def _draw_sign_gains(panel: Axes, error: xr.DataArray) -> None:
    for rate, colour, marker in zip(np.sort(error[RATE]), palette.SERIES, "osDv^*", strict=False):
        line = error.sel({RATE: rate}).sortby(ALPHA)
        panel.semilogy(line[ALPHA], line, color=colour, marker=marker, markersize=4.0, label=f"{rate:g} Hz")
    panel.set_xlabel("sign gain $\\alpha$")
    label(panel, "internal-force error over the sign gain", "rms, axial and shear (N)")
    panel.legend(title="control rate", loc="lower right")


def _draw_force_gains(panel: Axes, error: xr.DataArray) -> None:
    gains, rms = error[K_F].values, error.values
    factor = 1.0 / (1.0 + gains)
    slope = float(factor @ rms / (factor @ factor))
    dashed: Any = {"color": palette.DESIRED, "linestyle": "--", "linewidth": 0.9}
    panel.plot([0.0, 1.0], [0.0, slope], label="proportional", **dashed)
    panel.plot(factor, rms, color=palette.ACTUAL, marker="o", markersize=4.0, linestyle="none", label="runs")
    for gain, *point in zip(gains, factor, rms, strict=True):
        panel.annotate(f"{gain:g}", point, xytext=(3, -9), textcoords="offset points", fontsize=7.0)
    panel.set_xlim(0.0, 1.05)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("$1 / (1 + K_f)$; numbers at the points: $K_f$")
    label(panel, "internal-force error over the force gain", "rms, axial and shear (N)")
    panel.legend(loc="upper left")


def numbers(results: Mapping[str, cp.SweepResult]) -> str:
    """Return every number of the figure, and the position errors at 80 Hz."""
    error = force_error(results["sign_gain"])
    lines = [
        f"alpha {alpha:<5g} at {rate:>6.0f} Hz: {error.sel({ALPHA: alpha, RATE: rate}).item():8.3f} N"
        for alpha in error[ALPHA].values
        for rate in error[RATE].values
    ]
    slow = results["sign_gain"].values("settled_position_rms_m").sel({RATE: 80.0})
    for alpha, rms in zip(slow[ALPHA].values, slow.values, strict=True):
        lines.append(f"alpha {alpha:<5g} at     80 Hz: position error {rms * 1e3:8.4f} mm rms")
    error = force_error(results["force_gain"])
    for gain, rms in zip(error[K_F].values, error.values, strict=True):
        lines.append(f"K_f {gain:<5g}: {rms:8.4f} N, times (1 + K_f): {rms * (1.0 + gain):.4f} N")
    for alpha, force in biased_runs(results["bias"]):
        end = f"axial internal force {force.values[-1]:.2f} N at {force['time'].values[-1]:g} s"
        lines.append(f"{bias_mm(results['bias']):g} mm bias, alpha {alpha:g}: {end}")
    return "\n".join(lines)
