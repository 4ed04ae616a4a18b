"""Servo of an arm in a run, see coop_pin.description.servo for the equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array, Mask, frozen
from coop_pin.description.servo import Servo
from coop_pin.model.joint_limits import per_joint

_NO_LIMIT = 1e300


class ServoState(NamedTuple):
    """Memory of a servo; arrays are of shape (k,).

    Attributes:
        waiting: commands on their way, the oldest first.
        origin: c[k-1], in the unit of commands.
        command: c[k], likewise.
        elapsed: x, share of the tick at the next sample.
        late: time for which no command has arrived, s.
        reference: r, rad.
        speed: w, rad/s.
        integral: z, N m.
    """

    waiting: tuple[Array, ...]
    origin: Array
    command: Array
    elapsed: float
    late: float
    reference: Array
    speed: Array
    integral: Array


Limited: TypeAlias = tuple[Array, Array, Mask, Array]
"""Torques with what the robot adds, those within the limits, the mask of those cut, and the change."""


class JointServo(NamedTuple):
    """Servo of the drives of an arm; arrays are of shape (k,).

    Attributes:
        command: "velocity" or "position".
        tick: T, s.
        period: h, s.
        inertia: I, kg m^2.
        velocity_bandwidth: k_v, 1/s.
        integral_rate: k_i, 1/s.
        position_bandwidth: k_p, 1/s.
        velocity_feedforward: phi.
        is_exact: whether the robot adds the torques of its own inertia.
        speed_limit: rad/s.
        acceleration_limit: a, rad/s^2.
        watchdog: s.
        delay: an entry for each tick by which commands arrive late.
    """

    command: str
    tick: float
    period: float
    inertia: Array
    velocity_bandwidth: Array
    integral_rate: Array
    position_bandwidth: Array
    velocity_feedforward: float
    is_exact: bool
    speed_limit: Array
    acceleration_limit: Array
    watchdog: float
    delay: tuple[None, ...]

    @classmethod
    def of(cls, servo: Servo, tick: float, inertia: Array, path: str) -> JointServo:
        """Return the servo of an arm.

        Args:
            servo: Description.
            tick: T, s.
            inertia: I, kg m^2, shape (k,).
            path: Path of the description, for errors.

        Raises:
            FieldError: A row of values has another size than k.
        """
        fields = dict(servo)

        def row(name: str) -> Array:
            value = fields[name]
            return per_joint(np.array(_NO_LIMIT if value is None else value), len(inertia), f"{path}.{name}")

        return cls(
            command=servo.command,
            tick=tick,
            period=tick / servo.per_tick(1.0 / tick),
            inertia=inertia,
            velocity_bandwidth=row("velocity_bandwidth"),
            integral_rate=row("integral_rate"),
            position_bandwidth=row("position_bandwidth"),
            velocity_feedforward=servo.velocity_feedforward,
            is_exact=servo.exact_feedforward,
            speed_limit=row("speed_limit"),
            acceleration_limit=row("acceleration_limit"),
            watchdog=_NO_LIMIT if servo.watchdog is None else servo.watchdog,
            delay=(None,) * servo.delay,
        )

    def start(self, q: Array, holding: Array) -> ServoState:
        """Return the state at rest at drive positions, rad, held by torques, N m, shape (k,) both."""
        rest = np.zeros(len(q))
        command = q if self.command == "position" else rest
        return ServoState(tuple(command for _ in self.delay), command, command, 0.0, 0.0, q, rest, holding)

    def received(self, state: ServoState, command: Array, missed: float) -> ServoState:
        """Return the state after the command of a tick, 1.0 if it is missed."""
        sent = np.where(missed, (state.waiting or (state.command,))[-1], command)
        arrived, *waiting = (*state.waiting, sent)
        late = missed * (state.late + self.tick)
        return state._replace(
            waiting=tuple(waiting), origin=state.command, command=arrived, elapsed=0.0, late=late
        )

    def sample(
        self,
        state: ServoState,
        motion: tuple[Array, Array],
        inertial: Callable[[Array], Array],
        limited: Callable[[Array], Limited],
    ) -> tuple[tuple[Array, Array, Array, Mask, Array], ServoState]:
        """Return the arm's entries of Applied until the next sample, and the state.

        Args:
            state: State after the last sample or command.
            motion: q, rad, and v, rad/s, of the drives.
            inertial: Function that returns T^-T (M qddot + C qdot) at accelerations of the drives.
            limited: Function that adds the robot's gravity compensation to torques, and limits them.
        """
        (q, v), h = motion, self.period
        reference, speed = self._reference(state)
        w_r = speed
        if self.command == "position":
            w_r = self.position_bandwidth * (reference - q) + self.velocity_feedforward * speed
            w_r = np.clip(w_r, -self.speed_limit, self.speed_limit)
        push = self.inertia * self.velocity_bandwidth * (w_r - v)
        commanded = push + state.integral
        if self.is_exact:
            commanded = commanded + inertial((speed - state.speed) / h)
        requested, torque, is_cut, change = limited(commanded)
        integral = state.integral + np.where(is_cut, 0.0, h * self.integral_rate * push)
        state = state._replace(
            elapsed=state.elapsed + h / self.tick, reference=reference, speed=speed, integral=integral
        )
        return (frozen(commanded), requested, torque, is_cut, frozen(commanded + change)), state

    def _reference(self, state: ServoState) -> tuple[Array, Array]:
        """Return r and w at a sample."""
        h, a = self.period, self.acceleration_limit
        if self.command == "velocity":
            reference = state.reference
            target = np.where(np.greater(state.late, self.watchdog), 0.0, state.command)
        else:
            reference, way = state.reference + h * state.speed, state.command - state.origin
            error = state.origin + state.elapsed * way - reference
            size = np.abs(error)
            target = way / self.tick + np.sign(error) * np.minimum(size / h, np.sqrt(2.0 * a * size))
        change = np.clip(target, -self.speed_limit, self.speed_limit) - state.speed
        return reference, state.speed + np.clip(change, -a * h, a * h)
