"""Arrows: a shaft that stretches and a head that keeps its form, so that length is force, or moment, at every moment of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.figures import palette
from coop_pin.model.shapes import Cylinder
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
    shaft = Item(f"{series.path}/shaft/body", Cylinder(form.shaft_radius, 1.0), paint, translation((0.0, 0.0, 0.5)))
    cone, names = Cone(form.head_radius, HEAD_LENGTH_M / form.points), ("body", "second")[: form.points]
    tips = (
        Item(f"{series.path}/head/{name}", cone, paint, translation((0.0, 0.0, number * cone.length))) for number, name in enumerate(names)
    )
    return (shaft, *tips)


def arrow_tracks(series: ArrowSeries) -> tuple[Track, ...]:
    """Return how an arrow follows its vector.

    The head takes the last 50 mm; an arrow shorter than that is a small head alone. Wrenches hold from tick to tick, and so do arrows.
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
