"""Arrows: a shaft that stretches and a head that keeps its form, so that length is force, or moment, at every moment of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.figures import palette
from coop_pin.model.shapes import Cylinder
from coop_pin.results import Snapshot
from coop_pin.viz.scene import Cone, Item, Paint, Track, translation

HEAD_LENGTH_M = 0.05
"""Of a whole head, however many points it has."""

_SMALLEST = 1e-6
"""Scales stay above this: a viewer must be able to invert them."""


class ArrowForm(NamedTuple):
    """What an arrow looks like.

    Attributes:
        shaft_radius: m.
        head_radius: m.
        points: of the head, one behind the other.
    """

    shaft_radius: float
    head_radius: float
    points: int


FORCE_FORM = ArrowForm(0.007, 0.018, 1)
MOMENT_FORM = ArrowForm(0.0045, 0.015, 2)
"""Two points, as moments are drawn in mechanics: the axis of the turn, by the right hand."""


class ArrowSeries(NamedTuple):
    """An arrow over time.

    Attributes:
        path: its node.
        colour: "#rrggbb".
        form: what it looks like.
        origin: where it starts, m, shape (n, 3).
        vector: from there to its point, m, shape (n, 3).
    """

    path: str
    colour: str
    form: ArrowForm
    origin: Array
    vector: Array


def arrow_items(series: ArrowSeries) -> tuple[Item, ...]:
    """Return the parts of an arrow along z: a shaft of unit length, and the points of its head."""
    paint, form = Paint(palette.rgb(series.colour), on_top=True), series.form
    shaft = Item(
        f"{series.path}/shaft/body", Cylinder(form.shaft_radius, 1.0), paint, translation((0.0, 0.0, 0.5))
    )
    cone, names = Cone(form.head_radius, HEAD_LENGTH_M / form.points), ("body", "second")[: form.points]
    tips = (
        Item(f"{series.path}/head/{name}", cone, paint, translation((0.0, 0.0, number * cone.length)))
        for number, name in enumerate(names)
    )
    return (shaft, *tips)


def arrow_tracks(series: ArrowSeries) -> tuple[Track, ...]:
    """Return how an arrow follows its vector.

    The head takes the last 50 mm; an arrow shorter than that is a small head alone. Wrenches hold from tick
    to tick, and so do arrows.
    """
    length = np.linalg.norm(series.vector, axis=1)
    head = np.clip(length / HEAD_LENGTH_M, _SMALLEST, 1.0)
    shaft = np.maximum(length - HEAD_LENGTH_M, _SMALLEST)
    along = np.zeros((len(length), 3))
    along[:, 2] = np.maximum(length - HEAD_LENGTH_M, 0.0)
    return (
        Track(series.path, series.origin, quaternions_from_z(series.vector), held=True),
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


def expected_scales(cell: Cell, first: Snapshot) -> ArrowScales:
    """Return the scales of a run that is yet to come: its desired squeeze is about 0.2 m long, or without one the weight on one arm.

    Args:
        cell: the description.
        first: where everything stands at the start; rows of wrenches that rigid bodies do not determine are
            NaN.
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
    lever = max(
        _SHORTEST_LEVER_M, *(float(np.linalg.norm(grasp.matrix[:3, 3])) for grasp in cell.grasps.values())
    )
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


def wrenches_at(moment: Snapshot) -> Wrenches:
    """Return the wrenches of a run under way, as one sample."""
    parts = (
        moment.tip_position,
        moment.interaction_wrench,
        moment.internal_wrench,
        moment.payload_pose[:3, 3],
        moment.external_wrench,
    )
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
    return (
        *forces,
        *_arrows("moments", arms, wrenches, slice(3, 6), MOMENT_FORM, scales.newton_metres_per_metre),
    )


def _arrows(
    group: str, arms: Sequence[str], wrenches: Wrenches, rows: slice, form: ArrowForm, per_metre: float
) -> tuple[ArrowSeries, ...]:
    """Return the arrows of the forces, or of the moments: rows of the wrenches, drawn at a scale in N/m, or N m/m."""
    whole, internal = (
        np.nan_to_num(part)[..., rows] / per_metre for part in (wrenches.interaction, wrenches.internal)
    )
    series: list[ArrowSeries] = []
    for index, arm in enumerate(arms):
        tip, inner = wrenches.tips[:, index], internal[:, index]
        series.append(ArrowSeries(f"{group}/{arm}/load", palette.LOAD, form, tip, whole[:, index] - inner))
        series.append(ArrowSeries(f"{group}/{arm}/internal", palette.INTERNAL, form, tip, inner))
    push = wrenches.external[:, rows] / per_metre
    return (*series, ArrowSeries(f"{group}/external", palette.EXTERNAL, form, wrenches.payload, push))
