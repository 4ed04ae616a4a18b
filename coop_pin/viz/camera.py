"""Where to look at a cell from."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.viz.scene import Camera

_FIELD_OF_VIEW_DEG = 32.0
_AZIMUTH_DEG = 22.0
_ELEVATION_DEG = 24.0
_PLANAR_ELEVATION_DEG = 42.0
_MARGIN = 1.15


def camera_on(cell: Cell, points: Array, tips: Array, floor: float) -> Camera:
    """Return a camera that has the whole cell in view, the first arm on the left and the last on the right.

    It stands a little aside, where it sees the line between the tips more from its side. Planar cells are seen from higher up.

    Args:
        cell: the description.
        points: what must be in view, m, shape (n, 3); the arms' bases are added.
        tips: where the tips are, m, shape (n, m, 3).
        floor: height of the floor, m.
    """
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    feet = bases * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
    seen = np.concatenate((points, bases, feet))
    low, high = seen.min(axis=0), seen.max(axis=0)
    target, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    distance = _MARGIN * max(radius, 0.3) / np.sin(np.radians(_FIELD_OF_VIEW_DEG / 2.0))
    elevation = _PLANAR_ELEVATION_DEG if cell.rows == "planar" else _ELEVATION_DEG
    return Camera(target + distance * _direction(bases, (tips[:, -1] - tips[:, 0]).mean(axis=0), elevation), target, _FIELD_OF_VIEW_DEG)


def _direction(bases: Array, line: Array, elevation_deg: float) -> Array:
    """Return the unit vector from the target to the camera; line is that between the tips."""
    across = bases[-1, :2] - bases[0, :2]
    if np.linalg.norm(across) < 1e-6:
        across = np.array((1.0, 0.0))
    front = np.arctan2(across[1], across[0]) - np.pi / 2.0
    sides = (front + np.radians(_AZIMUTH_DEG), front - np.radians(_AZIMUTH_DEG))
    heading = max(sides, key=lambda side: abs(line[0] * np.sin(side) - line[1] * np.cos(side)))
    elevation = np.radians(elevation_deg)
    return np.array((np.cos(heading) * np.cos(elevation), np.sin(heading) * np.cos(elevation), np.sin(elevation)))
