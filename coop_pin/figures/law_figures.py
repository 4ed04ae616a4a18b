"""Figures of a law: the root locus of its closed loop, and where its convergence proof holds along a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from coop_pin.base.arrays import Array, typed
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, plain_figure, run_figure, scale_to_field
from coop_pin.results.run_result import RunResult
from coop_pin.stability.closed_loop import RootLocus

_LARGEST = 1.6
"""Edge of the plane that is drawn."""
_LARGEST_RADIUS = 1.2
"""Largest radius that is drawn."""


@typed
def root_locus_figure(locus: RootLocus) -> Figure:
    """Return the eigenvalues of a root locus in the complex plane, and their radius over the factor.

    Left, colours go with the factor; a cross marks the own value of the scenario, if it is a factor. Right,
    the radius, with a colour for the mode that is slowest or grows fastest, and the bounds. Axes are cut.

    Args:
        locus: Root locus, by coop_pin.stability.closed_loop.
    """
    with plain_figure(7.6, 3.7, 1, 2, width_ratios=(1.0, 1.05)) as (figure, (plane, radius)):
        _draw_plane(figure, plane, locus)
        _draw_radius(radius, locus)
        figure.suptitle(as_written(locus.field), x=0.01, ha="left")
    return figure


def _draw_plane(figure: Figure, panel: Axes, locus: RootLocus) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 241)
    panel.plot(np.cos(angle), np.sin(angle), color=palette.LIMIT, linewidth=0.8)
    factors = np.concatenate(
        [np.full(len(loop.z), f) for f, loop in zip(locus.factors, locus.loops, strict=True)]
    )
    z = np.concatenate([loop.z for loop in locus.loops])
    order = np.argsort(factors)
    norm = LogNorm(factors.min(), factors.max() if np.ptp(factors) else 1.01 * factors.max())
    dots = panel.scatter(z.real[order], z.imag[order], s=9.0, c=factors[order], cmap="viridis", norm=norm)
    base = z[np.isclose(factors, 1.0)]
    panel.plot(base.real, base.imag, "x", color=palette.INTERNAL, markersize=5.0)
    edge = min(_LARGEST, 1.08 * max(1.0, float(np.abs(z).max())))
    panel.set(xlim=(-edge, edge), ylim=(-edge, edge), aspect="equal", xlabel="Re z")
    label(panel, "eigenvalues from tick to tick", "Im z")
    bar = figure.colorbar(dots, ax=panel, label="factor", shrink=0.8)
    ticks = np.unique(
        [
            factors.min(),
            *(f for f in (0.1, 1.0, 10.0, 100.0) if factors.min() < f < factors.max()),
            factors.max(),
        ]
    )
    bar.set_ticks(ticks.tolist(), labels=[f"{tick:.3g}" for tick in ticks])
    bar.ax.yaxis.set_ticks([], minor=True)


def _draw_radius(panel: Axes, locus: RootLocus) -> None:
    radii = np.array([loop.radius for loop in locus.loops])
    panel.plot(locus.factors, radii, color=palette.EVENT, linewidth=0.8)
    names = [loop.slowest.name for loop in locus.loops]
    for number, name in enumerate(dict.fromkeys(names)):
        mask = np.array([one == name for one in names])
        dots: dict[str, Any] = {"color": palette.series(number), "markersize": 4.0, "label": as_written(name)}
        panel.plot(locus.factors[mask], radii[mask], "o", **dots)
    panel.axhline(1.0, color=palette.LIMIT, linewidth=0.8)
    for bound in locus.bounds:
        panel.axvline(bound, color=palette.EVENT, linestyle=(0, (4, 2)), linewidth=1.0)
        panel.annotate(
            f"{bound:.3g}",
            (bound, 0.02),
            xycoords=("data", "axes fraction"),
            xytext=(-3.0, 0.0),
            textcoords="offset points",
            ha="right",
            color=palette.CAPTION,
        )
    scale_to_field(panel, "x", locus.factors)
    panel.set(
        xlabel="factor of the gain", ylim=(radii.min() - 0.02, min(radii.max() + 0.02, _LARGEST_RADIUS))
    )
    label(panel, "largest |z|, by the mode that has it", "|z|")
    panel.legend(loc="upper left", fontsize=7.0)


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
