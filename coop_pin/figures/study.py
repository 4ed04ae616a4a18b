"""What the sign gain, the force gain and a kinematic bias do to the internal force: the honest part of the experiment."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled


class SignGainRun(NamedTuple):
    """A run at one sign gain and control rate.

    Attributes:
        sign_gain: alpha.
        rate_hz: control rate, Hz.
        force_rms_error: rms of the internal-force error, axial and shear together, N.
    """

    sign_gain: float
    rate_hz: float
    force_rms_error: float


class ForceGainRun(NamedTuple):
    """A run at one force gain.

    Attributes:
        force_gain: K_f.
        force_rms_error: rms of the internal-force error, axial and shear together, N.
    """

    force_gain: float
    force_rms_error: float


class BiasRun(NamedTuple):
    """A run with one arm's kinematics off by a bias.

    Attributes:
        sign_gain: alpha.
        time: s, shape (n,).
        internal_force: on the first arm along the line to the other tip, N, shape (n,).
    """

    sign_gain: float
    time: Array
    internal_force: Array


class InternalForceStudy(NamedTuple):
    """Everything that the study's figure shows.

    Attributes:
        sign_gains: runs over alpha at several rates.
        force_gains: runs over K_f.
        biased: runs with the bias.
        bias: how far the kinematics are off, m.
    """

    sign_gains: tuple[SignGainRun, ...]
    force_gains: tuple[ForceGainRun, ...]
    biased: tuple[BiasRun, ...]
    bias: float = 1e-4


def internal_force_study_figure(study: InternalForceStudy) -> Figure:
    """Return three panels: rms internal-force error over alpha at each rate, over 1 / (1 + K_f), and the internal force under a bias.

    Args:
        study: the runs.
    """
    with styled():
        figure = Figure(figsize=(10.8, 3.2), layout="constrained")
        over_alpha, over_force_gain, over_time = figure.subplots(1, 3)
        _draw_sign_gains(over_alpha, study.sign_gains)
        _draw_force_gains(over_force_gain, study.force_gains)
        _draw_biased(over_time, study)
    return figure


def _draw_sign_gains(panel: Axes, runs: tuple[SignGainRun, ...]) -> None:
    rates = sorted({run.rate_hz for run in runs})
    for rate, colour, marker in zip(rates, palette.SERIES, "osDv^*", strict=False):
        chosen = sorted(run for run in runs if run.rate_hz == rate)
        alpha, rms = [run.sign_gain for run in chosen], [run.force_rms_error for run in chosen]
        panel.semilogy(alpha, rms, color=colour, marker=marker, markersize=4.0, label=f"{rate:g} Hz")
    panel.set_xlabel("sign gain $\\alpha$")
    label(panel, "internal-force error over the sign gain", "rms, axial and shear (N)")
    panel.legend(title="control rate", loc="lower right")


def _draw_force_gains(panel: Axes, runs: tuple[ForceGainRun, ...]) -> None:
    chosen = sorted(runs)
    factor = np.array([1.0 / (1.0 + run.force_gain) for run in chosen])
    rms = np.array([run.force_rms_error for run in chosen])
    slope = float(factor @ rms / (factor @ factor))
    panel.plot(
        [0.0, 1.0], [0.0, slope], color=palette.DESIRED, linestyle="--", linewidth=0.9, label="proportional"
    )
    panel.plot(factor, rms, color=palette.ACTUAL, marker="o", markersize=4.0, linestyle="none", label="runs")
    for run, x in zip(chosen, factor, strict=True):
        panel.annotate(
            f"{run.force_gain:g}",
            (x, run.force_rms_error),
            xytext=(3, -9),
            textcoords="offset points",
            fontsize=7.0,
        )
    panel.set_xlim(0.0, 1.05)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("$1 / (1 + K_f)$; numbers at the points: $K_f$")
    label(panel, "internal-force error over the force gain", "rms, axial and shear (N)")
    panel.legend(loc="upper left")


def _draw_biased(panel: Axes, study: InternalForceStudy) -> None:
    for run, colour in zip(study.biased, palette.SERIES, strict=False):
        panel.plot(run.time, run.internal_force, color=colour, label=f"$\\alpha$ = {run.sign_gain:g}")
    panel.set_xlabel("time (s)")
    label(panel, f"one arm's kinematics off by {study.bias * 1e3:g} mm", "axial internal force (N)")
    panel.legend(loc="best")
