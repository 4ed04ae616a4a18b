"""What the payload is asked to do: standing still, going straight, decaying exponentials; and the choice among all motions."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from coop_pin.description.motion_about_axis import CircleMotion, SwingMotion, TurnMotion
from coop_pin.description.motion_given import CsvMotion, UserMotion, Waypoint, WaypointsMotion
from coop_pin.errors import AmbiguousTurnError, FieldShapeError, MotionError
from coop_pin.reference import Exponentials, Hold, Line, PoseReference
from coop_pin.schema.base import Description, Positive, Vector3
from coop_pin.schema.pose import Pose

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
            raise FieldShapeError(f"has {len(self.time_constants)} entries for {len(self.amplitudes)} amplitudes", "time_constants")
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        amplitudes = np.reshape(np.array(self.amplitudes, dtype=float), (-1, 3))
        return Exponentials(np.array(self.constant), amplitudes, np.array(self.time_constants), np.array(self.rpy))


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
            raise MotionError(f"is ambiguous: {error}", "goal.rpy") from None
        return self

    def build(self) -> PoseReference:
        """Return the reference."""
        return Line(self.start.matrix, self.goal.matrix, self.duration, self.start_time)


Motion = Annotated[
    HoldMotion | ExponentialMotion | LineMotion | CircleMotion | TurnMotion | SwingMotion | WaypointsMotion | CsvMotion | UserMotion,
    Field(discriminator="kind"),
]
