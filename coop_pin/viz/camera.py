"""Where to look at a cell from."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.description.cell import Cell
from coop_pin.viz.scene import Camera

_FIELD_OF_VIEW_DEG = 32.0
_AZIMUTH_DEG = 12.0
_ELEVATION_DEG = {"planar": 42.0, "full": 24.0}
_MARGIN = 1.05


def camera_on(cell: Cell, points: Array, floor: float) -> Camera:
    """Return a camera that has the whole cell in view, the first arm on the left and the last on the right.

    Planar cells are seen from higher up: what they do is in the plane.

    Args:
        cell: the description.
        points: what must be in view, m, shape (n, 3); the arms' bases are added.
        floor: height of the floor, m.
    """
    bases = np.array([arm.base.xyz for arm in cell.arms.values()])
    feet = bases * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
    seen = np.concatenate((points, bases, feet))
    low, high = seen.min(axis=0), seen.max(axis=0)
    target, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    distance = _MARGIN * max(radius, 0.3) / np.sin(np.radians(_FIELD_OF_VIEW_DEG / 2.0))
    return Camera(target + distance * _direction(bases, cell.rows), target, _FIELD_OF_VIEW_DEG)


def _direction(bases: Array, rows: str) -> Array:
    """Return the unit vector from the target to the camera."""
    across = bases[-1, :2] - bases[0, :2]
    if np.linalg.norm(across) < 1e-6:
        across = np.array((1.0, 0.0))
    heading = np.arctan2(across[1], across[0]) - np.pi / 2.0 - np.radians(_AZIMUTH_DEG)
    elevation = np.radians(_ELEVATION_DEG[rows])
    return np.array((np.cos(heading) * np.cos(elevation), np.sin(heading) * np.cos(elevation), np.sin(elevation)))
