"""Motions about an axis: round a circle, and turning about an axis through the payload."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from coop_pin.errors import FieldError
from coop_pin.reference import Circle, PoseReference, Swing, Turn
from coop_pin.schema.base import Description, Positive, Vector3
from coop_pin.schema.pose import Pose


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if np.linalg.norm(vector) < 1e-9:
        raise FieldError(f"is {list(vector)}; it must have a length, and with it a direction")
    return vector


Direction = Annotated[Vector3, AfterValidator(_not_zero)]


class CircleMotion(Description):
    """Round and round a circle with a fixed orientation, from rest.

    The circle passes through the pose; its centre lies at pose.xyz - radius (cos(phi_0) e_1 + sin(phi_0) e_2) with e_1 the
    world's x axis seen in the plane of the circle (y, where the normal is x) and e_2 = normal x e_1.

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
        return replace(around_origin, centre=np.array(self.pose.xyz) - around_origin.at(self.start_time).X_WP_d[:3, 3])


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
        return Swing(self.pose.matrix, np.array(self.axis), self.amplitude, self.period, self.ramp, self.start_time)
