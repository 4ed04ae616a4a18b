"""Actuation of a run: checks of commands, and the drives that make torques of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, frozen, real_numbers, require_type
from coop_pin.base.errors import ArgumentError, DivergedError, FieldError, ShapeError
from coop_pin.control import CellCommand, CellController
from coop_pin.control.controller import COMMANDS
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.cell_model import ArmPlace
from coop_pin.simulation.devices.drives import Applied, DriveMotion, DriveState, Given, cell_drives
from coop_pin.simulation.devices.servo import ServoState
from coop_pin.simulation.devices.torque_response import SAME
from coop_pin.simulation.plant import Plant

TORQUE_LIMIT = 1e7
"""A larger command counts as diverged, N m, rad/s or rad."""

_LISTS = (list, tuple, np.ndarray)
"""Types of the usual lists of commands, which are told faster than a Sequence."""


class ActuationState(NamedTuple):
    """Memory of the drives of a cell.

    Attributes:
        drives: memory of the drives.
        start: time of the last command, or sample of a servo, s.
        gives: factors of the arms.
    """

    drives: DriveState
    start: float
    gives: Given


class Actuation:
    """Drives of all arms in a run: check a command and make torques of it.

    Attributes:
        drives: the drives.
        state: memory of the drives.
        has_servos: whether an arm takes velocities or positions.
        is_held: whether torques are held between ticks: no lag, no rate limit, no torque lost.
    """

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant,
        slots: Sequence[ArmPlace],
        arms: Sequence[CellArm],
        loads: Array,
    ) -> None:
        """Start from the torques that hold the cell at rest at the plant's configuration.

        Args:
            scenario: Actuators and seed.
            plant: Plant, whose configuration and velocity are read.
            slots: Positions of the arms in q and v.
            arms: Models of the arms.
            loads: Wrench on each arm at rest about P in world axes, shape (m, 6).

        Raises:
            FieldError: the number of rate limits differs from the number of an arm's joints.
        """
        self._plant, self._slots, self._start = plant, slots, 0.0
        self._models, self._names, self._loads = arms, [slot.name for slot in slots], loads
        options = [scenario.actuators_of(name) for name in self._names]
        lost = ([each.torque_lost_at for each in options], [each.commands_lost_at for each in options])
        self._lost_at = [[np.inf if time is None else time for time in times] for times in lost]
        self._has_losses = any(each.lost_at is not None for each in options)
        self.drives = cell_drives(scenario, self._slots, [arm.limits for arm in self._models], self._inertia)
        self.has_servos = any(arm.servo is not None for arm in self.drives.arms)
        self.is_held = self.drives.response is None
        self._paths = [f"{scenario.actuators_path(name)}.servo" for name in self._names]
        self._gives = self.gives(0.0)
        self._sensed = DriveMotion(
            lambda index: self._weight(plant.q, index),
            lambda index: self._motion(plant.q, index),
            lambda *inputs: self._inertial(plant.q, *inputs),
        )
        self.state = DriveState(tuple(self.holding_commands(plant.q)), None)
        if self.has_servos:
            self._start_servos()
        if self.drives.response is not None:
            holding = [
                np.clip(self._holding_torque(index, plant.q), -arm.limit, arm.limit)
                for index, arm in enumerate(self.drives.arms)
            ]
            self.state = self.state._replace(response=self.drives.response.start(np.concatenate(holding)))

    def memory(self) -> ActuationState:
        """Return the memory of the drives."""
        return ActuationState(self.state, self._start, self._gives)

    def restore(self, memory: ActuationState) -> None:
        """Return to a memory."""
        self.state, self._start, self._gives = memory

    def holding_commands(self, q: Array) -> list[Array]:
        """Return the commands that hold the cell at rest, N m, shape (k,) each, read-only.

        Each arm holds its own weight, unless the robot itself does, and its load share of the payload's (what
        its grasp bears at the start, if that is compliant), without internal wrench.

        Args:
            q: Configuration of the cell at rest.
        """
        parts = enumerate(self.carried(q))
        return [frozen(self._holding_torque(index, q) - weight) for index, weight in parts]

    def carried(self, q: Array) -> list[Array]:
        """Return the torques by which robots carry their own weight, N m, shape (k,) each."""
        weights = (self._weight(q, index) for index in range(len(self._slots)))
        return [
            np.zeros_like(weight) if arm.carried is None else arm.carried * weight
            for weight, arm in zip(weights, self.drives.arms, strict=True)
        ]

    def apply(self, time: float, command: CellCommand, missed: Sequence[float]) -> Applied:
        """Return what the actuators make of a command.

        Args:
            time: Time of the tick, s.
            command: Output of the controller.
            missed: Masks, whether each arm misses the tick, 0.0 or 1.0.

        Raises:
            ArgumentError: an arm is not commanded what it takes.
            ShapeError: not one value for each drive of each arm.
            DivergedError: a value is not finite, or beyond 1e7 N m, rad/s or rad.
        """
        commanded = self.commanded(command)
        for index, torque in enumerate(commanded):
            # "not <" also catches NaN; the squares cost a quarter of the largest.
            if (
                not torque.dot(torque) < TORQUE_LIMIT**2
                and not (largest := float(np.abs(torque).max())) < TORQUE_LIMIT
            ):
                takes = self.drives.arms[index].takes
                what = f"{takes} of arm {self._names[index]!r}, {COMMANDS[takes]},"
                raise DivergedError(time, what, largest, TORQUE_LIMIT)
        since, self._start = time - self._start, time
        applied, self.state = self.drives.step(
            self.state,
            commanded,
            missed,
            self._sensed,
            self.gives(time) if self._has_losses or not self.is_held else (),
            since,
        )
        return applied

    def sample(self, due: Sequence[int], time: float) -> list[Array]:
        """Return the torques of each arm after samples of servos within a tick, N m.

        Args:
            due: Arms whose servos sample, by index.
            time: Time, s.
        """
        self._gives, since, self._start = self.gives(time), time - self._start, time
        torques, self.state = self.drives.sample(self.state, due, self._sensed, self._gives, since)
        return torques

    def require_taken(self, controller: CellController) -> None:
        """Refuse a controller that does not command what the arms take.

        Raises:
            FieldError: It does not.
        """
        for name, path, arm in zip(self._names, self._paths, self.drives.arms, strict=True):
            if (commands := controller.commands_of(name)) != arm.takes:
                detail = f"makes arm {name!r} take {arm.takes!r}, but the controller commands {commands!r}"
                raise FieldError(f"{detail}; change one of them", path)

    def torques(self, time: float, duration: float = 0.0) -> list[Array]:
        """Return the mean torques of each arm from a time in the tick over a duration, N m, shape (k,) each.

        No arm loses its torque in between: plant steps end there. Without a duration they are those just
        before the time, which is after the last plant step.
        """
        response, state, s = self.drives.response, self.state.response, time - self._start
        assert response is not None
        assert state is not None
        if not duration:
            return self.drives.acting(response.at(state, s), self._gives)
        self._gives = self.gives(time)
        return self.drives.acting(response.mean(state, s, duration), self._gives)

    def gives(self, time: float) -> Given:
        """Return what the arms give from a time on, s."""
        now = time + SAME * self.drives.period
        return Given(*([float(lost > now) for lost in times] for times in self._lost_at))

    def _holding_torque(self, index: int, q: Array) -> Array:
        """Return T^-T (g(q) - J^T F) with F the arm's part of the load about P, as CellChain.loads, (k,)."""
        slot, model = self._slots[index], self._models[index]
        rest = np.zeros(model.nv)
        tau = model.inverse_dynamics(q[slot.q_slice], rest, rest, self._loads[index])
        return np.asarray(np.linalg.solve(slot.drive.T, tau), dtype=np.float64)

    def _weight(self, q: Array, index: int) -> Array:
        """Return T^-T g(q): the arm's weight at its drives, N m, shape (k,)."""
        slot, model = self._slots[index], self._models[index]
        g = model.nonlinear_effects(q[slot.q_slice], np.zeros(model.nv))
        return np.asarray(np.linalg.solve(slot.drive.T, g), dtype=np.float64)

    def _inertia(self, index: int) -> Array:
        """Return the diagonal of T^-T M T^-1 of an arm alone at the start, kg m^2, shape (k,)."""
        slot = self._slots[index]
        M = self._models[index].mass_matrix(self._plant.q[slot.q_slice])
        return np.diag(slot.from_drive.T @ M @ slot.from_drive).copy()

    def _start_servos(self) -> None:
        """Start the servos at rest."""
        q, holding, servos = self._plant.q, self.state.last, list[ServoState | None]()
        for slot, arm, torque in zip(self._slots, self.drives.arms, holding, strict=True):
            positions = slot.drive @ slot.angles.near(q[slot.q_slice], slot.posture)
            servos.append(None if arm.servo is None else arm.servo.start(positions, torque))
        self.state = self.state._replace(servos=tuple(servos), held=holding)

    def _motion(self, q: Array, index: int) -> tuple[Array, Array]:
        """Return positions (near a servo's reference, else the posture) and velocities of the drives."""
        slot, servos = self._slots[index], self.state.servos
        servo = servos[index] if servos else None
        near = slot.posture if servo is None else slot.from_drive @ servo.reference
        angles = slot.angles.near(q[slot.q_slice], near)
        return slot.drive.dot(angles), slot.drive.dot(self._plant.v[slot.v_slice])

    def _inertial(self, q: Array, index: int, acceleration: Array) -> Array:
        """Return T^-T (M qddot + C qdot) of an arm alone at accelerations of its drives, N m, shape (k,)."""
        slot, model = self._slots[index], self._models[index]
        qddot, v = slot.from_drive @ acceleration, self._plant.v[slot.v_slice]
        tau = model.inverse_dynamics(q[slot.q_slice], v, qddot)
        return np.asarray(slot.from_drive.T @ tau) - self._weight(q, index)

    def torques_of(self, command: CellCommand) -> list[Array]:
        """Return the torques of a command, of which the analyses of a law's damping are made.

        Raises:
            ArgumentError: an arm takes velocities or positions.
            ShapeError: as ``commanded``.
        """
        if self.has_servos:
            servos = {name: arm.takes for name, arm in zip(self._names, self.drives.arms, strict=True)}
            raise ArgumentError(f"this analysis is for laws that command torques, but arms take {servos}")
        return self.commanded(command)

    def commanded(self, command: CellCommand) -> list[Array]:
        """Return the values of a command as arrays.

        Raises:
            ArgumentError: an arm is not commanded what it takes, or values are no real numbers.
            ShapeError: not one value for each drive of each arm.
        """
        # Not list[Array](), which takes ten times as long: at every tick.
        commanded: list[Array] = []
        stated: dict[str, Sequence[Any]] = {}
        m = len(self._names)
        for kind in COMMANDS:
            values = command.of(kind)
            if type(values) not in _LISTS or len(values) not in (0, m):
                name = f"the list of {kind} commands, one for each arm,"
                require_type(name, values, Sequence, np.ndarray)
                if len(values) not in (0, m):
                    raise ShapeError(name, (len(values),), (m,))
            if len(values):
                stated[kind] = values
        for index, (name, arm) in enumerate(zip(self._names, self.drives.arms, strict=True)):
            takes = arm.takes
            if takes not in stated or stated[takes][index] is None:
                raise ArgumentError(f"the command has no {takes} for arm {name!r}, which takes one")
            for kind, values in stated.items():
                if kind != takes and values[index] is not None:
                    raise ArgumentError(f"the command has a {kind} for arm {name!r}, which takes a {takes}")
            value = stated[takes][index]
            if type(value) is not np.ndarray or value.dtype != np.float64:
                value = _real_numbers(f"{takes} of arm {name!r}", value)
            if value.shape != arm.limit.shape:
                raise ShapeError(f"{takes} of arm {name!r}", value.shape, arm.limit.shape)
            commanded.append(value)
        return commanded


def _real_numbers(name: str, values: Any) -> Array:
    """Return values as float64 numbers.

    Raises:
        ArgumentError: they are complex, or no numbers.
    """
    try:
        return real_numbers(name, values).astype(np.float64)
    except ArgumentError:
        raise
    except Exception as error:  # such as that of a tensor with a gradient
        raise ArgumentError(f"{name} cannot be read as an array: {error}") from error
