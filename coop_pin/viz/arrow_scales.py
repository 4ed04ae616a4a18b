"""What the length of an arrow means: one round scale for the forces of a scene and one for its moments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.results import Moment

TYPICAL_LENGTH_M = 0.2
"""About how long the arrow of a typical force is."""

_GRAVITY = 9.81
_NOTHING = 1e-6
"""N or N m; less is rounding."""

_SHORTEST_LEVER_M = 0.05
_ROUNDING = 1e-12


class ArrowScales(NamedTuple):
    """What a metre of an arrow stands for.

    Attributes:
        newtons_per_metre: of forces, N/m.
        newton_metres_per_metre: of moments, N m/m; None where there is no moment to draw.
    """

    newtons_per_metre: float
    newton_metres_per_metre: float | None


def recorded_scales(cell: Cell, data: xr.Dataset) -> ArrowScales:
    """Return the scales of a recorded run: its median internal force is about 0.2 m long; the median load where there is none.

    Args:
        cell: the description.
        data: the result's.
    """
    moments = np.nan_to_num(data["interaction_wrench"].values)[..., 3:]
    return _scales(cell, _typical_recorded(data), bool(np.abs(moments).max(initial=0.0) > _NOTHING))


def expected_scales(cell: Cell, first: Moment) -> ArrowScales:
    """Return the scales of a run that is yet to come: its desired squeeze is about 0.2 m long, or without one the weight on one arm.

    Args:
        cell: the description.
        first: where everything stands at the start; rows of wrenches that rigid bodies do not determine are NaN.
    """
    squeeze = largest_force(first.desired_internal_wrench)
    typical = squeeze if squeeze > _NOTHING else cell.payload.mass * _GRAVITY / len(cell.arms)
    return _scales(cell, typical, bool(np.isfinite(first.interaction_wrench[:, 3:]).any()))


def largest_force(wrenches: Array) -> float:
    """Return the largest force of all arms, N, wrenches of shape (m, 6); rows that rigid bodies do not determine count as zero."""
    return float(np.linalg.norm(np.nan_to_num(wrenches)[:, :3], axis=1).max())


def _typical_recorded(data: xr.Dataset) -> float:
    for name in ("internal_wrench", "interaction_wrench"):
        typical = float(np.median(np.linalg.norm(np.nan_to_num(data[name].values)[..., :3], axis=-1)))
        if typical > _NOTHING:
            return typical
    return 1.0


def _scales(cell: Cell, typical_force: float, has_moments: bool) -> ArrowScales:
    """Return both scales: a moment is about as long as the force that makes it with the lever from P to a grasp, or longer."""
    per_metre = _round_up(typical_force / TYPICAL_LENGTH_M)
    lever = max(_SHORTEST_LEVER_M, *(float(np.linalg.norm(grasp.matrix[:3, 3])) for grasp in cell.grasps.values()))
    return ArrowScales(per_metre, _round_down(per_metre * lever) if has_moments else None)


def _round_up(value: float) -> float:
    """Return the next greater of 1, 2, 5, 10, ... times a power of ten."""
    return next(step for step in _round_numbers(value) if step >= value * (1 - _ROUNDING))


def _round_down(value: float) -> float:
    """Return the next smaller of 1, 2, 5, 10, ... times a power of ten."""
    return next(step for step in reversed(_round_numbers(value)) if step <= value * (1 + _ROUNDING))


def _round_numbers(value: float) -> list[float]:
    """Return the round numbers about a value, in order."""
    power = 10.0 ** np.floor(np.log10(value))
    return [float(step * power) for step in (0.5, 1.0, 2.0, 5.0, 10.0)]
