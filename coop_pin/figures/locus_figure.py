"""Figure of a root locus: eigenvalues of the sampled closed loop in the plane, and their radius."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from coop_pin.base.arrays import typed
from coop_pin.figures import palette
from coop_pin.figures.style import as_written, label, plain_figure, scale_to_field
from coop_pin.stability import RootLocus

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
        locus: Root locus, by coop_pin.stability.root_locus.
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
