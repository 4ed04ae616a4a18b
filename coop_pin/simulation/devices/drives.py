"""Drives: from commanded drive torques to those that act, see description/actuators.py for the equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask, frozen
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_model import ArmPlace
from coop_pin.model.joint_limits import JointLimits
from coop_pin.simulation.devices.servo import JointServo, Limited, ServoState
from coop_pin.simulation.devices.torque_response import ResponseState, TorqueResponse, torque_response

_CLOSE = 1e-6
"""The time of a sample is known to this part of the servo's period."""


class Applied(NamedTuple):
    """Torques at a tick, for each arm, N m, shape (k,); read-only.

    Attributes:
        commanded: torques by the controller, or by the arm's servo.
        requested: torques asked of the drives: the last command that arrived and the robot's gravity
            compensation.
        torques: torques that act at the tick.
        saturated: mask of those that the torque limits cut, or their rate limits over the whole tick.
        reported: parts of the commands that act, see ArmMeasurement.
        servo_commands: velocities or positions by the controller, None for arms without a servo; empty
            without any.
    """

    commanded: Sequence[Array]
    requested: Sequence[Array]
    torques: Sequence[Array]
    saturated: Sequence[Mask]
    reported: Sequence[Array]
    servo_commands: Sequence[Array | None] = ()

    @classmethod
    def at_rest(cls, drives: Sequence[int]) -> Applied:
        """Return what arms with numbers of drives have before the first tick: no torque, and nothing cut."""
        rest = [frozen(np.zeros(count)) for count in drives]
        return cls(rest, rest, rest, [frozen(torque > 0.0) for torque in rest], rest)


class Given(NamedTuple):
    """What the arms give from a time on: 1.0 each, or 0.0 for an arm that has lost it.

    Attributes:
        torques: Torques that act.
        commands: Commands that arrive.
    """

    torques: Sequence[float]
    commands: Sequence[float]


class DriveMotion(NamedTuple):
    """What drives sense of their arms, by the index of an arm.

    Attributes:
        weight: T^-T g(q), N m, shape (k,).
        motion: positions and velocities of the drives, rad and rad/s, shape (k,) each.
        inertial: T^-T (M qddot + C qdot) at accelerations of the drives, N m, shape (k,).
    """

    weight: Callable[[int], Array]
    motion: Callable[[int], tuple[Array, Array]]
    inertial: Callable[[int, Array], Array]


class ArmDrives(NamedTuple):
    """Drives of one arm before lag: missed ticks, gravity compensation, torque limits.

    Attributes:
        limit: torque limits, N m, shape (k,).
        lowest: their negatives.
        carried: 1 + mass_error of the robot's gravity compensation; None without.
        misses: whether ticks may be missed.
        servo: the robot's inner loop; None where it takes torques.
    """

    limit: Array
    lowest: Array
    carried: float | None
    misses: bool
    servo: JointServo | None = None

    @property
    def takes(self) -> str:
        """What it takes as commands: "torque", "velocity" or "position"."""
        return "torque" if self.servo is None else self.servo.command

    def step(
        self, last: Array, command: Array, missed: Any, sensed: DriveMotion, index: int
    ) -> tuple[Array, Array, Mask, Array, Array]:
        """Return the arm's entries of Applied after the first one, and its last command that arrived.

        Args:
            last: Last command that arrived, N m, shape (k,).
            command: Command of this tick, likewise.
            missed: Whether it is missed, a mask.
            sensed: Functions of the drives' arms.
            index: Index of the arm.
        """
        arrived = np.where(missed, last, command) if self.misses else command
        requested, torque, is_cut, change = self.limited(sensed, index, arrived)
        return requested, torque, is_cut, frozen(command + change), arrived if self.misses else last

    def limited(self, sensed: DriveMotion, index: int, torque: Array) -> Limited:
        """Return torques with what the robot adds for gravity, and within the limits.

        Args:
            sensed: Functions of the drives' arms.
            index: Index of the arm.
            torque: Torques by the controller or the servo, N m, shape (k,).
        """
        requested = torque if self.carried is None else torque + self.carried * sensed.weight(index)
        acting = np.minimum(np.maximum(requested, self.lowest), self.limit)
        return requested, acting, frozen(np.not_equal(acting, requested)), acting - requested


class DriveState(NamedTuple):
    """Memory of the drives of a cell.

    Attributes:
        last: last command of each arm that arrived, N m, shape (k,) each.
        response: torques in lag; None if torques are held between ticks.
        servos: memory of each arm's servo, None without one; empty without any.
        held: torques of each arm after its last sample or command, N m; empty without servos.
    """

    last: tuple[Array, ...]
    response: ResponseState | None
    servos: tuple[ServoState | None, ...] = ()
    held: tuple[Array, ...] = ()


class CellDrives(NamedTuple):
    """Drives of all arms, see coop_pin.description.actuators for the equations.

    Attributes:
        arms: drives of each arm before lag.
        response: lag and rate limit of all drives; None if torques are held between ticks.
        period: T, s.
    """

    arms: tuple[ArmDrives, ...]
    response: TorqueResponse | None
    period: float

    def step(
        self,
        state: DriveState,
        commanded: Sequence[Array],
        missed: Sequence[Any],
        sensed: DriveMotion,
        gives: Given | tuple[()],
        s: float,
    ) -> tuple[Applied, DriveState]:
        """Return what the drives make of commands, and the state.

        Args:
            state: State after the tick before.
            commanded: Commands by the controller, shape (k,) each; torques in N m.
            missed: Masks, whether each arm misses the tick, 0.0 or 1.0.
            sensed: Functions of the drives' arms.
            gives: Factors of the arms; empty if none ever loses anything and torques are held.
            s: Time since the tick before, or the last sample of a servo, s.
        """
        entries, servos = [], list(state.servos)
        for index, (arm, command) in enumerate(zip(self.arms, commanded, strict=True)):
            servo = servos[index] if servos else None
            if arm.servo is None or servo is None:
                sent = gives.commands[index] * command if gives else command
                entries.append((command, *arm.step(state.last[index], sent, missed[index], sensed, index)))
            else:
                arrives = (1.0 - missed[index]) * (gives.commands[index] if gives else 1.0)
                servo = arm.servo.received(servo, command, 1.0 - arrives)
                torques, servos[index] = self._sampled(index, servo, sensed)
                entries.append((*torques, state.last[index]))
        *fields, last = zip(*entries, strict=True)
        applied = Applied(*fields)
        if not servos:
            return self._responded(applied, DriveState(last, state.response), gives, s)
        pairs = zip(self.arms, commanded, strict=True)
        by_servos = tuple(None if arm.servo is None else command for arm, command in pairs)
        drives = DriveState(last, state.response, tuple(servos), tuple(applied.torques))
        return self._responded(applied._replace(servo_commands=by_servos), drives, gives, s)

    def _responded(
        self, applied: Applied, state: DriveState, gives: Given | tuple[()], s: float
    ) -> tuple[Applied, DriveState]:
        """Return torques with lag and rate limit, and the state."""
        if self.response is None:
            return applied, state
        assert state.response is not None
        torques, saturated, reported = applied.torques, applied.saturated, applied.reported
        response = self.response.step(state.response, s, np.concatenate(torques))
        limited = self.split(self.response.is_limited(response, self.period))
        left_out = self.response.cut(response, self.period)
        applied = applied._replace(
            torques=self.acting(self.response.at(response, 0.0), gives),
            saturated=[frozen(np.logical_or(*masks)) for masks in zip(saturated, limited, strict=True)],
            reported=[*map(frozen, self.acting(np.concatenate(reported) - left_out, gives))],
        )
        return applied, state._replace(response=response)

    # ------------------------------------------------------------ servos

    def _sampled(
        self, index: int, servo: ServoState, sensed: DriveMotion
    ) -> tuple[tuple[Array, Array, Array, Mask, Array], ServoState]:
        """Return an arm's entries of Applied at a sample of its servo, and the servo's state."""
        arm = self.arms[index]
        assert arm.servo is not None
        limited = partial(arm.limited, sensed, index)
        return arm.servo.sample(servo, sensed.motion(index), partial(sensed.inertial, index), limited)

    def due(self, share: float) -> tuple[int, ...]:
        """Return the arms, by index, whose servos sample after a share of a tick, never at its ends."""
        due = list[int]()
        for index, arm in enumerate(self.arms):
            if arm.servo is not None:
                samples = arm.servo.tick / arm.servo.period
                count = round(share * samples)
                if 0 < count < round(samples) and abs(share * samples - count) < _CLOSE:
                    due.append(index)
        return tuple(due)

    def samples(self) -> list[tuple[int, ...]]:
        """Return the sets of arms whose servos sample together within ticks, each once."""
        counts = {round(arm.servo.tick / arm.servo.period) for arm in self.arms if arm.servo is not None}
        return list(dict.fromkeys(self.due(j / n) for n in sorted(counts) for j in range(1, n)))

    def sample(
        self,
        state: DriveState,
        due: Sequence[int],
        sensed: DriveMotion,
        gives: Given,
        s: float,
    ) -> tuple[list[Array], DriveState]:
        """Return the torques of each arm after samples of servos within a tick, and the state.

        Args:
            state: State after the last sample or command.
            due: Arms whose servos sample, by index.
            sensed: Functions of the drives' arms.
            gives: Factors of the arms.
            s: Time since the last sample or command, s.
        """
        held, servos = list(state.held), list(state.servos)
        for index in due:
            servo = servos[index]
            assert servo is not None
            (_, _, held[index], *_), servos[index] = self._sampled(index, servo, sensed)
        state = state._replace(servos=tuple(servos), held=tuple(held))
        if self.response is None:
            return held, state
        assert state.response is not None
        response = self.response.step(state.response, s, np.concatenate(held))
        return self.acting(self.response.at(response, 0.0), gives), state._replace(response=response)

    def acting(self, torques: Array, gives: Given | tuple[()]) -> list[Array]:
        """Return the torques of each arm, zero where they are lost, of those of all drives."""
        parts = self.split(torques)
        return [factor * part for factor, part in zip(gives.torques, parts, strict=True)] if gives else parts

    def split(self, values: Any) -> list[Any]:
        """Return the part of each arm of the values of all drives."""
        ends = np.cumsum([len(arm.limit) for arm in self.arms])
        return [values[end - len(arm.limit) : end] for arm, end in zip(self.arms, ends, strict=True)]


def cell_drives(
    scenario: Scenario,
    slots: Sequence[ArmPlace],
    limits: Sequence[JointLimits],
    inertia: Callable[[int], Array],
) -> CellDrives:
    """Return the drives of a cell.

    Args:
        scenario: Cell, actuators and clock.
        slots: Positions of the arms in the cell's model.
        limits: Limits of each arm.
        inertia: Inertia of the drives of an arm by its index, kg m^2, shape (k,); asked for servos only.

    Raises:
        FieldError: the number of rate limits, or of values of a servo, is not that of an arm's joints.
    """
    arms = tuple(
        _arm_drives(scenario, slot, limit, partial(inertia, index))
        for index, (slot, limit) in enumerate(zip(slots, limits, strict=True))
    )
    return CellDrives(
        arms, torque_response(scenario, {slot.name: len(slot.drive) for slot in slots}), scenario.clock.period
    )


def _arm_drives(
    scenario: Scenario, slot: ArmPlace, limits: JointLimits, inertia: Callable[[], Array]
) -> ArmDrives:
    """Return the drives of an arm before lag."""
    options = scenario.actuators_of(slot.name)
    robot = options.gravity_compensation
    carried = None if robot is None else 1.0 + robot.mass_error
    servo = None
    if options.servo is not None:
        path = f"{scenario.actuators_path(slot.name)}.servo"
        servo = JointServo.of(options.servo, scenario.clock.period, inertia(), path)
    limit, misses = limits.torque, options.missed_ticks > 0.0
    return ArmDrives(limit, -limit, carried or None, misses, servo)
