"""Where a search for joint angles ended."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array

CLOSED = 1e-9
"""A gap below this is closed, m and rad."""


class Landing(NamedTuple):
    """Where a search ended.

    Attributes:
        q: joint angles, shape (nq,).
        gap: where the grasp is, seen from the tip: [p, log R] of X_EE_d, m and rad, shape (6,).
    """

    q: Array
    gap: Array

    @property
    def distance(self) -> float:
        """Between tip and grasp, m."""
        return float(np.linalg.norm(self.gap[:3]))

    @property
    def angle(self) -> float:
        """Between tip and grasp, rad."""
        return float(np.linalg.norm(self.gap[3:]))

    @property
    def is_closed(self) -> bool:
        """Whether nothing is left."""
        return bool(np.abs(self.gap).max() < CLOSED)
