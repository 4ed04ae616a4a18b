"""Turning about an axis through the payload's own origin."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.errors import AmbiguousTurnError, OutOfRangeError
from coop_pin.reference.pose_reference import (
    PoseReference,
    PoseTarget,
    acceleration_from,
    as_number,
    as_pose,
    as_positive,
    as_unit_vector,
    displacements,
    keep,
    make_target,
    rate_of,
    twist_from,
)
from coop_pin.spatial import make_pose, rotation_from_rpy


class Scaling(NamedTuple):
    """A scalar going from zero to one, with its derivatives by time."""

    value: float
    """s, between 0 and 1."""

    rate: float
    """Its first derivative, 1/s."""

    acceleration: float
    """Its second derivative, 1/s^2."""


BEFORE = Scaling(0.0, 0.0, 0.0)
AFTER = Scaling(1.0, 0.0, 0.0)


def rest_to_rest(time: float, start_time: float, duration: float) -> Scaling:
    """Return s = 10 u^3 - 15 u^4 + 6 u^5 and its two derivatives, u = (time - start_time) / duration.

    Zero before, one after; rate and acceleration vanish at both ends, so that s is twice continuously
    differentiable.

    Args:
        time: s.
        start_time: s.
        duration: s, positive.
    """
    u = (time - start_time) / duration
    if u <= 0.0:
        return BEFORE
    if u >= 1.0:
        return AFTER
    w = 1.0 - u
    value = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return Scaling(value, 30.0 * u * u * w * w / duration, 60.0 * u * w * (w - u) / (duration * duration))


def rest_to_rest_integral(time: float, start_time: float, duration: float) -> float:
    """Return the integral of s by time from start_time on: T (5/2 u^4 - 3 u^5 + u^6), and T/2 + (time - start_time - T) after T.

    Args:
        time: s.
        start_time: s.
        duration: T, s, positive.
    """
    u = (time - start_time) / duration
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return duration * (u - 0.5)
    return duration * u**4 * (2.5 + u * (u - 3.0))


def axis_turn_terms(axis: Array, R: Array) -> Array:
    """Return the terms of exp(theta [e]x) R = R + sin(theta) [e]x R + (1 - cos(theta)) [e]x^2 R, shape (3, 9).

    Args:
        axis: unit vector e in world axes, shape (3,).
        R: rotation matrix to be turned, shape (3, 3).
    """
    cross = np.cross(axis, np.eye(3)).T
    return np.stack((R, cross @ R, cross @ cross @ R)).reshape(3, 9)


def turned(terms: Array, angle: float) -> Array:
    """Return exp(theta [e]x) R from its terms, shape (3, 3).

    Args:
        terms: from axis_turn_terms, shape (3, 9).
        angle: theta, rad.
    """
    R: Array = (np.array((1.0, math.sin(angle), 1.0 - math.cos(angle))) @ terms).reshape(3, 3)
    return R


@dataclass(frozen=True, eq=False)
class Hold(PoseReference):
    """X_WP_d = pose at all times.

    Attributes:
        pose: desired pose of P in W, shape (4, 4).

    Raises:
        ShapeError, OutOfRangeError, NotAPoseError: pose is not a pose.
    """

    pose: Array
    _target: PoseTarget = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the pose and make the one target."""
        pose = as_pose("pose", self.pose)
        keep(self, pose=pose, _target=make_target(pose[:3, :3], pose[:3, 3]))

    def at(self, time: float) -> PoseTarget:
        """Return the target, the same object at every time."""
        return self._target


HALF_TURN_MARGIN = 1e-3
"""Turns closer than this to pi are refused, rad: round-off would choose the way round."""


@dataclass(frozen=True, eq=False)
class Line(PoseReference):
    """p = p_0 + s (p_1 - p_0), R = exp(s phi) R_0 with phi = log(R_1 R_0^T), s(t) the quintic from rest to rest.

    The pose rests at start before start_time and at goal afterwards; the orientation takes the geodesic, the
    shorter way.

    Attributes:
        start: X_WP_d before, shape (4, 4).
        goal: X_WP_d afterwards, shape (4, 4).
        duration: of the motion, s, positive.
        start_time: s.

    Raises:
        ShapeError, OutOfRangeError, NotAPoseError: start or goal is not a pose.
        OutOfRangeError: duration is zero or less.
        AmbiguousTurnError: start and goal are half a turn apart.
    """

    start: Array
    goal: Array
    duration: float
    start_time: float = 0.0
    _displacement: Array = field(init=False, repr=False)
    _turn: Array = field(init=False, repr=False)
    _angle: float = field(init=False, repr=False)
    _terms: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and take the difference of the two poses."""
        start, goal = as_pose("start", self.start), as_pose("goal", self.goal)
        keep(self, start=start, goal=goal, duration=as_positive("duration", self.duration))
        R_0 = start[:3, :3]
        turn = Rotation.from_matrix(goal[:3, :3] @ R_0.T).as_rotvec()
        angle = float(np.linalg.norm(turn))
        if angle > math.pi - HALF_TURN_MARGIN:
            raise AmbiguousTurnError("start", "goal", 1, angle)
        axis = turn / angle if angle else turn
        keep(
            self,
            start_time=as_number("start_time", self.start_time),
            _displacement=goal[:3, 3] - start[:3, 3],
        )
        keep(self, _turn=turn, _angle=angle, _terms=axis_turn_terms(axis, R_0))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.duration)
        d, phi = self._displacement, self._turn
        R, p = turned(self._terms, s.value * self._angle), self.start[:3, 3] + s.value * d
        return make_target(R, p, s.rate * d, s.rate * phi, s.acceleration * d, s.acceleration * phi)


def _up() -> Array:
    return np.array((0.0, 0.0, 1.0))


def _no_turn() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False)
class Circle(PoseReference):
    """p = c + r (cos(phi) e_1 + sin(phi) e_2) with a fixed orientation; phi starts from rest.

    ``phi = phi_0 + Omega integral of s``, where s(t) is the quintic that rises from 0 to 1 during the ramp.
    e_1 is the world's x axis seen in the plane of the circle (the y axis, where the normal is the x axis),
    e_2 = normal x e_1.

    Attributes:
        centre: c, m, shape (3,).
        radius: r, m, positive.
        angular_rate: Omega after the ramp, rad/s; positive is counter-clockwise seen against the normal.
        ramp: time from rest to the full rate, s, positive.
        normal: of the plane of the circle, any length, world axes, shape (3,).
        start_angle: phi_0, rad.
        start_time: when the ramp begins, s.
        rpy: the fixed orientation of P, roll, pitch, yaw, rad, shape (3,).

    Raises:
        ShapeError: shapes differ from these.
        OutOfRangeError: an entry is NaN or infinite; radius or ramp is zero or less, or the normal has no
            length.
    """

    centre: Array
    radius: float
    angular_rate: float
    ramp: float
    normal: Array = field(default_factory=_up)
    start_angle: float = 0.0
    start_time: float = 0.0
    rpy: Array = field(default_factory=_no_turn)
    _R: Array = field(init=False, repr=False)
    _spokes: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and lay out the plane."""
        keep(self, centre=as_array("centre", self.centre, 3), radius=as_positive("radius", self.radius))
        keep(
            self,
            angular_rate=as_number("angular_rate", self.angular_rate),
            ramp=as_positive("ramp", self.ramp),
        )
        keep(
            self,
            normal=as_unit_vector("normal", self.normal),
            start_angle=as_number("start_angle", self.start_angle),
        )
        keep(self, start_time=as_number("start_time", self.start_time), rpy=as_array("rpy", self.rpy, 3))
        e_1 = _in_plane(self.normal)
        keep(
            self,
            _R=rotation_from_rpy(self.rpy),
            _spokes=self.radius * np.stack((e_1, np.cross(self.normal, e_1))),
        )

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.ramp)
        phi = self.start_angle + self.angular_rate * rest_to_rest_integral(time, self.start_time, self.ramp)
        phi_rate, phi_acceleration = self.angular_rate * s.value, self.angular_rate * s.rate
        cosine, sine = math.cos(phi), math.sin(phi)
        outward, onward = np.array(((cosine, sine), (-sine, cosine))) @ self._spokes
        a = phi_acceleration * onward - phi_rate**2 * outward
        return make_target(self._R, self.centre + outward, v=phi_rate * onward, a=a)


def _in_plane(normal: Array) -> Array:
    """Return the unit vector at angle zero of a circle with this unit normal, shape (3,)."""
    along = np.array((1.0, 0.0, 0.0)) if abs(normal[0]) < 1.0 - 1e-6 else np.array((0.0, 1.0, 0.0))
    return as_unit_vector("normal", along - (along @ normal) * normal)


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
        ShapeError, OutOfRangeError: a field has another shape or holds a NaN.
        NotAPoseError: pose is not a pose.
        OutOfRangeError: duration is zero or less, or the axis has no length.
    """

    pose: Array
    axis: Array
    angle: float
    duration: float
    start_time: float = 0.0
    _terms: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields."""
        keep(
            self,
            pose=as_pose("pose", self.pose),
            axis=as_unit_vector("axis", self.axis),
            angle=as_number("angle", self.angle),
        )
        keep(
            self,
            duration=as_positive("duration", self.duration),
            start_time=as_number("start_time", self.start_time),
        )
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

    s(t) is the quintic that rises from 0 to 1 during the ramp, t counts from start_time; the swing starts
    from rest.

    Attributes:
        pose: X_WP_d before the swing, shape (4, 4).
        axis: e in world axes, any length, shape (3,).
        amplitude: rad.
        period: s, positive.
        ramp: time until the full amplitude, s, positive.
        start_time: s.

    Raises:
        ShapeError, OutOfRangeError: a field has another shape or holds a NaN.
        NotAPoseError: pose is not a pose.
        OutOfRangeError: period or ramp is zero or less, or the axis has no length.
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
        keep(
            self, amplitude=as_number("amplitude", self.amplitude), period=as_positive("period", self.period)
        )
        keep(self, ramp=as_positive("ramp", self.ramp), start_time=as_number("start_time", self.start_time))
        keep(self, _terms=axis_turn_terms(self.axis, self.pose[:3, :3]))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        s = rest_to_rest(time, self.start_time, self.ramp)
        w = 2.0 * math.pi / self.period
        sine, cosine = math.sin(w * (time - self.start_time)), math.cos(w * (time - self.start_time))
        theta = self.amplitude * s.value * sine
        theta_rate = self.amplitude * (s.rate * sine + s.value * w * cosine)
        theta_acceleration = self.amplitude * (
            s.acceleration * sine + 2.0 * s.rate * w * cosine - s.value * w * w * sine
        )
        R = turned(self._terms, theta)
        return make_target(
            R, self.pose[:3, 3], omega=theta_rate * self.axis, alpha=theta_acceleration * self.axis
        )


@dataclass(frozen=True, eq=False)
class Exponentials(PoseReference):
    """p(t) = constant + sum_k amplitude_k exp(-t / tau_k) with a fixed orientation.

    Gueaieb et al. (2007), section 4, is ``x_d = 0.4 - 0.2 exp(-t/6.6) + 0.5 exp(-t/6.8)``, ``y_d =
    x_d/sqrt(3) - 0.2``, ``psi_d = pi/3``. The motion does not start at rest; the formula holds at negative
    times as well, where it grows.

    Attributes:
        constant: where the motion ends, m, shape (3,).
        amplitudes: one vector for each exponential, m, shape (n, 3).
        time_constants: tau_k, s, positive, shape (n,).
        rpy: the fixed orientation, roll, pitch, yaw, rad, shape (3,).

    Raises:
        ShapeError: shapes differ from these.
        OutOfRangeError: an entry is NaN or infinite; a time constant is zero or less.
    """

    constant: Array
    amplitudes: Array
    time_constants: Array
    rpy: Array
    _rates: Array = field(init=False, repr=False)
    _base: Array = field(init=False, repr=False)
    _columns: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the fields and lay the target out as base (28,) + columns (28, n) exp(rates t)."""
        constant = as_array("constant", self.constant, 3)
        amplitudes = as_array("amplitudes", self.amplitudes, "n", 3)
        time_constants = as_array("time_constants", self.time_constants, len(amplitudes))
        rpy = as_array("rpy", self.rpy, 3)
        for index, time_constant in enumerate(time_constants):
            if time_constant <= 0.0:
                raise OutOfRangeError(f"time_constants[{index}]", float(time_constant))
        rates = -1.0 / time_constants
        base = np.concatenate((make_pose(constant, rpy).reshape(16), np.zeros(12)))
        columns = np.zeros((28, len(rates)))
        columns[[3, 7, 11]] = amplitudes.T
        columns[16:19] = amplitudes.T * rates
        columns[22:25] = amplitudes.T * rates**2
        keep(self, constant=constant, amplitudes=amplitudes, time_constants=time_constants, rpy=rpy)
        keep(self, _rates=rates, _base=base, _columns=columns)

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        flat = self._columns @ np.exp(self._rates * time)
        flat += self._base
        flat.flags.writeable = False
        return PoseTarget(flat[:16].reshape(4, 4), flat[16:22], flat[22:])


@dataclass(frozen=True, eq=False)
class FromFunction(PoseReference):
    """X_WP_d(t) = pose_function(t); what is not given of twist and acceleration comes from central differences.

    The differences look ahead and back by 2 step, so the functions must be smooth and defined a little before
    the start of the run. Fourth order in step: at the default, motions with time constants about a second
    come out to 1e-11 in the twist and 1e-9 in the acceleration. A given twist or acceleration is taken on
    trust here; ``check_consistency`` tests it.

    Attributes:
        pose_function: time in s -> X_WP_d, shape (4, 4).
        twist_function: time in s -> V_WP_d, world axes, linear first, shape (6,).
        acceleration_function: time in s -> A_WP_d, the derivative of V_WP_d, shape (6,).
        step: of the differences, s, positive.

    Raises:
        OutOfRangeError: step is zero or less. ``at`` raises ShapeError, OutOfRangeError or NotAPoseError,
            naming the function.
    """

    pose_function: Callable[[float], ArrayLike]
    twist_function: Callable[[float], ArrayLike] | None = None
    acceleration_function: Callable[[float], ArrayLike] | None = None
    step: float = 1e-3

    def __post_init__(self) -> None:
        """Check the step."""
        keep(self, step=as_positive("step", self.step))

    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""
        X_WP_d = self._pose(time)
        if self.twist_function is None:
            displaced = displacements(self._pose, time, self.step)
            V_WP_d, A_WP_d = twist_from(displaced, self.step), acceleration_from(displaced, self.step)
        else:
            V_WP_d, A_WP_d = self._twist(time), rate_of(self._twist, time, self.step)
        if self.acceleration_function is not None:
            A_WP_d = as_array(f"acceleration_function({time})", self.acceleration_function(time), 6)
        return PoseTarget(frozen(X_WP_d), frozen(V_WP_d), frozen(A_WP_d))

    def _pose(self, time: float) -> Array:
        """Return the user's pose, checked."""
        return as_pose(f"pose_function({time})", self.pose_function(time))

    def _twist(self, time: float) -> Array:
        """Return the user's twist, checked."""
        assert self.twist_function is not None
        return as_array(f"twist_function({time})", self.twist_function(time), 6)
