"""Scales of axes: logarithmic where the numbers ask for it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from coop_pin.arrays import Array

_LARGE_RATIO = 30.0
"""Ratio of largest to smallest from which a scale is logarithmic."""
_FEW_PLACES = 8
"""Up to so many places a logarithmic field shows each of them."""


def scale_to_values(panel: Axes, axis: str, values: Array) -> None:
    """Make an axis logarithmic where the values of a metric reach over large ratios.

    Args:
        panel: the axes.
        axis: "x" or "y".
        values: shape (n,), or any; what is not finite is left out.
    """
    if is_wide(values):
        (panel.set_xscale if axis == "x" else panel.set_yscale)("log")


def scale_to_places(panel: Axes, axis: str, places: Array) -> None:
    """Make an axis logarithmic where the places of a field are spaced in ratios, and show each of a few.

    Args:
        panel: the axes.
        axis: "x" or "y".
        places: shape (n,).
    """
    if not is_in_ratios(places):
        return
    (panel.set_xscale if axis == "x" else panel.set_yscale)("log")
    if len(set(places.tolist())) <= _FEW_PLACES:
        side = panel.xaxis if axis == "x" else panel.yaxis
        side.set_ticks(places.tolist(), [f"{place:g}" for place in places])
        side.set_ticks([], minor=True)


def is_wide(values: Array) -> bool:
    """Say whether positive values reach over large ratios; what is not finite is left out."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0.0 and finite.max() > _LARGE_RATIO * finite.min())


def is_in_ratios(values: Array) -> bool:
    """Say whether numbers are spaced more evenly in ratio than in difference."""
    places = np.unique(values).astype(float)
    if places.size < 3 or places[0] <= 0.0:
        return False
    steps, ratios = np.diff(places), np.diff(np.log(places))
    return bool(np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean() - 1e-9)
