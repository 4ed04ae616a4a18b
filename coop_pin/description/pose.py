"""A pose as a user says it: a translation and roll, pitch, yaw."""

from __future__ import annotations

from typing import Self

from coop_pin.arrays import Array, as_array
from coop_pin.description.base import Description, Vector3
from coop_pin.spatial import make_pose, rpy_from_rotation


class Pose(Description):
    """Pose X_AB of a frame B in a frame A.

    Attributes:
        xyz: position of B's origin in A, m.
        rpy: roll, pitch, yaw of B about A's fixed axes, rad (the URDF convention).
    """

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Array:
        """X_AB, shape (4, 4)."""
        return make_pose(self.xyz, self.rpy)

    @classmethod
    def from_matrix(cls, X_AB: Array) -> Self:
        """Return the description of a 4x4 pose matrix."""
        X = as_array("X_AB", X_AB, 4, 4)
        return cls(xyz=X[:3, 3], rpy=rpy_from_rotation(X[:3, :3]))
