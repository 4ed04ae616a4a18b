"""Desired payload motions in closed form, and the union of all kinds of motion."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Positive, Vector3
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import make_pose, rotation_from_rpy
from coop_pin.reference.csv_motion import CsvMotion
from coop_pin.reference.joint_motion import JointMotion
from coop_pin.reference.lines import LineMotion, TimedLineMotion, rotation_about_axis, rotation_terms
from coop_pin.reference.pose_reference import FunctionMotion, PoseReference, PoseTarget, make_target
from coop_pin.reference.quintic import quintic, quintic_integral
from coop_pin.reference.splines import WaypointsMotion


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if np.linalg.norm(vector) < 1e-9:
        raise FieldError(f"is {list(vector)}; it must have a length, and with it a direction")
    return vector


Direction = Annotated[Vector3, AfterValidator(_not_zero)]
"""A vector of any length but zero."""


def _about_axis(axis: tuple[float, ...], pose: Pose) -> tuple[Array, Array, Array]:
    """Return the unit vector e of an axis, the position of a pose, and the terms of the rotation about e."""
    e, X = np.array(axis) / np.linalg.norm(axis), pose.matrix
    return e, X[:3, 3], rotation_terms(e, X[:3, :3])


class HoldMotion(PoseReference):
    """X_WP_d = pose at all times, at rest.

    Attributes:
        pose: X_WP_d.
    """

    kind: Literal["hold"] = "hold"
    pose: Pose

    @cached_property
    def _target(self) -> PoseTarget:
        X = self.pose.matrix
        return make_target(X[:3, :3], X[:3, 3])

    def at(self, time: float) -> PoseTarget:
        """Return the target, the same object at every time."""
        return self._target


class ExponentialMotion(PoseReference):
    """p(t) = constant + sum_k amplitude_k exp(-t / tau_k) with a fixed orientation.

    Gueaieb et al. (2007), section 4, is ``x_d = 0.4 - 0.2 exp(-t/6.6) + 0.5 exp(-t/6.8)``, ``y_d =
    x_d/sqrt(3) - 0.2``, ``psi_d = pi/3``. The motion does not start at rest, and grows at negative times.

    Attributes:
        constant: end of the motion, m.
        amplitudes: one vector for each exponential, m.
        time_constants: tau_k, s.
        rpy: the fixed orientation, roll, pitch, yaw, rad.
    """

    kind: Literal["exponentials"] = "exponentials"
    constant: Vector3
    amplitudes: tuple[Vector3, ...]
    time_constants: tuple[Positive, ...]
    rpy: Vector3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_constant_each(self) -> Self:
        amplitudes, entries = len(self.amplitudes), len(self.time_constants)
        if amplitudes != entries:
            raise FieldError(f"has {entries} entries for {amplitudes} amplitudes", "time_constants")
        return self

    @cached_property
    def _flat_terms(self) -> tuple[Array, Array, Array]:
        """Base (28,), columns (28, n) and rates (n,) of the target: base + columns exp(rates t)."""
        amplitudes = np.reshape(self.amplitudes, (-1, 3))
        rates = -1.0 / np.array(self.time_constants)
        base = np.concatenate((make_pose(self.constant, self.rpy).reshape(16), np.zeros(12)))
        columns = np.zeros((28, len(rates)))
        columns[[3, 7, 11]] = amplitudes.T
        columns[16:19] = amplitudes.T * rates
        columns[22:25] = amplitudes.T * rates**2
        return base, columns, rates

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        base, columns, rates = self._flat_terms
        flat = columns @ np.exp(rates * time)
        flat += base
        flat.flags.writeable = False
        return PoseTarget(flat[:16].reshape(4, 4), flat[16:22], flat[22:])


class CircleMotion(PoseReference):
    """p = c + r (cos(phi) e_1 + sin(phi) e_2) with a fixed orientation; phi starts from rest.

    phi = phi_0 + Omega integral of s, with the quintic s(t) that rises from 0 to 1 during the ramp. e_1 is
    the world's x axis in the plane (y, if the normal is x), e_2 = normal x e_1. The circle passes through the
    pose: c = pose.xyz - r (cos(phi_0) e_1 + sin(phi_0) e_2).

    Attributes:
        pose: X_WP_d at the start.
        radius: r, m.
        angular_rate: Omega after the ramp, rad/s; positive is counter-clockwise seen against the normal.
        ramp: time from rest to the full rate, s.
        normal: normal of the plane, world axes.
        start_angle: phi_0, rad.
        start_time: start of the ramp, s.
    """

    kind: Literal["circle"] = "circle"
    pose: Pose
    radius: Positive
    angular_rate: float
    ramp: Positive = 1.0
    normal: Direction = (0.0, 0.0, 1.0)
    start_angle: float = 0.0
    start_time: float = 0.0

    @cached_property
    def _circle(self) -> tuple[Array, Array, Array]:
        """R_WP_d, the centre c and the rows r e_1, r e_2."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        along = np.array((1.0, 0.0, 0.0) if abs(normal[0]) < 1.0 - 1e-6 else (0.0, 1.0, 0.0))
        e_1 = along - (along @ normal) * normal
        e_1 /= np.linalg.norm(e_1)
        spokes = self.radius * np.stack((e_1, np.cross(normal, e_1)))
        outward, _ = _radial_and_tangential(self.start_angle, spokes)
        return rotation_from_rpy(self.pose.rpy), np.array(self.pose.xyz) - outward, spokes

    @property
    def span(self) -> tuple[float, float]:
        """Time of the start, s, and inf."""
        return self.start_time, math.inf

    def slowed(self, factor: float) -> dict[str, Any]:
        """Return rate and ramp of the same path in a multiple of the time."""
        return {"angular_rate": self.angular_rate / factor, "ramp": factor * self.ramp}

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        R, centre, spokes = self._circle
        s = quintic(time, self.start_time, self.ramp)
        phi = self.start_angle + self.angular_rate * quintic_integral(time, self.start_time, self.ramp)
        rate, acceleration = self.angular_rate * s.value, self.angular_rate * s.rate
        outward, onward = _radial_and_tangential(phi, spokes)
        return make_target(R, centre + outward, v=rate * onward, a=acceleration * onward - rate**2 * outward)


def _radial_and_tangential(phi: float, spokes: Array) -> Array:
    """Return r (cos e_1 + sin e_2) and its derivative by phi, rows of shape (2, 3)."""
    cosine, sine = math.cos(phi), math.sin(phi)
    return np.array(((cosine, sine), (-sine, cosine))) @ spokes


class TurnMotion(PoseReference):
    """R = exp(theta e) R_0, p = c + exp(theta e) (p_0 - c); theta goes from 0 to angle by the quintic.

    Attributes:
        pose: X_WP_d before the turn.
        axis: e in world axes, any length.
        angle: reached at the end, rad; may be more than a whole turn.
        duration: time from rest to rest, s.
        start_time: s.
        centre: c, a point of the axis in world axes, m; P itself, which then rests, when omitted.
    """

    kind: Literal["turn"] = "turn"
    pose: Pose
    axis: Direction
    angle: float
    duration: Positive
    start_time: float = 0.0
    centre: Vector3 | None = None

    @cached_property
    def _start(self) -> tuple[Array, Array, Array, Array]:
        """E, the terms of the rotation about it, c in world axes, and p_0 - c in payload axes."""
        e, p_0, terms = _about_axis(self.axis, self.pose)
        c = p_0 if self.centre is None else np.array(self.centre)
        return e, terms, c, self.pose.matrix[:3, :3].T @ (p_0 - c)

    @property
    def span(self) -> tuple[float, float]:
        """Times between which it turns, s."""
        return self.start_time, self.start_time + self.duration

    def slowed(self, factor: float) -> dict[str, Any]:
        """Return the duration of the same turn in a multiple of the time."""
        return {"duration": factor * self.duration}

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        e, terms, c, offset = self._start
        s, turn = quintic(time, self.start_time, self.duration), self.angle * e
        R = rotation_about_axis(terms, self.angle * s.value)
        omega, alpha = s.rate * turn, s.acceleration * turn
        r = R @ offset
        v = np.cross(omega, r)
        return make_target(R, c + r, v, omega, np.cross(alpha, r) + np.cross(omega, v), alpha)


class SwingMotion(PoseReference):
    """R = exp(theta e) R_0 about an axis e through P, to and fro: theta = s amplitude sin(2 pi t / period).

    s(t) is the quintic that rises from 0 to 1 during the ramp; t counts from start_time.

    Attributes:
        pose: X_WP_d before the swing.
        axis: e in world axes, any length.
        amplitude: largest angle, rad.
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

    @cached_property
    def _start(self) -> tuple[Array, Array, Array]:
        return _about_axis(self.axis, self.pose)

    @property
    def span(self) -> tuple[float, float]:
        """Time of the start, s, and inf."""
        return self.start_time, math.inf

    def slowed(self, factor: float) -> dict[str, Any]:
        """Return period and ramp of the same swing in a multiple of the time."""
        return {"period": factor * self.period, "ramp": factor * self.ramp}

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        axis, p, terms = self._start
        s, w, A = quintic(time, self.start_time, self.ramp), 2.0 * math.pi / self.period, self.amplitude
        sine, cosine = math.sin(w * (time - self.start_time)), math.cos(w * (time - self.start_time))
        theta = A * s.value * sine
        theta_rate = A * (s.rate * sine + s.value * w * cosine)
        theta_acceleration = A * (s.acceleration * sine + 2.0 * s.rate * w * cosine - s.value * w * w * sine)
        R = rotation_about_axis(terms, theta)
        return make_target(R, p, omega=theta_rate * axis, alpha=theta_acceleration * axis)


# fmt: off
Motion = Annotated[
    HoldMotion | ExponentialMotion | LineMotion | TimedLineMotion | CircleMotion | TurnMotion | SwingMotion
    | WaypointsMotion | CsvMotion | JointMotion | FunctionMotion,
    Field(discriminator="kind"),
]
# fmt: on
