"""Motions that the user gives point by point or as a function."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from coop_pin.description.user_code import FunctionName, load_function
from coop_pin.errors import AmbiguousTurnError, FieldShapeError, MotionError
from coop_pin.reference import FromFunction, PoseReference, Tabulated, Waypoints
from coop_pin.schema.base import Description
from coop_pin.schema.pose import Pose


class Waypoint(Pose):
    """A pose at a time.

    Attributes:
        time: s.
    """

    time: float


class WaypointsMotion(Description):
    """Smoothly through poses at their times, at rest before the first and after the last.

    Attributes:
        points: two or more, their times increasing.
    """

    kind: Literal["waypoints"] = "waypoints"
    points: tuple[Waypoint, ...]

    @model_validator(mode="after")
    def _one_path(self) -> Self:
        times = [point.time for point in self.points]
        if len(times) < 2:
            raise FieldShapeError(f"has {len(times)} entries; a path needs at least 2", "points")
        for index in range(1, len(times)):
            if times[index] <= times[index - 1]:
                detail = f"is {times[index]:g} after {times[index - 1]:g}; times must increase from point to point"
                raise MotionError(detail, f"points.{index}.time")
        try:
            self.build()
        except AmbiguousTurnError as error:
            raise MotionError(f"is ambiguous: {error}", f"points.{error.index}.rpy") from None
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        return Waypoints(np.array([point.time for point in self.points]), np.stack([point.matrix for point in self.points]))


class CsvMotion(Description):
    """Smoothly through the poses of a table, at rest before its first row and after its last.

    The file is read when the motion is built, so that a scenario can be read where the file is not.

    Attributes:
        path: a file of comma-separated values with a header: time, x, y, z and roll, pitch, yaw or qx, qy, qz, qw. In a scenario's
            file it is relative to that file.
    """

    kind: Literal["csv"] = "csv"
    path: str

    def build(self) -> PoseReference:
        """Return the reference.

        Raises:
            ReferenceFileError: the file is missing, or a line of it is wrong.
        """
        return Tabulated.from_csv(self.path)


class UserMotion(Description):
    """A function of time of the user's own.

    Attributes:
        target: "module:function", called as ``function(time, **options)`` -> X_WP_d, shape (4, 4). In Python the function itself will do.
        twist: likewise -> V_WP_d, world axes, linear first, shape (6,); by central differences when omitted.
        acceleration: likewise -> A_WP_d, shape (6,).
        options: keyword arguments for all of them.
    """

    kind: Literal["user"] = "user"
    target: FunctionName
    twist: FunctionName | None = None
    acceleration: FunctionName | None = None
    options: dict[str, Any] = Field(default_factory=dict)

    def build(self) -> PoseReference:
        """Return the reference.

        Raises:
            EntryNotFoundError: a module or function does not exist.
        """
        named = (self.target, self.twist, self.acceleration)
        pose, twist, acceleration = (None if name is None else load_function(name, self.options) for name in named)
        assert pose is not None
        return FromFunction(pose, twist, acceleration)
