"""The trail that a payload leaves in a live view."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.viz.cell_scene import TRAIL_SPACING_M

MOST_POINTS = 1500


class Trail:
    """Points along a path, a few millimetres apart; it starts again when time does, and forgets every other point when it grows long."""

    def __init__(self) -> None:
        self._time, self._points = -np.inf, np.zeros((0, 3))

    def follow(self, time: float, position: Array) -> None:
        """Go on to a position.

        Args:
            time: s.
            position: m, shape (3,).
        """
        if time < self._time:
            self._points = np.zeros((0, 3))
        self._time = time
        if len(self._points) == 0 or np.linalg.norm(position - self._points[-1]) >= TRAIL_SPACING_M:
            self._points = np.vstack((self._points, position))
        if len(self._points) > MOST_POINTS:
            self._points = self._points[::2]

    def segments(self) -> Array:
        """Return start and end of each segment, m, shape (k, 2, 3)."""
        return np.stack((self._points[:-1], self._points[1:]), axis=1)
