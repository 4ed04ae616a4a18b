"""Pose as configuration value: a translation and roll, pitch, yaw."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from coop_pin.base.arrays import Array, as_array, as_number, as_pose
from coop_pin.base.errors import ArgumentError, FieldError
from coop_pin.base.schema.base import Description, Vector3
from coop_pin.base.spatial import make_pose, rotation_from_rpy, rpy_from_rotation

POSE_MEANINGS = {
    "xyz": "x, y, z, m",
    "rpy": "roll, pitch, yaw about fixed axes, rad",
    "approach": "direction of the z axis, in place of rpy",
    "roll": "angle about it, rad",
}
"""Meanings of the fields of a pose, after the meaning of the pose itself."""
_SHORTEST, _ALONG = 1e-9, 1e-6
"""Length of an approach that is no direction; sine of an angle to the x axis that counts as zero."""


class Pose(Description):
    """Pose X_AB of a frame B in a frame A. A field of this type accepts a 4x4 matrix or a position of three.

    ``approach`` and ``roll`` may be given in place of rpy, and are stored as rpy: the direction of B's z axis
    in A (a tool's approach), and the angle about it, rad. At roll 0, B's x axis is as near to A's x axis as
    it can be; if approach is along A's x axis, B's x axis is A's y axis.

    Attributes:
        xyz: position of B's origin in A, m.
        rpy: roll, pitch, yaw of B about A's fixed axes, rad (the URDF convention); approach and roll in its
            place.
    """

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="before")
    @classmethod
    def _from_array(cls, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if isinstance(value, dict) and {"approach", "roll"} & {*value}:
            return _by_axis(value)
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

    def by_axis(self) -> dict[str, Any]:
        """Return xyz, approach and roll, of which the pose can be made; directions and angle to 1e-6."""
        R_AB = self.matrix[:3, :3]
        x, y, _ = _level(R_AB[:, 2]).T @ R_AB[:, 0]
        approach, roll = (np.round(part, 6) + 0.0 for part in (R_AB[:, 2], np.arctan2(y, x)))
        return {"xyz": list(self.xyz), "approach": approach.tolist(), "roll": float(roll)}

    @classmethod
    def from_matrix(cls, X_AB: ArrayLike) -> Self:
        """Return the value of a 4x4 pose matrix.

        Raises:
            ShapeError, OutOfRangeError: it is not a pose matrix.
        """
        X = as_pose("X_AB", X_AB)
        return cls(xyz=X[:3, 3], rpy=rpy_from_rotation(X[:3, :3]))


def _by_axis(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table with approach n and roll as one with rpy.

    R_AB = [x, n x x, n] Rz(roll), x along e - n n^T e, where e is the x axis of A, or y if n is along x.
    """
    others = {name: entry for name, entry in table.items() if name not in ("approach", "roll")}
    if "rpy" in others or "approach" not in table:
        raise FieldError("takes rpy alone, or approach with roll in its place; write the whole pose anew")
    try:
        n, roll = as_array("approach", table["approach"], 3), as_number("roll", table.get("roll", 0.0))
    except ArgumentError as error:
        raise FieldError(str(error)) from None
    if not (length := np.linalg.norm(n)) > _SHORTEST:
        raise FieldError(f"is {n.tolist()}; it must be a direction, longer than {_SHORTEST:g}", "approach")
    n /= length
    R_AB = _level(n) @ rotation_from_rpy((0.0, 0.0, roll))
    return others | {"rpy": rpy_from_rotation(R_AB)}


def _level(n: Array) -> Array:
    """Return the rotation with the z axis n and roll 0."""
    e = np.eye(3)[0 if np.linalg.norm(n[1:]) > _ALONG else 1]
    x = e - n * (n @ e)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(n, x), n))
