"""Scene graph as plain values: drawables on named nodes, keyframe tracks and a camera; and generated meshes.

A node is addressed by its path, "a/b/c", and moves with every node above it. Nothing in this file knows
meshcat: ``meshcat_commands`` translates a scene for the viewer page.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array
from coop_pin.model.shapes import Mesh, Shape

_TUBE_SIDES = 6


class Cone(NamedTuple):
    """Cone about z with its base at z = 0 and its tip at z = length.

    Attributes:
        radius: radius of the base, m.
        length: m.
    """

    radius: float
    length: float


class Segments(NamedTuple):
    """Thin line segments.

    Attributes:
        points: start and end of each segment in turn, m, shape (2 k, 3).
        colours: red, green and blue of each point, shape (2 k, 3).
    """

    points: Array
    colours: Array


Drawable: TypeAlias = Shape | Cone | Segments


class Paint(NamedTuple):
    """Colour and shading of a drawable.

    Attributes:
        colour: red, green and blue, from 0 to 1.
        opacity: from 0 to 1.
        lit: whether the drawable is shaded and casts a shadow.
        on_top: whether it is drawn over whatever would hide it.
    """

    colour: tuple[float, float, float]
    opacity: float = 1.0
    lit: bool = True
    on_top: bool = False


class Item(NamedTuple):
    """Drawable on a node.

    Attributes:
        path: path of the node.
        drawable: shape, cone or line segments.
        paint: colour and shading.
        pose: pose of the node in its parent node, shape (4, 4).
    """

    path: str
    drawable: Drawable
    paint: Paint
    pose: Array


class Track(NamedTuple):
    """Motion of a node in its parent node; a part that is None does not change.

    Attributes:
        path: path of the node.
        position: m, shape (n, 3).
        quaternion: x, y, z, w, shape (n, 4).
        scale: along x, y and z, shape (n, 3).
        held: whether a sample is held until the next one; otherwise the viewer interpolates between samples.
    """

    path: str
    position: Array | None = None
    quaternion: Array | None = None
    scale: Array | None = None
    held: bool = False


class Camera(NamedTuple):
    """Perspective camera; z is up.

    Attributes:
        eye: position of the camera, m, shape (3,).
        target: point in the middle of the view, m, shape (3,).
        field_of_view: vertical, degrees.
    """

    eye: Array
    target: Array
    field_of_view: float


class Scene(NamedTuple):
    """Everything that a viewer draws.

    Attributes:
        items: drawables on their nodes.
        time: time of the samples of the tracks, s, shape (n,).
        tracks: motion of the nodes.
        camera: initial camera.
    """

    items: tuple[Item, ...]
    time: Array
    tracks: tuple[Track, ...]
    camera: Camera


def translation(position: ArrayLike) -> Array:
    """Return the pose with a position, m, shape (3,), and no rotation, shape (4, 4)."""
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


def decimated(mesh: Mesh, max_vertices: int) -> Mesh:
    """Return a mesh with fewer vertices, merged on the finest regular grid that meets the limit.

    Replay pages hold the meshes of all links and must stay small.

    Args:
        mesh: any mesh.
        max_vertices: largest number of vertices to keep.
    """
    if len(mesh.vertices) <= max_vertices:
        return mesh
    low = mesh.vertices.min(axis=0)
    edge = float(np.max(mesh.vertices.max(axis=0) - low)) * (1.0 + 1e-9)
    cells = max_vertices
    while True:  # a surface fills about cells^2 of the cells^3 on a grid; coarsen it until the limit is met
        x, y, z = np.floor((mesh.vertices - low) / edge * cells).astype(np.int64).T
        _, merged, counts = np.unique((x * cells + y) * cells + z, return_inverse=True, return_counts=True)
        if len(counts) <= max_vertices:
            break
        cells = int(cells * min(0.9, np.sqrt(1.1 * max_vertices / len(counts))))
    sums = np.column_stack([np.bincount(merged, mesh.vertices[:, axis]) for axis in range(3)])
    faces = merged[mesh.faces]
    a, b, c = faces.T
    return Mesh(sums / counts[:, None], np.unique(faces[(a != b) & (b != c) & (c != a)], axis=0))


def tube(points: Array, radius: float, spacing: float) -> Mesh | None:
    """Return a tube along a path, or None for a path shorter than the spacing.

    Args:
        points: the path, m, shape (n, 3).
        radius: m.
        spacing: points closer than this to the last one kept are left out, m.
    """
    kept = [points[0]]
    for point in points[1:]:
        if np.linalg.norm(point - kept[-1]) >= spacing:
            kept.append(point)
    if len(kept) < 2:
        return None
    path = np.array(kept)
    forward = np.gradient(path, axis=0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    # Any fixed vector that is not parallel to the path spans its cross-sections.
    aside = np.eye(3)[np.argmin(np.abs(forward).max(axis=0))]
    across = np.cross(forward, aside)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    up = np.cross(across, forward)
    angles = 2.0 * np.pi * np.arange(_TUBE_SIDES) / _TUBE_SIDES
    around = np.cos(angles)[:, None] * across[:, None] + np.sin(angles)[:, None] * up[:, None]
    ring, side = np.meshgrid(np.arange(len(path) - 1), np.arange(_TUBE_SIDES), indexing="ij")
    here, beside = ring * _TUBE_SIDES + side, ring * _TUBE_SIDES + (side + 1) % _TUBE_SIDES
    quads = np.stack((here, beside, beside + _TUBE_SIDES, here + _TUBE_SIDES), axis=-1).reshape(-1, 4)
    vertices = (path[:, None] + radius * around).reshape(-1, 3)
    return Mesh(vertices, np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])))


def grid_points(half_edge: float, step: float) -> Array:
    """Return the line segments of a square grid about the origin in the plane z = 0, m, shape (2 k, 3)."""
    ticks = np.arange(-np.floor(half_edge / step), np.floor(half_edge / step) + 1) * step
    edge, flat = np.full_like(ticks, half_edge), np.zeros_like(ticks)
    lines = [np.stack((ticks, sign * edge, flat), axis=1) for sign in (-1.0, 1.0)]
    along_y = np.stack(lines, axis=1).reshape(-1, 3)
    return np.concatenate((along_y, along_y[:, [1, 0, 2]]))
