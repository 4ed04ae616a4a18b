"""Servo of an arm: the robot's own inner loop, by which it takes velocities or positions as commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Magnitude, NumberOrVector, Positive, by_name, positive
from coop_pin.base.schema.delay import Delay

KINDS = ("velocity", "position")
"""What a robot with a servo takes."""
_WHOLE = 1e-9
"""Two rates whose ratio is closer than this to a whole number are multiples."""


Limit = Annotated[NumberOrVector, AfterValidator(positive)]
"""Limit of every drive, or one for each; positive."""


class Servo(Description):
    """Inner loop of a robot that takes velocities or positions of its drives: PI on velocity, P on position.

    It samples the drives at its own rate 1/h, at the ticks and n - 1 times between them, and holds its torque
    in between. With the drive positions q and velocities v, the command c[k] of the last tick, the
    inertia I of each drive and the share x of the tick that has passed::

        velocity   w  <- w + clip(clip(c[k], -speed_limit, speed_limit) - w, -a h, a h),  w_r = w
        position   p  =  c[k-1] + x (c[k] - c[k-1]),   r <- r + h w,   e = p - r
                   w  <- as above, to (c[k] - c[k-1]) / T + sgn(e) min(|e| / h, sqrt(2 a |e|))
                   w_r = clip(k_p (r - q) + phi w, -speed_limit, speed_limit)
        torque     tau = I k_v (w_r - v) + z [+ exact feed-forward],   z <- z + h I k_v k_i (w_r - v)

    Compensation of gravity and torque limits follow as for a commanded torque; z is held while they cut it.
    I is the diagonal of the arm's own inertia T^-T M T^-1 at the start, without payload. The exact
    feed-forward is T^-T (M qddot + C qdot) of the arm alone at the acceleration of w. Before the first tick
    the servo holds the cell at rest: r = q, and z is what that takes.

    A position follows a tick late, on a straight line between two commands. At rest and without k_i the
    drives are springs of stiffness I k_v k_p towards r.

    Attributes:
        command: kind of the robot's commands: "velocity" or "position".
        rate_hz: rate of the servo, Hz, a multiple of the control rate that divides the plant's steps.
        velocity_bandwidth: k_v, 1/s: pole of the velocity loop of the arm alone; one value or one for each
            drive, as in the other fields.
        integral_rate: k_i, 1/s; 0 for P on velocity.
        position_bandwidth: k_p, 1/s.
        velocity_feedforward: phi, share of the commanded velocity that a position servo adds.
        exact_feedforward: whether the robot adds the torques of its own inertia, but for gravity.
        speed_limit: largest size of w and w_r, rad/s; none when omitted.
        acceleration_limit: a, rad/s^2; none when omitted.
        delay: ticks by which commands arrive late, or a time such as "5 ms", rounded up to ticks.
        watchdog: time without a command after which a velocity servo brakes to rest, s; never when omitted. A
            position servo stands at the last command anyway.
    """

    command: Literal["velocity", "position"]
    rate_hz: Positive = Field(default=1000.0, le=1e7)
    velocity_bandwidth: Limit = 100.0
    integral_rate: Magnitude = 0.0
    position_bandwidth: Limit = 20.0
    velocity_feedforward: float = Field(default=1.0, ge=0.0, le=1.0)
    exact_feedforward: bool = False
    speed_limit: Limit | None = None
    acceleration_limit: Limit | None = None
    delay: Delay = Field(default=0, le=1000)
    watchdog: Positive | None = None

    def per_tick(self, rate_hz: float) -> int:
        """Return the number n of samples in a tick of a control rate, Hz."""
        return max(1, round(self.rate_hz / rate_hz))

    def timing_problems(self, run: Mapping[str, Any]) -> list[FieldError]:
        """Return what is wrong with the rate, given the fields of the run."""
        clock = run.get("clock")
        if clock is None:
            return []
        n, steps = self.per_tick(clock.rate_hz), clock.steps_per_tick
        if not math.isclose(n * clock.rate_hz, self.rate_hz, rel_tol=_WHOLE):
            detail = f"is {self.rate_hz:g} Hz, no multiple of the control rate {clock.rate_hz:g} Hz"
            return [FieldError(f"{detail}; the nearest one is {n * clock.rate_hz:g} Hz", "rate_hz")]
        if steps % n:
            detail = (
                f"is {self.rate_hz:g} Hz, {n} samples a tick, which do not divide its {steps} plant steps"
            )
            return [FieldError(f"{detail}; set clock.steps_per_tick to a multiple of {n}", "rate_hz")]
        return []


SERVOS: Mapping[str, Servo] = {
    f"{robot}-{command}": Servo(command=command, **numbers)
    for robot, kinds, numbers in (
        ("ur", KINDS, {"rate_hz": 500.0, "speed_limit": math.pi}),
        (
            "franka",
            KINDS,
            {
                "rate_hz": 1000.0,
                "speed_limit": (*[2.175] * 4, *[2.61] * 3),
                "acceleration_limit": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
            },
        ),
        ("abb", ("position",), {"rate_hz": 250.0}),
    )
    for command in kinds
}
"""Servos of classes of robots by name, see docs/concepts/commands.md for their sources."""


NamedServo = Annotated[Servo, by_name(SERVOS, "a table of fields")]
"""A servo, or the name of one of SERVOS."""
