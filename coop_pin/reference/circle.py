"""Round and round a circle, from rest."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from coop_pin.arrays import Array, as_array
from coop_pin.reference.checks import as_number, as_positive, as_unit_vector, keep
from coop_pin.reference.target import PoseReference, PoseTarget, make_target
from coop_pin.reference.time_scaling import rest_to_rest, rest_to_rest_integral
from coop_pin.spatial import rotation_from_rpy


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
        NotFiniteError: an entry is NaN or infinite.
        NotPositiveError: radius or ramp is zero or less, or the normal has no length.
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
        keep(self, angular_rate=as_number("angular_rate", self.angular_rate), ramp=as_positive("ramp", self.ramp))
        keep(self, normal=as_unit_vector("normal", self.normal), start_angle=as_number("start_angle", self.start_angle))
        keep(self, start_time=as_number("start_time", self.start_time), rpy=as_array("rpy", self.rpy, 3))
        e_1 = _in_plane(self.normal)
        keep(self, _R=rotation_from_rpy(self.rpy), _spokes=self.radius * np.stack((e_1, np.cross(self.normal, e_1))))

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
