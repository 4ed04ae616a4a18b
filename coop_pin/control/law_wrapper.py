"""Wrappers of laws: a controller around a controller of the same arms, whose measurements it changes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError
from coop_pin.control.controller import ArmCommand, ArmController, CellCommand, CellController
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.messages import Messages, Parts, packed, unpacked


class WrappedState(NamedTuple):
    """Memory of a wrapped law.

    Attributes:
        memory: Memory of the wrapper.
        law: State of the law; None before ``init``.
    """

    memory: Any
    law: Any


class Exchange(NamedTuple):
    """Messages of a wrapper at a tick, by the names of their parts.

    Attributes:
        sent: Parts of this arm's message.
        received: Messages of all arms that it hears, its own among them as it was sent, by part and sender.
    """

    sent: Parts = MappingProxyType({})
    received: Mapping[str, Messages] = MappingProxyType({})


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
        self, measurement: ArmMeasurement, reference: ArmReference, memory: Any, exchange: Exchange
    ) -> tuple[ArmMeasurement, Any]:
        """Return the measurement for the law, and the memory for the next tick.

        Args:
            measurement: Measurement, with the messages of the law.
            reference: Reference.
            memory: Memory of the wrapper.
            exchange: Messages of the wrapper.
        """

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> WrappedState:
        """Return the memory at t_0 and the law's state there; raises as the law."""
        state = WrappedState(self.start(measurement, reference), None)
        inner, _ = self.received(measurement, reference, state)
        return state._replace(law=self.law.init(inner, reference))

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState) -> ArmCommand:
        """Return the command of the law, and the next state; raises as the law."""
        inner, memory = self.received(measurement, reference, state)
        command = self.law.step(inner, reference, state.law)
        return replace(command, state=WrappedState(memory, command.state))

    def message(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState | None
    ) -> Array:
        """Return this arm's message: the parts of the wrapper, then the message of the law, shape (w,)."""
        state = WrappedState(self.start(measurement, reference), None) if state is None else state
        parts = self.sent(measurement, reference, state)
        return packed(parts, self.law.message(measurement, reference, state.law))

    def remarks(self, pose: Array, state: WrappedState) -> list[str]:
        """Return the remarks of the law."""
        return self.law.remarks(pose, state.law)

    def received(
        self, measurement: ArmMeasurement, reference: ArmReference, state: WrappedState
    ) -> tuple[ArmMeasurement, Any]:
        """Return what ``transformed`` makes of a measurement and its messages.

        Raises:
            InvalidStateError: the wrapper sends messages, and there are none.
        """
        exchange = Exchange(self.sent(measurement, reference, state))
        if exchange.sent:
            if measurement.messages is None:
                raise InvalidStateError("the law receives no messages; give the scenario a network")
            received, rest = unpacked(measurement.messages, exchange.sent)
            measurement, exchange = measurement._replace(messages=rest), exchange._replace(received=received)
        return self.transformed(measurement, reference, state.memory, exchange)


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
