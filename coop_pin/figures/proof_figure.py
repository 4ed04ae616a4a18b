"""Figure of the theorem monitor: where a law's convergence proof holds along a run, and where not."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from coop_pin.base.arrays import Array, typed
from coop_pin.figures import palette
from coop_pin.figures.style import label, run_figure
from coop_pin.results.run_result import RunResult

_AVERAGED = 1.0
"""Chattering quantities are averaged over this time, s."""


@typed
def theorem_figure(result: RunResult, monitor: xr.Dataset) -> Figure:
    """Return the terms of a law's convergence proof over time, with the marks where it breaks.

    Of law (23), above: sum_i Vdot_3, averaged over 1 s, red where it is positive; and ``|rho|`` of each arm
    beside ``lambda_min(K_d) |s_r|``, beyond which V may grow. Middle: what Theorem 3 concludes from, ``|sum_i
    u_i'|``, beside the largest ``|u_i'|``, which it says must vanish, averaged over 1 s; and the
    internal-force error. Below: in which part of a second's ticks sliding is not assured and signs differ
    between arms; and the condition of each arm's Jacobian.

    Of the payload-space law, above: how much the integrals disagree, with what anchor, integral and leak
    predict, and V with marks where it may grow. Below: what the shared integral has yet to take over, and the
    internal-force error.

    Args:
        result: the run.
        monitor: terms along it, by coop_pin.proof.theorem_monitor.
    """
    return _payload_space(result, monitor) if "disagreement" in monitor else _sliding_mode(result, monitor)


def _payload_space(result: RunResult, monitor: xr.Dataset) -> Figure:
    time, T = monitor["time"].values, result.scenario.clock.period
    with run_figure(2, 2, result, "terms of the convergence proof") as (figure, axes):
        (apart, falling), (taken, forces) = axes
        predicted = monitor["disagreement"].values[0] + T * np.cumsum(
            monitor["predicted_rate"].values, axis=0
        )
        for index, arm in enumerate(monitor["arm"].values):
            norm = np.linalg.norm(monitor["disagreement"].values[:, index, :], axis=1)
            apart.plot(time, norm, color=palette.series(index), label=f"|Z − c Z̄|, {arm}")
            prediction = np.linalg.norm(predicted[:-1, index], axis=1)
            apart.plot(
                time[1:], prediction, ":", color=palette.ACTUAL, label="predicted" if not index else None
            )
        label(apart, "disagreement of the integrals", "N, N m")
        V = monitor["V"].values
        falling.plot(time, V, color=palette.ACTUAL, label="V")
        grows = np.where(monitor["V_may_grow"].values, V, np.nan)
        falling.plot(time, grows, color=palette.INTERNAL, label="V may grow")
        label(falling, "V falls where the load is constant", "J")
        taken.plot(time, np.linalg.norm(monitor["Zbar"] - monitor["d"], axis=1), color=palette.ACTUAL)
        label(taken, "|Z̄ − d|: load that the integral has not taken over", "N, N m")
        for panel in (falling, taken):
            panel.set_yscale("log")
        _draw_force(forces, result, monitor)
        for panel in (apart, falling):
            panel.legend(loc="best", ncols=2, fontsize=7.0)
    return figure


def _sliding_mode(result: RunResult, monitor: xr.Dataset) -> Figure:
    time = monitor["time"].values
    ticks = max(round(_AVERAGED * result.scenario.clock.rate_hz), 1)
    with run_figure(3, 2, result, "terms of the convergence proof") as (figure, axes):
        (rates, bounds), (sums, forces), (marks, poses) = axes
        _draw_rate(rates, time, _averaged(monitor["V_rate_3_sum"].values, ticks))
        for index, arm in enumerate(monitor["arm"].values):
            for name, line, text in (("rho", "-", "|ρ|"), ("damping_force", ":", "λ_min |s_r|")):
                values = _averaged(monitor[name].values[:, index], ticks)
                bounds.plot(time, values, line, color=palette.series(index), label=f"{text}, {arm}")
        label(bounds, "V may grow where |ρ| > λ_min |s_r|", "N m")
        bounds.set_yscale("log")
        u = np.apply_along_axis(_averaged, 0, monitor["u_prime"].values, ticks)
        sums.plot(time, np.linalg.norm(u.sum(axis=1), axis=1), color=palette.ACTUAL, label="|Σ u′|")
        sums.plot(time, np.linalg.norm(u, axis=2).max(axis=1), color=palette.INTERNAL, label="max |u′|")
        label(sums, "Theorem 3: Σ u′ vanishes, u′ does not", "N, N m")
        sums.set_yscale("log")
        _draw_force(forces, result, monitor)
        sliding = monitor["sliding_is_not_assured"].values.any(axis=1)
        for marked, colour, text in (
            (sliding, palette.ACTUAL, "sliding not assured"),
            (monitor["signs_differ"].values, palette.INTERNAL, "signs of s_q differ"),
        ):
            marks.plot(time, _averaged(marked.astype(float), ticks), color=colour, label=text)
        label(marks, "part of the ticks that is marked", "")
        marks.set_ylim(-0.02, 1.35)
        for index, arm in enumerate(monitor["arm"].values):
            poses.plot(time, monitor["condition"].values[:, index], color=palette.series(index), label=arm)
        label(poses, "condition of J", "")
        for panel in (bounds, sums, marks, poses):
            panel.legend(loc="best", ncols=2, fontsize=7.0)
    return figure


def _draw_rate(panel: Axes, time: Array, rate: Array) -> None:
    panel.plot(time, rate, color=palette.ACTUAL)
    panel.fill_between(time, 0.0, rate, where=(rate > 0.0).tolist(), color=palette.INTERNAL, alpha=0.4)
    panel.axhline(0.0, color=palette.LIMIT, linewidth=0.6)
    panel.set_yscale("symlog", linthresh=max(1e-3 * float(np.abs(rate).max()), 1e-9))
    label(panel, "Σ dV₃/dt: the proof needs it ≤ 0", "W")


def _draw_force(panel: Axes, result: RunResult, monitor: xr.Dataset) -> None:
    error = [result.data[f"internal_{part}_error"].values[:, 0] for part in ("axial", "shear")]
    panel.plot(monitor["time"].values, np.hypot(*error), color=palette.INTERNAL)
    label(panel, f"internal-force error, arm {monitor['arm'].values[0]}", "N")


def _averaged(values: Array, ticks: int) -> Array:
    """Return the means over a number of ticks around each sample, of fewer at the ends."""
    window = np.ones(min(ticks, len(values)))
    return np.convolve(values, window, mode="same") / np.convolve(np.ones_like(values), window, mode="same")
