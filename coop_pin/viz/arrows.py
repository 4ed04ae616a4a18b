"""Scales of the arrows of forces and moments: N and N m per metre of length.

The page draws a force or moment over its scale as a length l: l up to ``LINEAR_M``; from there
``LINEAR_M (1 + LOGARITHMIC log(l / LINEAR_M))``, never more than ``LONGEST_M``. The number at the head is the
value. A strut of the virtual linkage is as thick as its tension is long, in proportion.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from coop_pin.description.cell.cell import Cell
from coop_pin.results.snapshot import Snapshot

TYPICAL_M = 0.15
"""Approximate length of the arrow of a typical force."""

LINEAR_M, LOGARITHMIC, LONGEST_M = 0.25, 0.4, 0.5

_GRAVITY = 9.81
_NEGLIGIBLE = 1e-6
"""N or N m; anything below is rounding error."""

_SHORTEST_LEVER_M = 0.05


class ArrowScales(NamedTuple):
    """Force and moment that an arrow of one metre stands for.

    Attributes:
        newtons_per_metre: N/m.
        newton_metres_per_metre: scale of moments, N m/m; None if there are no moments to draw.
    """

    newtons_per_metre: float
    newton_metres_per_metre: float | None


def recorded_scales(cell: Cell, data: xr.Dataset) -> ArrowScales:
    """Return the scales of a recorded run.

    The median internal force, or the median interaction force if there is none, is about 0.15 m long.

    Args:
        cell: the cell.
        data: dataset of the result.
    """
    medians = (
        float(np.median(np.linalg.norm(np.nan_to_num(data[name].values)[..., :3], axis=-1)))
        for name in ("internal_wrench", "interaction_wrench")
    )
    typical = next((force for force in medians if force > _NEGLIGIBLE), 1.0)
    moments = np.nan_to_num(data["interaction_wrench"].values)[..., 3:]
    return _scales(cell, typical, has_moments=bool(np.abs(moments).max(initial=0.0) > _NEGLIGIBLE))


def expected_scales(cell: Cell, initial: Snapshot) -> ArrowScales:
    """Return the scales of a run before it starts.

    The desired squeeze, or the payload's weight per arm if there is none, is about 0.15 m long.

    Args:
        cell: the cell.
        initial: initial snapshot; wrench rows that are not statically determinate are NaN.
    """
    squeeze = float(np.linalg.norm(np.nan_to_num(initial.desired_internal_wrench)[:, :3], axis=1).max())
    typical = squeeze if squeeze > _NEGLIGIBLE else cell.payload.mass * _GRAVITY / len(cell.arms)
    return _scales(cell, typical, has_moments=bool(np.isfinite(initial.interaction_wrench[:, 3:]).any()))


def _scales(cell: Cell, typical_force: float, *, has_moments: bool) -> ArrowScales:
    """Return both scales; a moment is at least as long as its force on the longest lever from P to a tip."""
    per_metre = _round_number(typical_force / TYPICAL_M, up=True)
    levers = (float(np.linalg.norm(grasp.matrix[:3, 3])) for grasp in cell.grasps.values())
    lever = max(_SHORTEST_LEVER_M, *levers)
    return ArrowScales(per_metre, _round_number(per_metre * lever, up=False) if has_moments else None)


def _round_number(value: float, *, up: bool) -> float:
    """Return a value rounded up or down to 1, 2 or 5 times a power of ten."""
    steps = np.array((0.5, 1.0, 2.0, 5.0, 10.0)) * 10.0 ** np.floor(np.log10(value))
    return float(steps[steps >= value * (1 - 1e-12)][0] if up else steps[steps <= value * (1 + 1e-12)][-1])
