"""Differential-drive base under an arm: two driven wheels that roll, the law of its motion, and its servo."""

from __future__ import annotations

import math
from html import escape
from typing import Annotated, Any, Literal, NamedTuple, Self, TypeAlias

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Tag, model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, NotNegative, Positive, Vector3, positive
from coop_pin.description.cell.mobile_base import MobileBase, require_no_names, root_of
from coop_pin.reference.pose_reference import PoseTarget
from coop_pin.reference.quintic import quintic, quintic_integral

_WHEEL = """
  <visual>
    <origin xyz="0 {y!r} {r!r}" rpy="1.5707963267948966 0 0"/>
    <geometry><cylinder radius="{r!r}" length="0.05"/></geometry>
    <material name="wheel"><color rgba="0.12 0.12 0.13 1"/></material>
  </visual>"""
_CASTER = """
  <visual>
    <origin xyz="{x!r} 0 {r!r}"/><geometry><sphere radius="{r!r}"/></geometry>
    <material name="caster"><color rgba="0.6 0.6 0.62 1"/></material>
  </visual>"""
_PLATFORM = """
<link name="mobile_base">
  <inertial>
    <origin xyz="{base.centre!r} 0 {middle!r}"/><mass value="{base.mass!r}"/>
    <inertia ixx="{inertia[0]!r}" iyy="{inertia[1]!r}" izz="{inertia[2]!r}" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <visual>
    <origin xyz="{base.centre!r} 0 {middle!r}"/><geometry><box size="{x!r} {y!r} {height!r}"/></geometry>
    <material name="mobile_base"><color rgba="0.3 0.33 0.37 1"/></material>
  </visual>{wheels}
</link>
<joint name="base_mount" type="fixed">
  <origin xyz="{base.ahead!r} 0 {z!r}"/><parent link="mobile_base"/><child link={root}/>
</joint>
"""


class Steering(Description):
    """Stated motion of a differential base: speed and turn rate, up from rest, held, and down to rest.

    Both follow one profile of quintics, so that the path is an arc of the radius speed / turn_rate.

    Attributes:
        speed: v, speed of the middle of the axle along its heading, m/s; negative is backwards.
        turn_rate: omega, rad/s.
        wheels: rates of the left and the right wheel, rad/s, in place of speed and turn rate.
        duration: time from rest to rest, s.
        ramp: time from rest to the full rates, and back, s.
        start_time: s.
    """

    speed: float = 0.0
    turn_rate: float = 0.0
    wheels: tuple[float, float] | None = None
    duration: Positive
    ramp: Positive = 1.0
    start_time: NotNegative = 0.0

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.wheels is not None and (self.speed or self.turn_rate):
            raise FieldError("is stated beside speed or turn_rate; state one of them", "wheels")
        if self.duration < 2.0 * self.ramp:
            raise FieldError(f"is {self.duration:g} s; it must be at least twice the ramp", "duration")
        return self

    def profile(self, time: float) -> tuple[float, float, float]:
        """Return s, its integral (s) and its rate (1/s) at a time; v and omega are s times the stated ones.

        Args:
            time: s.
        """
        ends = self.start_time, self.start_time + self.duration - self.ramp
        up, down = (quintic(time, start, self.ramp) for start in ends)
        area = quintic_integral(time, ends[0], self.ramp) - quintic_integral(time, ends[1], self.ramp)
        return up.value - down.value, area, up.rate - down.rate


class PlaceOnPayload(Description):
    """Stated place of a base on the payload: b goes there from where it starts, along a quintic.

    Attributes:
        place: point of the payload's frame over or under which b is then, m.
        duration: time of the way there, s.
        start_time: s.
    """

    place: Vector3
    duration: Positive
    start_time: NotNegative = 0.0

    def points(self, time: float, start: Array) -> Array:
        """Return point, rate and acceleration of b in the payload's frame at a time, s, shape (3, 3)."""
        s = quintic(time, self.start_time, self.duration)
        return np.outer((1.0, 0.0, 0.0), start) + np.outer(s, np.subtract(self.place, start))


class PlanarCommand(NamedTuple):
    """Command of a differential base.

    Attributes:
        rates: speed and turn rate, m/s and rad/s, shape (2,).
        accelerations: their derivatives, m/s^2 and rad/s^2, shape (2,).
    """

    rates: Array
    accelerations: Array


def _steering_or_name(value: object) -> object:
    if isinstance(value, str) and value not in ("parked", "hold", "payload"):
        names = (
            "'parked', 'hold', 'payload', or a table of speed, turn_rate and duration, or place and duration"
        )
        raise FieldError(f"is {value!r}; it must be {names}")
    return PlaceOnPayload(**value) if isinstance(value, dict) and "place" in value else value


class DifferentialBase(Description):
    """Platform on two driven wheels under an arm: it rolls along its heading, and never slides sideways.

    ``X_WB`` of the arm (its field ``base``) is the pose of the middle of the wheels' axle on the ground at
    the start; x is the heading. The root link of the arm's URDF stands on the platform ahead of the axle, at
    the point b that the base's own law moves. With the heading theta, e = (cos theta, sin theta), its normal
    n and the reference r of b, which a payload carries with it or a steering states::

        u = r' + k (r - b),    v_c = e . u,    omega_c = n . u / ahead
        F = m (v_c' + w (v_c - v)),    M = I (omega_c' + w (omega_c - omega))

    This is input-output linearisation of a unicycle (Siciliano et al. 2009, section 11.5), with a servo of
    speed and turn rate that is sampled at the control ticks. m and I are the inertia that the base moves at
    the start. Casters bear weight only.

    Attributes:
        drive: kind of the drive, "differential".
        follow: reference of b: it stays with the "payload" where it starts, or at a stated place of its
            frame; "hold" keeps it where it starts, or a stated steering; a "parked" base is fixed.
        mass: mass of the platform with its wheels, kg, homogeneous.
        size: edges of the platform, m; it is drawn from the middle of the wheels up.
        centre: distance of the platform's middle ahead of the axle, m.
        ahead: distance of the arm ahead of the axle, m.
        wheel_radius: m.
        track: distance between the wheels, m.
        wheel_inertia: inertia of each wheel with its rotor, kg m^2.
        wheel_torque: largest torque of each wheel's drive, N m, or "none".
        wheel_speed: rate of a wheel beyond which ``check`` warns, rad/s.
        friction: largest force of the ground along it over that upright on the base, before a wheel slips.
        bandwidth: w, rad/s.
        position_gain: k, 1/s.
    """

    drive: Literal["differential"] = "differential"
    follow: Annotated[
        Literal["parked", "hold", "payload"] | Steering | PlaceOnPayload, BeforeValidator(_steering_or_name)
    ] = "payload"
    mass: Positive = 120.0
    size: Annotated[Vector3, AfterValidator(positive)] = (0.9, 0.6, 0.4)
    centre: float = 0.1
    ahead: Positive = 0.25
    wheel_radius: Positive = 0.1
    track: Positive = 0.5
    wheel_inertia: NotNegative = 0.0
    wheel_torque: Literal["none"] | Positive = 100.0
    wheel_speed: Positive = 30.0
    friction: Positive = 0.6
    bandwidth: Positive = 30.0
    position_gain: Positive = 3.0

    @property
    def is_driven(self) -> bool:
        """Whether it moves: whether it is not parked."""
        return self.follow != "parked"

    @property
    def follows_payload(self) -> bool:
        """Whether its reference goes with the payload."""
        return self.follow == "payload" or isinstance(self.follow, PlaceOnPayload)

    @property
    def to_wheels(self) -> Array:
        """T with rates of the left and right wheel = T [v, omega], shape (2, 2)."""
        half = 0.5 * self.track
        return np.array(((1.0, -half), (1.0, half))) / self.wheel_radius

    @property
    def rotors(self) -> Array:
        """Inertia of the wheels' spin on x, y and yaw, kg and kg m^2, shape (3,); T^T J T on v and omega."""
        along, turning = self.wheel_inertia * np.square(self.to_wheels).sum(axis=0)
        return np.array((along, along, turning))

    def steered(self, steering: Steering) -> tuple[float, float]:
        """Return stated speed and turn rate, m/s and rad/s."""
        if steering.wheels is None:
            return steering.speed, steering.turn_rate
        speed, turn_rate = np.linalg.solve(self.to_wheels, steering.wheels).tolist()
        return speed, turn_rate

    def reference(self, time: float, X_WB: Array, way: PoseTarget, begin: Array) -> Array:
        """Return r, r' and r'' of b in axes of B, shape (3, 2).

        Args:
            time: s.
            X_WB: pose of the base at the start, shape (4, 4).
            way: desired motion of the payload.
            begin: pose of the payload at the start, shape (4, 4).
        """
        if isinstance(self.follow, Steering):
            return self._steered(self.follow, time)
        if not self.follows_payload:
            return np.array(((self.ahead, 0.0), (0.0, 0.0), (0.0, 0.0)))
        R_B, R, b = X_WB[:3, :3], way.X_WP_d[:3, :3], X_WB[:3, 3] + self.ahead * X_WB[:3, 0]
        on_payload = np.zeros((3, 3))
        on_payload[0] = begin[:3, :3].T @ (b - begin[:3, 3])
        if isinstance(self.follow, PlaceOnPayload):
            on_payload = self.follow.points(time, on_payload[0])
        lever, velocity, acceleration = on_payload @ R.T
        (v, omega), (a, alpha) = np.split(way.V_WP_d, 2), np.split(way.A_WP_d, 2)
        turning = np.cross(omega, lever) + velocity
        points = (
            way.X_WP_d[:3, 3] + lever - X_WB[:3, 3],
            v + turning,
            a + np.cross(alpha, lever) + np.cross(omega, turning + velocity) + acceleration,
        )
        return (np.array(points) @ R_B)[:, :2]

    def _steered(self, steering: Steering, time: float) -> Array:
        """Return what ``reference`` does of a steering: an arc, b ahead of its point on the axle."""
        (v, w), (s, area, rate), d = self.steered(steering), steering.profile(time), self.ahead
        theta = w * area
        along, across = np.array(((math.cos(theta), math.sin(theta)), (-math.sin(theta), math.cos(theta))))
        # (sin theta, 1 - cos theta) / w, of which the straight line is the limit
        chord = v * area * np.sinc(0.5 * theta / math.pi)
        axle = chord * np.array((math.cos(0.5 * theta), math.sin(0.5 * theta)))
        velocity = s * (v * along + w * d * across)
        acceleration = rate * (v * along + w * d * across) + s * s * w * (v * across - w * d * along)
        return np.array((axle + d * along, velocity, acceleration))

    def command(self, pose: Array, rates: Array, reference: Array) -> PlanarCommand:
        """Return speed and turn rate that lead b to its reference, with their derivatives.

        Args:
            pose: x, y and theta of the axle's middle in axes of B, shape (3,).
            rates: their rates, shape (3,).
            reference: r, r' and r'', shape (3, 2).
        """
        (r, r_rate, r_acceleration), theta, omega = reference, pose[2], rates[2]
        along = np.array((math.cos(theta), math.sin(theta)))
        across, k, d = np.array((-along[1], along[0])), self.position_gain, self.ahead
        u = r_rate + k * (r - pose[:2] - d * along)
        u_rate = r_acceleration + k * (r_rate - rates[:2] - d * omega * across)
        commanded = np.array((along @ u, across @ u / d))
        changed = np.array(
            (along @ u_rate + omega * (across @ u), (across @ u_rate - omega * (along @ u)) / d)
        )
        return PlanarCommand(commanded, changed)

    def force(self, pose: Array, rates: Array, command: PlanarCommand, inertia: Array) -> Array:
        """Return the force along the heading and the torque of the servo, within the wheels' limits, (2,).

        Args:
            pose: x, y and theta of the axle, as of ``command``.
            rates: rates of x, y and theta, as of ``command``.
            command: the command.
            inertia: m and I, kg and kg m^2, shape (2,).
        """
        theta = pose[2]
        moving = np.array((math.cos(theta) * rates[0] + math.sin(theta) * rates[1], rates[2]))
        force = inertia * (command.accelerations + self.bandwidth * (command.rates - moving))
        if self.wheel_torque == "none":
            return np.asarray(force)
        T = self.to_wheels  # force = T^T torques
        torques = np.linalg.solve(T.T, force)
        return np.asarray(T.T @ np.clip(torques, -self.wheel_torque, self.wheel_torque))

    def under(self, urdf: str) -> str:
        """Return the text of a checked URDF whose root link stands on this platform.

        Raises:
            UrdfError: the URDF has a link or joint with a name of the platform's.
        """
        require_no_names(urdf, ("mobile_base", "base_mount"))
        (x, y, height), r = self.size, self.wheel_radius
        inertia = [self.mass * (a * a + b * b) / 12.0 for a, b in ((y, height), (x, height), (x, y))]
        sides = (_WHEEL.format(y=side * 0.5 * self.track, r=r) for side in (1.0, -1.0))
        ends = (self.centre + end * (0.5 * x - 0.5 * r) for end in (1.0, -1.0))
        casters = (_CASTER.format(x=end, r=0.5 * r) for end in ends if abs(end) > r)
        added = _PLATFORM.format(
            base=self,
            x=x,
            y=y,
            height=height,
            z=r + height,
            middle=r + 0.5 * height,
            inertia=inertia,
            wheels="".join((*sides, *casters)),
            root=f'"{escape(root_of(urdf))}"',
        )
        before, _, after = urdf.rpartition("</robot>")
        return f"{before}{added}</robot>{after}"


def _drive(value: Any) -> str:
    drive = value.get("drive") if isinstance(value, dict) else getattr(value, "drive", None)
    return "differential" if drive == "differential" else "omnidirectional"


Base: TypeAlias = Annotated[
    Annotated[MobileBase, Tag("omnidirectional")] | Annotated[DifferentialBase, Tag("differential")],
    Discriminator(_drive),
]
"""Mobile base by its drive; omnidirectional when none is stated."""
