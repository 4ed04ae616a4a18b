"""Law that another law is told by: a controller around the controller of the same arm, and its messages."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError
from coop_pin.control.controller import ArmCommand, ArmController, CellCommand, CellController
from coop_pin.control.measurement import ArmMeasurement, ArmReference
from coop_pin.control.messages import Message


@dataclass(frozen=True, eq=False)
class TellingLaw(ArmController):
    """A law that tells another law of the same arm something else than what was measured.

    Its state has that of the other law as ``law``.

    Attributes:
        law: Law of this arm.
    """

    law: ArmController

    @property
    def command_kind(self) -> str:
        """What the law commands."""
        return self.law.command_kind

    def said(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Array:
        """Return what this arm says before what the law says, shape (n,), as ``message``; nothing here."""
        return np.zeros(0)

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Array:
        """Return what this arm says, then what the law says, shape (n + w,)."""
        said = self.said(measurement, reference, state)
        return np.concatenate((said, self.law.message(measurement, reference, self.law_state(state))))

    def law_state(self, state: Any) -> Any:
        """Return the state of the law; None before there is one."""
        return None if state is None else state.law

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return the sentences of the law."""
        return self.law.remarks(pose, self.law_state(state))


class MemorylessTellingLaw(TellingLaw):
    """A telling law whose state is that of the other law."""

    @abstractmethod
    def seen(self, measurement: ArmMeasurement, reference: ArmReference) -> ArmMeasurement:
        """Return the measurement as the law is told."""

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the first state of the law; raises as the law."""
        return self.law.init(self.seen(measurement, reference), reference)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> ArmCommand:
        """Return the command of the law; raises as the law."""
        return self.law.step(self.seen(measurement, reference), reference, state)

    def law_state(self, state: Any) -> Any:
        """Return the state."""
        return state


@dataclass(frozen=True, eq=False)
class TellingCellLaw(CellController):
    """A law of all arms that tells the laws of the arms something else than what was measured or desired.

    Attributes:
        laws: Laws of the arms.
    """

    laws: CellController

    @abstractmethod
    def seen(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Sequence[ArmMeasurement], Sequence[ArmReference]]:
        """Return measurements and references as the laws are told."""

    def commands_of(self, arm: str) -> str:
        """Return what the law of an arm commands."""
        return self.laws.commands_of(arm)

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the first state of each arm's law; raises as the law."""
        return self.laws.init(*self.seen(measurements, references))

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the command and the next state of each arm; raises as the law."""
        return self.laws.step(*self.seen(measurements, references), state)

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return the sentences of the laws."""
        return self.laws.remarks(pose, state)


def heard(measurement: ArmMeasurement) -> Mapping[str, Message]:
    """Return the messages of a measurement.

    Raises:
        InvalidStateError: there are none.
    """
    if measurement.messages is None:
        raise InvalidStateError("the law hears no messages; give the scenario a network")
    return measurement.messages


def further(measurement: ArmMeasurement, size: int) -> dict[str, Message]:
    """Return the messages of a measurement without their first numbers: those of the law.

    Args:
        measurement: Measurement of the arm.
        size: Number of numbers to leave out.
    """
    return {name: one._replace(numbers=one.numbers[size:]) for name, one in heard(measurement).items()}
