"""Pose as configuration value: a translation and roll, pitch, yaw."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from coop_pin.arrays import Array, as_pose
from coop_pin.errors import ArgumentError, FieldError
from coop_pin.schema.base import Description, Vector3
from coop_pin.spatial import make_pose, rpy_from_rotation


class Pose(Description):
    """Pose X_AB of a frame B in a frame A. A field of this type accepts a 4x4 matrix or a position of three.

    Attributes:
        xyz: position of B's origin in A, m.
        rpy: roll, pitch, yaw of B about A's fixed axes, rad (the URDF convention).
    """

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="before")
    @classmethod
    def _from_array(cls, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, dict | Pose):
            return value
        if not isinstance(value, list | tuple):
            raise FieldError(
                f"is {value!r}; it must be a table of xyz and rpy, a position of 3 numbers,"
                " or a 4x4 pose matrix"
            )
        if len(value) == 3 and not any(isinstance(entry, list | tuple | np.ndarray) for entry in value):
            return {"xyz": value}
        try:
            X_AB = as_pose("the matrix", value)
        except ArgumentError as error:
            raise FieldError(
                "is neither a table of xyz and rpy, nor a position of 3 numbers, nor a 4x4 pose matrix:"
                f" {error}"
            ) from None
        return {"xyz": X_AB[:3, 3], "rpy": rpy_from_rotation(X_AB[:3, :3])}

    @property
    def matrix(self) -> Array:
        """X_AB, shape (4, 4)."""
        return make_pose(self.xyz, self.rpy)

    @classmethod
    def from_matrix(cls, X_AB: ArrayLike) -> Self:
        """Return the value of a 4x4 pose matrix.

        Raises:
            ShapeError, OutOfRangeError, NotAPoseError: it is not a pose matrix.
        """
        X = as_pose("X_AB", X_AB)
        return cls(xyz=X[:3, 3], rpy=rpy_from_rotation(X[:3, :3]))
