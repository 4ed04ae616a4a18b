"""The arrows of a run: force and moment on each arm, each in its internal and its load-carrying part, and the push on the payload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.results import Moment
from coop_pin.viz.arrow_scales import ArrowScales
from coop_pin.viz.arrows import FORCE_FORM, MOMENT_FORM, ArrowForm, ArrowSeries


class Wrenches(NamedTuple):
    """What acts on arms and payload over time, about P in world axes; rows that rigid bodies do not determine are NaN.

    Attributes:
        tips: where the wrenches on the arms are drawn, m, shape (n, m, 3).
        interaction: on each arm by the payload, shape (n, m, 6).
        internal: the internal part of them, likewise.
        payload: position of P, m, shape (n, 3).
        external: on the payload, shape (n, 6).
    """

    tips: Array
    interaction: Array
    internal: Array
    payload: Array
    external: Array


def recorded_wrenches(data: xr.Dataset) -> Wrenches:
    """Return the wrenches of a result's samples."""
    names = ("tip_position", "interaction_wrench", "internal_wrench", "payload_position", "external_wrench")
    return Wrenches(*(data[name].values for name in names))


def wrenches_at(moment: Moment) -> Wrenches:
    """Return the wrenches of a run under way, as one sample."""
    parts = (moment.tip_position, moment.interaction_wrench, moment.internal_wrench, moment.payload_pose[:3, 3], moment.external_wrench)
    return Wrenches(*(part[None] for part in parts))


def wrench_arrows(arms: Sequence[str], wrenches: Wrenches, scales: ArrowScales) -> tuple[ArrowSeries, ...]:
    """Return the arrows; an undetermined row counts as zero. Moments are left out where they have no scale.

    Args:
        arms: their names.
        wrenches: what acts on them.
        scales: what an arrow's length means.
    """
    forces = _arrows("forces", arms, wrenches, slice(0, 3), FORCE_FORM, scales.newtons_per_metre)
    if scales.newton_metres_per_metre is None:
        return forces
    return (*forces, *_arrows("moments", arms, wrenches, slice(3, 6), MOMENT_FORM, scales.newton_metres_per_metre))


def _arrows(group: str, arms: Sequence[str], wrenches: Wrenches, rows: slice, form: ArrowForm, per_metre: float) -> tuple[ArrowSeries, ...]:
    """Return the arrows of the forces, or of the moments: rows of the wrenches, drawn at a scale in N/m, or N m/m."""
    whole, internal = (np.nan_to_num(part)[..., rows] / per_metre for part in (wrenches.interaction, wrenches.internal))
    series: list[ArrowSeries] = []
    for index, arm in enumerate(arms):
        tip, inner = wrenches.tips[:, index], internal[:, index]
        series.append(ArrowSeries(f"{group}/{arm}/load", palette.LOAD, form, tip, whole[:, index] - inner))
        series.append(ArrowSeries(f"{group}/{arm}/internal", palette.INTERNAL, form, tip, inner))
    push = wrenches.external[:, rows] / per_metre
    return (*series, ArrowSeries(f"{group}/external", palette.EXTERNAL, form, wrenches.payload, push))
