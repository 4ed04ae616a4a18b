"""Turning about an axis through the payload's own origin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from coop_pin.arrays import Array
from coop_pin.reference.axis_turn import axis_turn_terms, turned
from coop_pin.reference.checks import as_number, as_pose, as_positive, as_unit_vector, keep
from coop_pin.reference.target import PoseReference, PoseTarget, make_target
from coop_pin.reference.time_scaling import rest_to_rest


@dataclass(frozen=True, eq=False)
class Turn(PoseReference):
    """R = exp(theta e) R_0 about an axis e through P, theta going from 0 to angle by the quintic from rest to rest.

    Attributes:
        pose: X_WP_d before the turn, shape (4, 4).
        axis: e in world axes, any length, shape (3,).
        angle: reached at the end, rad; may be more than a whole turn.
        duration: of the turn, s, positive.
        start_time: s.

    Raises:
        ShapeError, NotFiniteError: a field has another shape or holds a NaN.
        NotAPoseError: pose is not a pose.
        NotPositiveError: duration is zero or less, or the axis has no length.
    """

    pose: Array
    axis: Array
    angle: float
    duration: float
    start_time: float = 0.0
    _terms: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields."""
        keep(self, pose=as_pose("pose", self.pose), axis=as_unit_vector("axis", self.axis), angle=as_number("angle", self.angle))
        keep(self, duration=as_positive("duration", self.duration), start_time=as_number("start_time", self.start_time))
        keep(self, _terms=axis_turn_terms(self.axis, self.pose[:3, :3]))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.duration)
        turn = self.angle * self.axis
        R = turned(self._terms, self.angle * s.value)
        return make_target(R, self.pose[:3, 3], omega=s.rate * turn, alpha=s.acceleration * turn)


@dataclass(frozen=True, eq=False)
class Swing(PoseReference):
    """R = exp(theta e) R_0 about an axis e through P, swinging to and fro: theta = s amplitude sin(2 pi t / period).

    s(t) is the quintic that rises from 0 to 1 during the ramp, t counts from start_time; the swing starts from rest.

    Attributes:
        pose: X_WP_d before the swing, shape (4, 4).
        axis: e in world axes, any length, shape (3,).
        amplitude: rad.
        period: s, positive.
        ramp: time until the full amplitude, s, positive.
        start_time: s.

    Raises:
        ShapeError, NotFiniteError: a field has another shape or holds a NaN.
        NotAPoseError: pose is not a pose.
        NotPositiveError: period or ramp is zero or less, or the axis has no length.
    """

    pose: Array
    axis: Array
    amplitude: float
    period: float
    ramp: float
    start_time: float = 0.0
    _terms: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields."""
        keep(self, pose=as_pose("pose", self.pose), axis=as_unit_vector("axis", self.axis))
        keep(self, amplitude=as_number("amplitude", self.amplitude), period=as_positive("period", self.period))
        keep(self, ramp=as_positive("ramp", self.ramp), start_time=as_number("start_time", self.start_time))
        keep(self, _terms=axis_turn_terms(self.axis, self.pose[:3, :3]))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.ramp)
        w = 2.0 * math.pi / self.period
        sine, cosine = math.sin(w * (time - self.start_time)), math.cos(w * (time - self.start_time))
        theta = self.amplitude * s.value * sine
        theta_rate = self.amplitude * (s.rate * sine + s.value * w * cosine)
        theta_acceleration = self.amplitude * (s.acceleration * sine + 2.0 * s.rate * w * cosine - s.value * w * w * sine)
        R = turned(self._terms, theta)
        return make_target(R, self.pose[:3, 3], omega=theta_rate * self.axis, alpha=theta_acceleration * self.axis)
