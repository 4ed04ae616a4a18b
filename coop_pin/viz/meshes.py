"""Triangle meshes for pictures: thinner ones of robot links, tubes along paths, and the lines of a floor."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.model.shapes import Mesh

_TUBE_SIDES = 6
_CONE_SIDES = 24


def thinned(mesh: Mesh, most_vertices: int) -> Mesh:
    """Return the mesh with vertices merged on a grid, as fine as the number of vertices allows.

    A page with two arms must not weigh ten megabytes; links are seen from metres away.

    Args:
        mesh: any mesh.
        most_vertices: the largest number of vertices to keep.
    """
    if len(mesh.vertices) <= most_vertices:
        return mesh
    low = mesh.vertices.min(axis=0)
    edge = float(np.max(mesh.vertices.max(axis=0) - low)) * (1.0 + 1e-9)
    cells = most_vertices
    while True:  # a surface fills about cells^2 of the cells^3 on a grid, but nobody knows how many: coarsen until it fits
        x, y, z = np.floor((mesh.vertices - low) / edge * cells).astype(np.int64).T
        _, merged, counts = np.unique((x * cells + y) * cells + z, return_inverse=True, return_counts=True)
        if len(counts) <= most_vertices:
            break
        cells = int(cells * min(0.9, np.sqrt(1.1 * most_vertices / len(counts))))
    vertices = (
        np.column_stack([np.bincount(merged, mesh.vertices[:, axis]) for axis in range(3)]) / counts[:, None]
    )
    faces = merged[mesh.faces]
    a, b, c = faces.T
    return Mesh(vertices, np.unique(faces[(a != b) & (b != c) & (c != a)], axis=0))


def tube(points: Array, radius: float, spacing: float) -> Mesh | None:
    """Return a tube along a path; None where the path does not go anywhere.

    Args:
        points: the path, m, shape (n, 3).
        radius: m.
        spacing: points nearer than this to the last one kept are left out, m.
    """
    kept = _spaced(points, spacing)
    if len(kept) < 2:
        return None
    forward = np.gradient(kept, axis=0)
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    # Any fixed vector that is not along the path will do to span its cross-sections.
    aside = np.eye(3)[np.argmin(np.abs(forward).max(axis=0))]
    across = np.cross(forward, aside)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    up = np.cross(across, forward)
    angles = 2.0 * np.pi * np.arange(_TUBE_SIDES) / _TUBE_SIDES
    rings = kept[:, None] + radius * (
        np.cos(angles)[:, None] * across[:, None] + np.sin(angles)[:, None] * up[:, None]
    )
    ring, side = np.meshgrid(np.arange(len(kept) - 1), np.arange(_TUBE_SIDES), indexing="ij")
    here, beside = ring * _TUBE_SIDES + side, ring * _TUBE_SIDES + (side + 1) % _TUBE_SIDES
    quads = np.stack((here, beside, beside + _TUBE_SIDES, here + _TUBE_SIDES), axis=-1).reshape(-1, 4)
    return Mesh(rings.reshape(-1, 3), np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])))


def cone_mesh(radius: float, length: float) -> Mesh:
    """Return a cone about z with its base at z = 0 and its tip at z = length.

    Args:
        radius: of the base, m.
        length: m.
    """
    angles = 2.0 * np.pi * np.arange(_CONE_SIDES) / _CONE_SIDES
    base = np.column_stack((radius * np.cos(angles), radius * np.sin(angles), np.zeros(_CONE_SIDES)))
    here, beside = np.arange(_CONE_SIDES), np.roll(np.arange(_CONE_SIDES), -1)
    tip, centre = np.full(_CONE_SIDES, _CONE_SIDES), np.full(_CONE_SIDES, _CONE_SIDES + 1)
    faces = np.concatenate((np.column_stack((here, beside, tip)), np.column_stack((beside, here, centre))))
    return Mesh(np.vstack((base, (0.0, 0.0, length), (0.0, 0.0, 0.0))), faces)


def grid_points(half_edge: float, step: float) -> Array:
    """Return the segments of a square grid about the origin in the plane z = 0, m, shape (2 k, 3)."""
    ticks = np.arange(-np.floor(half_edge / step), np.floor(half_edge / step) + 1) * step
    edge = np.full_like(ticks, half_edge)
    flat = np.zeros_like(ticks)
    lines = [np.stack((ticks, sign * edge, flat), axis=1) for sign in (-1.0, 1.0)]
    along_y = np.stack(lines, axis=1).reshape(-1, 3)
    return np.concatenate((along_y, along_y[:, [1, 0, 2]]))


def _spaced(points: Array, spacing: float) -> Array:
    kept = [points[0]]
    for point in points[1:]:
        if np.linalg.norm(point - kept[-1]) >= spacing:
            kept.append(point)
    return np.array(kept)
