"""What the payload is asked to do: standing still, going straight, decaying exponentials; and the choice among all motions."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from coop_pin.description.user_code import FunctionName, load_function
from coop_pin.errors import AmbiguousTurnError, FieldError
from coop_pin.reference import (
    Circle,
    Exponentials,
    FromFunction,
    Hold,
    Line,
    PoseReference,
    Swing,
    Tabulated,
    Turn,
    Waypoints,
)
from coop_pin.schema.base import Description, Positive, Vector3
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
            raise FieldError(f"has {len(times)} entries; a path needs at least 2", "points")
        for index in range(1, len(times)):
            if times[index] <= times[index - 1]:
                detail = (
                    f"is {times[index]:g} after {times[index - 1]:g}; times must increase from point to point"
                )
                raise FieldError(detail, f"points.{index}.time")
        try:
            self.build()
        except AmbiguousTurnError as error:
            raise FieldError(f"is ambiguous: {error}", f"points.{error.index}.rpy") from None
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        return Waypoints(
            np.array([point.time for point in self.points]), np.stack([point.matrix for point in self.points])
        )


class CsvMotion(Description):
    """Smoothly through the poses of a table, at rest before its first row and after its last.

    The file is read when the motion is built, so that a scenario can be read where the file is not.

    Attributes:
        path: a file of comma-separated values with a header: time, x, y, z and roll, pitch, yaw or qx, qy,
            qz, qw. In a scenario's file it is relative to that file.
    """

    kind: Literal["csv"] = "csv"
    path: str

    def build(self) -> PoseReference:
        """Return the reference.

        Raises:
            FileReadError: the file is missing, or a line of it is wrong.
        """
        return Tabulated.from_csv(self.path)


class UserMotion(Description):
    """A function of time of the user's own.

    Attributes:
        target: "module:function", called as ``function(time, **options)`` -> X_WP_d, shape (4, 4). In Python
            the function itself will do.
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
            NameNotFoundError: a module or function does not exist.
        """
        named = (self.target, self.twist, self.acceleration)
        pose, twist, acceleration = (
            None if name is None else load_function(name, self.options) for name in named
        )
        assert pose is not None
        return FromFunction(pose, twist, acceleration)


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if np.linalg.norm(vector) < 1e-9:
        raise FieldError(f"is {list(vector)}; it must have a length, and with it a direction")
    return vector


Direction = Annotated[Vector3, AfterValidator(_not_zero)]


class CircleMotion(Description):
    """Round and round a circle with a fixed orientation, from rest.

    The circle passes through the pose; its centre lies at pose.xyz - radius (cos(phi_0) e_1 + sin(phi_0) e_2)
    with e_1 the world's x axis seen in the plane of the circle (y, where the normal is x) and e_2 = normal x
    e_1.

    Attributes:
        pose: X_WP_d at the start.
        radius: m.
        angular_rate: after the ramp, rad/s; positive is counter-clockwise seen against the normal.
        ramp: time from rest to the full rate, s.
        normal: of the plane, world axes, any length.
        start_angle: phi_0, where on the circle the motion starts, rad.
        start_time: s.
    """

    kind: Literal["circle"] = "circle"
    pose: Pose
    radius: Positive
    angular_rate: float
    ramp: Positive = 1.0
    normal: Direction = (0.0, 0.0, 1.0)
    start_angle: float = 0.0
    start_time: float = 0.0

    def build(self) -> PoseReference:
        """Return the reference."""
        around_origin = Circle(
            centre=np.zeros(3),
            radius=self.radius,
            angular_rate=self.angular_rate,
            ramp=self.ramp,
            normal=np.array(self.normal),
            start_angle=self.start_angle,
            start_time=self.start_time,
            rpy=np.array(self.pose.rpy),
        )
        return replace(
            around_origin, centre=np.array(self.pose.xyz) - around_origin.at(self.start_time).X_WP_d[:3, 3]
        )


class TurnMotion(Description):
    """Turn about an axis through the payload's centre of mass, from rest to rest.

    Attributes:
        pose: X_WP_d before.
        axis: world axes, any length.
        angle: rad; may be more than a whole turn.
        duration: of the turn, s.
        start_time: s.
    """

    kind: Literal["turn"] = "turn"
    pose: Pose
    axis: Direction
    angle: float
    duration: Positive
    start_time: float = 0.0

    def build(self) -> PoseReference:
        """Return the reference."""
        return Turn(self.pose.matrix, np.array(self.axis), self.angle, self.duration, self.start_time)


class SwingMotion(Description):
    """Swing to and fro about an axis through the payload's centre of mass, from rest.

    Attributes:
        pose: X_WP_d before.
        axis: world axes, any length.
        amplitude: rad.
        period: s.
        ramp: time until the full amplitude, s.
        start_time: s.
    """

    kind: Literal["swing"] = "swing"
    pose: Pose
    axis: Direction
    amplitude: float
    period: Positive
    ramp: Positive = 1.0
    start_time: float = 0.0

    def build(self) -> PoseReference:
        """Return the reference."""
        return Swing(
            self.pose.matrix, np.array(self.axis), self.amplitude, self.period, self.ramp, self.start_time
        )


__all__ = [
    "CircleMotion",
    "CsvMotion",
    "ExponentialMotion",
    "HoldMotion",
    "LineMotion",
    "Motion",
    "SwingMotion",
    "TurnMotion",
    "UserMotion",
    "Waypoint",
    "WaypointsMotion",
]


class HoldMotion(Description):
    """Stay at a pose.

    Attributes:
        pose: desired payload pose X_WP_d.
    """

    kind: Literal["hold"] = "hold"
    pose: Pose

    def build(self) -> PoseReference:
        """Return the reference."""
        return Hold(self.pose.matrix)


class ExponentialMotion(Description):
    """p_d(t) = constant + sum_k amplitudes_k exp(-t / time_constants_k), at a fixed orientation.

    Attributes:
        constant: m.
        amplitudes: one vector for each term, m.
        time_constants: s.
        rpy: orientation, rad.
    """

    kind: Literal["exponentials"] = "exponentials"
    constant: Vector3
    amplitudes: tuple[Vector3, ...]
    time_constants: tuple[Positive, ...]
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_constant_each(self) -> Self:
        if len(self.amplitudes) != len(self.time_constants):
            raise FieldError(
                f"has {len(self.time_constants)} entries for {len(self.amplitudes)} amplitudes",
                "time_constants",
            )
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        amplitudes = np.reshape(np.array(self.amplitudes, dtype=float), (-1, 3))
        return Exponentials(
            np.array(self.constant), amplitudes, np.array(self.time_constants), np.array(self.rpy)
        )


class LineMotion(Description):
    """From one pose to another along a straight line and the shorter turn, from rest to rest.

    Attributes:
        start: desired payload pose X_WP_d before.
        goal: desired payload pose X_WP_d afterwards; its orientation is less than half a turn away.
        duration: of the motion, s; the payload stays at the goal afterwards.
        start_time: when it begins, s.
    """

    kind: Literal["line"] = "line"
    start: Pose
    goal: Pose
    duration: Positive
    start_time: float = 0.0

    @model_validator(mode="after")
    def _one_way_round(self) -> Self:
        try:
            self.build()
        except AmbiguousTurnError as error:
            raise FieldError(f"is ambiguous: {error}", "goal.rpy") from None
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        return Line(self.start.matrix, self.goal.matrix, self.duration, self.start_time)


Motion = Annotated[
    HoldMotion
    | ExponentialMotion
    | LineMotion
    | CircleMotion
    | TurnMotion
    | SwingMotion
    | WaypointsMotion
    | CsvMotion
    | UserMotion,
    Field(discriminator="kind"),
]
