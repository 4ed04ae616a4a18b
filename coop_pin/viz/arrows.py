"""Force arrows: a shaft that stretches and a head that keeps its form, so that length is force at every moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.model.shapes import Cylinder
from coop_pin.viz import palette
from coop_pin.viz.scene import Cone, Item, Paint, Track, translation

SHAFT_RADIUS_M = 0.007
HEAD_RADIUS_M = 0.018
HEAD_LENGTH_M = 0.05
_SMALLEST = 1e-6
"""Scales stay above this: a viewer must be able to invert them."""

TYPICAL_LENGTH_M = 0.2
"""About how long the arrow of a run's median internal force is."""


class ForceSeries(NamedTuple):
    """A force over time, and where it is drawn.

    Attributes:
        path: node of its arrow.
        colour: "#rrggbb".
        origin: where the arrow starts, m, shape (n, 3).
        force: N, in world axes, shape (n, 3).
    """

    path: str
    colour: str
    origin: Array
    force: Array


def force_series(data: xr.Dataset) -> tuple[ForceSeries, ...]:
    """Return the forces to draw: the internal part and the load part of the force on each arm, at its tip, and the push on the payload.

    Rows that rigid bodies do not determine are drawn as zero.
    """
    names = [str(arm) for arm in data["arm"].values]
    series = arm_forces(names, data["tip_position"].values, data["interaction_wrench"].values, data["internal_wrench"].values)
    push = data["external_wrench"].values
    return (*series, push_force(data["payload_position"].values, push)) if push[:, :3].any() else series


def arm_forces(arms: Sequence[str], tips: Array, interaction: Array, internal: Array) -> tuple[ForceSeries, ...]:
    """Return the internal part and the load part of the force on each arm, at its tip.

    Args:
        arms: their names.
        tips: m, shape (n, m, 3).
        interaction: wrenches on the arms, rows that rigid bodies do not determine are NaN, shape (n, m, 6).
        internal: the internal part of them, likewise.
    """
    whole, inner = np.nan_to_num(interaction)[..., :3], np.nan_to_num(internal)[..., :3]
    series: list[ForceSeries] = []
    for index, arm in enumerate(arms):
        series.append(ForceSeries(f"forces/{arm}/load", palette.LOAD, tips[:, index], whole[:, index] - inner[:, index]))
        series.append(ForceSeries(f"forces/{arm}/internal", palette.INTERNAL, tips[:, index], inner[:, index]))
    return tuple(series)


def push_force(payload: Array, external: Array) -> ForceSeries:
    """Return the push on the payload, at P.

    Args:
        payload: position of P, m, shape (n, 3).
        external: wrench on the payload, shape (n, 6).
    """
    return ForceSeries("forces/external", palette.EXTERNAL, payload, external[:, :3])


def newtons_per_metre(data: xr.Dataset) -> float:
    """Return a round scale at which the median internal force is about 0.2 m long; the median load where there is no internal force."""
    for name in ("internal_wrench", "interaction_wrench"):
        typical = float(np.median(np.linalg.norm(np.nan_to_num(data[name].values)[..., :3], axis=-1)))
        if typical > 1e-6:
            return round_scale(typical)
    return round_scale(1.0)


def round_scale(typical: float) -> float:
    """Return a round scale, N/m, at which a typical force (N) is up to 0.2 m long."""
    return _round_up(typical / TYPICAL_LENGTH_M)


def arrow_items(series: ForceSeries) -> tuple[Item, ...]:
    """Return the two parts of an arrow along z: a shaft of unit length and a head."""
    paint = Paint(palette.rgb(series.colour), on_top=True)
    return (
        Item(f"{series.path}/shaft/body", Cylinder(SHAFT_RADIUS_M, 1.0), paint, translation((0.0, 0.0, 0.5))),
        Item(f"{series.path}/head/body", Cone(HEAD_RADIUS_M, HEAD_LENGTH_M), paint, np.eye(4)),
    )


def arrow_tracks(series: ForceSeries, scale: float) -> tuple[Track, ...]:
    """Return how an arrow follows its force: length = |force| / scale, from the origin on, along the force.

    The head takes the last 50 mm; an arrow shorter than that is a small head alone. Wrenches hold from tick to tick, and so do arrows.

    Args:
        series: the force.
        scale: N/m.
    """
    length = np.linalg.norm(series.force, axis=1) / scale
    head = np.clip(length / HEAD_LENGTH_M, _SMALLEST, 1.0)
    shaft = np.maximum(length - HEAD_LENGTH_M, _SMALLEST)
    along = np.zeros((len(length), 3))
    along[:, 2] = np.maximum(length - HEAD_LENGTH_M, 0.0)
    return (
        Track(series.path, series.origin, quaternions_from_z(series.force), held=True),
        Track(f"{series.path}/shaft", scale=np.column_stack((head, head, shaft)), held=True),
        Track(f"{series.path}/head", along, scale=np.column_stack((head, head, head)), held=True),
    )


def quaternions_from_z(vectors: Array) -> Array:
    """Return the shortest turns that bring z onto each vector, as quaternions x, y, z, w, shape (n, 4); no turn for a zero vector.

    For a unit vector u: ``(-u_y, u_x, 0, 1 + u_z)``, normalised; half a turn about x for u = -z.
    """
    norm = np.linalg.norm(vectors, axis=1, keepdims=True)
    u = np.divide(vectors, norm, out=np.tile((0.0, 0.0, 1.0), (len(vectors), 1)), where=norm > 1e-12)
    quaternions = np.column_stack((-u[:, 1], u[:, 0], np.zeros(len(u)), 1.0 + u[:, 2]))
    quaternions[u[:, 2] < -1.0 + 1e-9] = 1.0, 0.0, 0.0, 0.0
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5, 10, ... times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-12)))
