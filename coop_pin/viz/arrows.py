"""Arrows of forces and moments: shape, scales (N and N m per metre), and the arrows of wrenches over time.

An arrow is a shaft that is stretched and a head that keeps its shape, so its length is proportional to the
force or moment.
"""

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
"""Length of a whole head, whether it has one point or two."""

TYPICAL_LENGTH_M = 0.2
"""Approximate length of the arrow of a typical force."""

_SMALLEST_SCALE = 1e-6
"""Lower bound of node scales: the viewer inverts them."""

_GRAVITY = 9.81
_NEGLIGIBLE = 1e-6
"""N or N m; anything below is rounding error."""

_SHORTEST_LEVER_M = 0.05


class ArrowForm(NamedTuple):
    """Shape of an arrow.

    Attributes:
        shaft_radius: m.
        head_radius: m.
        points: number of points of the head, one behind the other.
    """

    shaft_radius: float
    head_radius: float
    points: int


FORCE_FORM = ArrowForm(0.007, 0.018, 1)
MOMENT_FORM = ArrowForm(0.0045, 0.015, 2)
"""Moments have two points, as is usual in mechanics; they lie along the axis, by the right-hand rule."""


class ArrowSeries(NamedTuple):
    """Arrow over time.

    Attributes:
        path: path of its node.
        colour: "#rrggbb".
        form: its shape.
        origin: its start, m, shape (n, 3).
        vector: from its start to its point, m, shape (n, 3).
    """

    path: str
    colour: str
    form: ArrowForm
    origin: Array
    vector: Array


def arrow_items(series: ArrowSeries) -> tuple[Item, ...]:
    """Return the drawables of an arrow along z: a shaft of unit length, and the points of its head."""
    paint, form = Paint(palette.rgb(series.colour), on_top=True), series.form
    shaft = Item(
        f"{series.path}/shaft/body", Cylinder(form.shaft_radius, 1.0), paint, translation((0.0, 0.0, 0.5))
    )
    cone = Cone(form.head_radius, HEAD_LENGTH_M / form.points)
    points = (
        Item(f"{series.path}/head/{name}", cone, paint, translation((0.0, 0.0, number * cone.length)))
        for number, name in enumerate(("body", "second")[: form.points])
    )
    return (shaft, *points)


def arrow_tracks(series: ArrowSeries) -> tuple[Track, ...]:
    """Return the tracks of an arrow that follows its vector.

    The head is the last 50 mm; an arrow shorter than that is a reduced head without a shaft. Samples are
    held, because wrenches are constant between control ticks.
    """
    length = np.linalg.norm(series.vector, axis=1)
    head = np.clip(length / HEAD_LENGTH_M, _SMALLEST_SCALE, 1.0)
    shaft = np.maximum(length - HEAD_LENGTH_M, _SMALLEST_SCALE)
    along = np.zeros((len(length), 3))
    along[:, 2] = np.maximum(length - HEAD_LENGTH_M, 0.0)
    return (
        Track(series.path, series.origin, quaternions_from_z(series.vector), held=True),
        Track(f"{series.path}/shaft", scale=np.column_stack((head, head, shaft)), held=True),
        Track(f"{series.path}/head", along, scale=np.column_stack((head, head, head)), held=True),
    )


def quaternions_from_z(vectors: Array) -> Array:
    """Return the smallest rotation from z to each vector, as quaternions x, y, z, w, shape (n, 4).

    For a unit vector u: ``(-u_y, u_x, 0, 1 + u_z)``, normalised; half a turn about x for
    u = -z. A zero vector gives the identity.
    """
    norm = np.linalg.norm(vectors, axis=1, keepdims=True)
    u = np.divide(vectors, norm, out=np.tile((0.0, 0.0, 1.0), (len(vectors), 1)), where=norm > 1e-12)
    quaternions = np.column_stack((-u[:, 1], u[:, 0], np.zeros(len(u)), 1.0 + u[:, 2]))
    quaternions[u[:, 2] < -1.0 + 1e-9] = 1.0, 0.0, 0.0, 0.0
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


class ArrowScales(NamedTuple):
    """Force and moment that an arrow of one metre stands for.

    Attributes:
        newtons_per_metre: N/m.
        newton_metres_per_metre: N m/m; None if there are no moments to draw.
    """

    newtons_per_metre: float
    newton_metres_per_metre: float | None


def recorded_scales(cell: Cell, data: xr.Dataset) -> ArrowScales:
    """Return the scales of a recorded run.

    The median internal force, or the median interaction force if there is none, is about 0.2 m long.

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

    The desired squeeze, or the payload's weight per arm if there is none, is about 0.2 m long.

    Args:
        cell: the cell.
        initial: initial snapshot; wrench rows that are not statically determinate are NaN.
    """
    squeeze = largest_force(initial.desired_internal_wrench)
    typical = squeeze if squeeze > _NEGLIGIBLE else cell.payload.mass * _GRAVITY / len(cell.arms)
    return _scales(cell, typical, has_moments=bool(np.isfinite(initial.interaction_wrench[:, 3:]).any()))


def largest_force(wrenches: Array) -> float:
    """Return the largest force of all arms, N; wrenches have shape (m, 6), and NaN counts as zero."""
    return float(np.linalg.norm(np.nan_to_num(wrenches)[:, :3], axis=1).max())


def _scales(cell: Cell, typical_force: float, *, has_moments: bool) -> ArrowScales:
    """Return both scales; a moment is at least as long as its force on the longest lever from P to a tip."""
    per_metre = _round_number(typical_force / TYPICAL_LENGTH_M, up=True)
    levers = (float(np.linalg.norm(grasp.matrix[:3, 3])) for grasp in cell.grasps.values())
    lever = max(_SHORTEST_LEVER_M, *levers)
    return ArrowScales(per_metre, _round_number(per_metre * lever, up=False) if has_moments else None)


def _round_number(value: float, *, up: bool) -> float:
    """Return a value rounded up or down to 1, 2 or 5 times a power of ten."""
    steps = np.array((0.5, 1.0, 2.0, 5.0, 10.0)) * 10.0 ** np.floor(np.log10(value))
    return float(steps[steps >= value * (1 - 1e-12)][0] if up else steps[steps <= value * (1 + 1e-12)][-1])


class Wrenches(NamedTuple):
    """Wrenches on arms and payload over time, about P in world axes; rows that are not determinate are NaN.

    Attributes:
        tips: end-effector positions, at which the wrenches on the arms are drawn, m, shape (n, m, 3).
        interaction: wrench on each arm by the payload, shape (n, m, 6).
        internal: its internal part, shape (n, m, 6).
        payload: position of P, m, shape (n, 3).
        external: external wrench on the payload, shape (n, 6).
    """

    tips: Array
    interaction: Array
    internal: Array
    payload: Array
    external: Array


def recorded_wrenches(data: xr.Dataset) -> Wrenches:
    """Return the wrenches of a recorded run."""
    names = ("tip_position", "interaction_wrench", "internal_wrench", "payload_position", "external_wrench")
    return Wrenches(*(data[name].values for name in names))


def snapshot_wrenches(snapshot: Snapshot) -> Wrenches:
    """Return the wrenches of a snapshot, as one sample."""
    parts = (
        snapshot.tip_position,
        snapshot.interaction_wrench,
        snapshot.internal_wrench,
        snapshot.payload_pose[:3, 3],
        snapshot.external_wrench,
    )
    return Wrenches(*(part[None] for part in parts))


def wrench_arrows(arms: Sequence[str], wrenches: Wrenches, scales: ArrowScales) -> tuple[ArrowSeries, ...]:
    """Return the arrows of wrenches; NaN counts as zero, and moments without a scale are left out.

    Args:
        arms: names of the arms.
        wrenches: wrenches on arms and payload.
        scales: scales of the arrows.
    """
    groups = (
        ("forces", slice(0, 3), FORCE_FORM, scales.newtons_per_metre),
        ("moments", slice(3, 6), MOMENT_FORM, scales.newton_metres_per_metre),
    )
    series: list[ArrowSeries] = []
    for group, rows, form, per_metre in groups:
        if per_metre is None:
            continue
        whole, internal, push = (
            np.nan_to_num(part)[..., rows] / per_metre
            for part in (wrenches.interaction, wrenches.internal, wrenches.external)
        )
        for index, arm in enumerate(arms):
            tip, inner = wrenches.tips[:, index], internal[:, index]
            load = whole[:, index] - inner
            series.append(ArrowSeries(f"{group}/{arm}/load", palette.LOAD, form, tip, load))
            series.append(ArrowSeries(f"{group}/{arm}/internal", palette.INTERNAL, form, tip, inner))
        series.append(ArrowSeries(f"{group}/external", palette.EXTERNAL, form, wrenches.payload, push))
    return tuple(series)
