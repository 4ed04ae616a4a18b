"""Wrappers of laws: a controller around a controller, whose measurements it changes; one calibrates."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError
from coop_pin.base.spatial import TaskRows, inverse_pose
from coop_pin.control.controller import ArmCommand, ArmController, CellCommand, CellController
from coop_pin.control.measurement import ArmMeasurement, ArmReference, Message, Messages, Outgoing

Parts: TypeAlias = Mapping[str, Array]
"""Numbers of a message by name, in the order in which they are sent."""
Received: TypeAlias = Mapping[str, Messages]
"""Messages of each part, by its name."""


def packed(parts: Parts, rest: Outgoing) -> Outgoing:
    """Return a message of named parts and what follows them: numbers, unless there are no parts."""
    return np.concatenate([*parts.values(), rest]) if parts else rest


def unpacked(messages: Messages, parts: Parts) -> tuple[dict[str, Messages], Messages]:
    """Return the messages of each part by its name, and those of the numbers that follow the parts.

    Args:
        messages: Messages of equal parts.
        parts: Parts of the same sizes.
    """
    by_part, first = dict[str, Messages](), 0
    for name, part in parts.items():
        last = first + len(part)
        by_part[name] = {sender: Message(x[first:last], age) for sender, (x, age) in messages.items()}
        first = last
    return by_part, {sender: Message(x[first:], age) for sender, (x, age) in messages.items()}


class WrappedState(NamedTuple):
    """Memory of a wrapped law.

    Attributes:
        memory: Memory of the wrapper.
        law: State of the law; None before ``init``.
    """

    memory: Any
    law: Any


@dataclass(frozen=True, eq=False)
class LawWrapper(ArmController):
    """A controller around the controller of the same arm, with a memory x and named messages of its own.

    ::

        x(t_0)            = start(measurement)
        measurement', x' = transformed(measurement, x),   tau = law(measurement'),   x <- x'

    The messages of the law follow those of the wrapper.

    Attributes:
        law: Controller of this arm.
    """

    law: ArmController

    @property
    def command_kind(self) -> str:
        """Kind of the law's commands."""
        return self.law.command_kind

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the memory at t_0, also for the messages before it; nothing here."""
        return ()

    def sent(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> Parts:
        """Return the parts of this arm's message before those of the law; none here."""
        return {}

    @abstractmethod
    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Any,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Any]:
        """Return the measurement for the law, and the memory for the next tick.

        Args:
            measurement: Measurement, with the messages of the law.
            reference: Reference.
            memory: Memory of the wrapper.
            sent: Parts of this arm's message.
            received: Messages of all arms that it hears, its own among them as it was sent, of each part.
        """

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> WrappedState:
        """Return the memory at t_0 and the law's state there; raises as the law."""
        state = WrappedState(self.start(measurement, reference), None)
        measurement, _ = self.inner(measurement, reference, state)
        return state._replace(law=self.law.init(measurement, reference))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> ArmCommand:
        """Return the command of the law, and the next state; raises as the law."""
        measurement, memory = self.inner(measurement, reference, state)
        command = self.law.step(measurement, reference, state.law)
        state = WrappedState(memory, command.state)
        return ArmCommand(command.torque, state, command.velocity, command.position)

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState | None
    ) -> Outgoing:
        """Return this arm's message: the parts of the wrapper, then the message of the law, shape (w,)."""
        state = WrappedState(self.start(measurement, reference), None) if state is None else state
        parts = self.sent(measurement, reference, state)
        return packed(parts, self.law.message(measurement, reference, state.law))

    def remarks(self, pose: Array, state: WrappedState) -> list[str]:
        """Return the remarks of the law."""
        return self.law.remarks(pose, state.law)

    def inner(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState
    ) -> tuple[ArmMeasurement, Any]:
        """Return the measurement for the law and the next memory, by ``transformed``.

        Raises:
            InvalidStateError: the wrapper sends messages, and there are none.
        """
        sent, received = self.sent(measurement, reference, state), dict[str, Messages]()
        if sent:
            if measurement.messages is None:
                raise InvalidStateError("the law receives no messages; give the scenario a network")
            received, rest = unpacked(measurement.messages, sent)
            measurement = measurement._replace(messages=rest)
        return self.transformed(measurement, reference, state.memory, sent, received)


@dataclass(frozen=True, eq=False)
class CellLawWrapper(CellController):
    """A controller around a controller of all arms, whose measurements and references it changes.

    Attributes:
        law: Controller of all arms.
    """

    law: CellController

    def transformed(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Sequence[ArmMeasurement], Sequence[ArmReference]]:
        """Return the measurements and references for the law; the same here."""
        return measurements, references

    def commands_of(self, arm: str) -> str:
        """Return the kind of the law's commands to an arm."""
        return self.law.commands_of(arm)

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the first state of the law; raises as the law."""
        return self.law.init(*self.transformed(measurements, references))

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the command and the next state of the law; raises as the law."""
        return self.law.step(*self.transformed(measurements, references), state)

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return the remarks of the law."""
        return self.law.remarks(pose, state)


@dataclass(frozen=True, eq=False)
class ZeroedController(LawWrapper):
    """Law with a payload frame that is corrected by what it was off at the start.

    ::

        X_i <- X_i X_i(t_0)^-1 X_start

    Twist, Jacobian and the arm's own interaction wrench move to that point. A kinematic bias that is fixed in
    the arm's tip vanishes exactly, because X_i = X_WP G with a constant G; one that depends on the posture is
    left with what it changes since the start. Positional rows see no rotation: there the twist stays.

    Attributes:
        rows: the k_0 task rows.
        start_pose: X_start, the agreed pose of the payload at t_0, shape (4, 4).
    """

    rows: TaskRows
    start_pose: Array

    def start(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return X_i^-1 X_start, the agreed payload frame in the one that the arm computes, shape (4, 4)."""
        return inverse_pose(measurement.payload_pose) @ self.start_pose

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState | None
    ) -> Outgoing:
        """Return the message of the law, of the corrected measurement."""
        offset = self.start(measurement, reference) if state is None else state.memory
        return super().message(self._zeroed(measurement, offset), reference, state)

    def transformed(
        self,
        measurement: ArmMeasurement,
        reference: ArmReference,
        memory: Array,
        sent: Parts,
        received: Received,
    ) -> tuple[ArmMeasurement, Array]:
        """Return the corrected measurement, and the same correction."""
        return self._zeroed(measurement, memory), memory

    def _zeroed(self, measurement: ArmMeasurement, offset: Array) -> ArmMeasurement:
        """Return the measurement about the corrected point: V' = A V, J' = A J, F' = A^-T F."""
        X_WP = measurement.payload_pose @ offset
        displacement = X_WP[:3, 3] - measurement.payload_pose[:3, 3]
        A = self.rows.twist_shift(displacement)
        F, carried = measurement.interaction_wrench, measurement.carried_twist
        return measurement._replace(
            payload_pose=X_WP,
            payload_twist=A @ measurement.payload_twist,
            carried_twist=None if carried is None else A @ carried,
            payload_jacobian=A @ measurement.payload_jacobian,
            interaction_wrench=None if F is None else self.rows.twist_shift(-displacement).T @ F,
        )
