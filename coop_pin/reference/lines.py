"""Desired motions along a line: position straight, orientation on the geodesic, with two timing laws."""

from __future__ import annotations

import math
from abc import abstractmethod
from bisect import bisect_right
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from pydantic import model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import AmbiguousTurnError, FieldError
from coop_pin.base.schema.base import Positive, Vector
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import log3
from coop_pin.reference.pose_reference import PoseReference, PoseTarget, target_of
from coop_pin.reference.quintic import TimeScaling, quintic
from coop_pin.reference.splines import powers, quintic_coefficients


def rotation_terms(axis: Array, R: Array) -> Array:
    """Return the terms R, [e]x R, [e]x^2 R of the rotation exp(theta [e]x) R about a unit vector, (3, 9)."""
    cross = np.cross(axis, np.eye(3)).T
    return np.stack((R, cross @ R, cross @ cross @ R)).reshape(3, 9)


def rotation_about_axis(terms: Array, angle: float) -> Array:
    """Return exp(theta [e]x) R = R + sin(theta) [e]x R + (1 - cos(theta)) [e]x^2 R, shape (3, 3)."""
    return (np.array((1.0, math.sin(angle), 1.0 - math.cos(angle))) @ terms).reshape(3, 3)


_HALF_TURN_MARGIN = 1e-3
"""Turns closer to pi are refused, rad: round-off would choose their direction."""


class _Line(PoseReference):
    """p = p_0 + s (p_1 - p_0), R = exp(s phi) R_0, phi = log(R_1 R_0^T): a straight line and a geodesic."""

    kind: str
    start: Pose
    goal: Pose

    @abstractmethod
    def scaling(self, time: float) -> TimeScaling:
        """Return s and its two derivatives at a time in s."""

    @model_validator(mode="after")
    def _shorter_way_exists(self) -> Self:
        angle = self._path[2]
        if angle > math.pi - _HALF_TURN_MARGIN:
            raise FieldError(f"is ambiguous: {AmbiguousTurnError('start', 'goal', 1, angle)}", "goal.rpy")
        return self

    @cached_property
    def _path(self) -> tuple[Array, Array, float, Array]:
        """p_0, [p_1 - p_0, phi], the angle |phi|, and the terms of the rotation about phi."""
        X_0, X_1 = self.start.matrix, self.goal.matrix
        R_0, p_0 = X_0[:3, :3], X_0[:3, 3]
        turn = log3(X_1[:3, :3] @ R_0.T)
        angle = float(np.linalg.norm(turn))
        terms = rotation_terms(turn / angle if angle else turn, R_0)
        return p_0, np.concatenate((X_1[:3, 3] - p_0, turn)), angle, terms

    def along(self, s: TimeScaling) -> PoseTarget:
        """Return the target at a place of the line, with its rates."""
        start, way, angle, terms = self._path
        R, p = rotation_about_axis(terms, s.value * angle), start + s.value * way[:3]
        return target_of(R, p, s.rate * way, s.acceleration * way)

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        return self.along(self.scaling(time))


class LineMotion(_Line):
    """p = p_0 + s (p_1 - p_0), R = exp(s phi) R_0, phi = log(R_1 R_0^T), s(t) the quintic from rest to rest.

    The orientation takes the geodesic.

    Attributes:
        start: X_WP_d before the motion.
        goal: X_WP_d after it; its orientation is less than half a turn away.
        duration: time from start to goal, s.
        start_time: s.
    """

    kind: Literal["line"] = "line"
    duration: Positive
    start_time: float = 0.0

    @property
    def span(self) -> tuple[float, float]:
        """Times of start and goal, s."""
        return self.start_time, self.start_time + self.duration

    def slowed(self, factor: float) -> dict[str, Any]:
        """Return the duration of the same path in a multiple of the time."""
        return {"duration": factor * self.duration}

    def scaling(self, time: float) -> TimeScaling:
        """Return s and its two derivatives at a time in s."""
        return quintic(time, self.start_time, self.duration)


class TimedLineMotion(_Line):
    """The path of LineMotion with s(t) a quintic spline through a table, at rest at both ends.

    ``cp.carry.plan_carry`` returns such motions. The spline has four continuous derivatives.

    Attributes:
        start: X_WP_d before the motion.
        goal: X_WP_d after it; its orientation is less than half a turn away.
        times: t_i, s, strictly increasing.
        fractions: s(t_i), from 0 to 1.
    """

    kind: Literal["timed-line"] = "timed-line"
    times: Vector
    fractions: Vector

    @model_validator(mode="after")
    def _is_one_table(self) -> Self:
        if len(self.times) < 2 or len(self.fractions) != len(self.times):
            counts = f"{len(self.fractions)} entries for {len(self.times)} times"
            raise FieldError(f"has {counts}; both need as many, at least 2", "fractions")
        if not (np.diff(self.times) > 0.0).all():
            raise FieldError("does not increase strictly; sort the times and drop those given twice", "times")
        if (ends := (self.fractions[0], self.fractions[-1])) != (0.0, 1.0):
            raise FieldError(f"goes from {ends[0]:g} to {ends[1]:g}; it must go from 0 to 1", "fractions")
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the table, s."""
        return self.times[0], self.times[-1]

    @cached_property
    def _coefficients(self) -> Array:
        points = np.array(self.fractions)[:, None]
        return np.ascontiguousarray(quintic_coefficients(np.array(self.times), points)[..., 0])

    def scaling(self, time: float) -> TimeScaling:
        """Return s and its two derivatives at a time in s."""
        if not self.times[0] < time < self.times[-1]:
            return TimeScaling(float(time > self.times[0]), 0.0, 0.0)
        segment = bisect_right(self.times, time) - 1
        return TimeScaling(*(powers(time - self.times[segment]) @ self._coefficients[segment]).tolist())
