"""A scene to show, as values that any viewer can draw: items that stand still on nodes, and tracks that move the nodes."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array
from coop_pin.model.shapes import Shape


class Cone(NamedTuple):
    """A cone about z with its base at z = 0 and its tip at z = length.

    Attributes:
        radius: of the base, m.
        length: m.
    """

    radius: float
    length: float


class Segments(NamedTuple):
    """Thin line segments.

    Attributes:
        points: start and end of each segment in turn, m, shape (2 k, 3).
        colours: red, green, blue of each point, shape (2 k, 3).
    """

    points: Array
    colours: Array


Drawable: TypeAlias = Shape | Cone | Segments


class Paint(NamedTuple):
    """How a shape is coloured.

    Attributes:
        colour: red, green, blue, from 0 to 1.
        opacity: from 0 to 1.
        lit: whether light and shadow fall on it.
        on_top: whether it shows through what stands before it.
    """

    colour: tuple[float, float, float]
    opacity: float = 1.0
    lit: bool = True
    on_top: bool = False


class Item(NamedTuple):
    """Something to draw.

    Attributes:
        path: its node, "a/b/c"; it moves with all nodes above it.
        drawable: what it is.
        paint: how it is coloured.
        pose: in the node above, shape (4, 4).
    """

    path: str
    drawable: Drawable
    paint: Paint
    pose: Array


class Track(NamedTuple):
    """How a node moves in the node above it; what is None stays.

    Attributes:
        path: the node.
        position: m, shape (n, 3).
        quaternion: x, y, z, w, shape (n, 4).
        scale: along x, y, z, shape (n, 3).
        held: whether a sample holds until the next one; otherwise the node moves evenly in between.
    """

    path: str
    position: Array | None = None
    quaternion: Array | None = None
    scale: Array | None = None
    held: bool = False


class Camera(NamedTuple):
    """Where to look from; z is up.

    Attributes:
        eye: where the camera stands, m, shape (3,).
        target: what it looks at, m, shape (3,).
        field_of_view: vertical, degrees.
    """

    eye: Array
    target: Array
    field_of_view: float


class Scene(NamedTuple):
    """What to show.

    Attributes:
        items: everything to draw.
        time: of the samples of the tracks, s, shape (n,).
        tracks: what moves.
        camera: where to look from.
    """

    items: tuple[Item, ...]
    time: Array
    tracks: tuple[Track, ...]
    camera: Camera


def translation(position: ArrayLike) -> Array:
    """Return the pose of a node that is displaced (m, shape (3,)) and not turned, shape (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose
