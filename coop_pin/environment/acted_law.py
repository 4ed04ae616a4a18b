"""Law to whose references and commands an agent adds."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand, CellController
from coop_pin.control.measurement import Outgoing

_FIELDS = {"torque": "torques", "velocity": "velocities", "position": "positions"}


class ActedLaw(CellController):
    """A law with additions, or additions alone: then torques are added to those that hold the start.

    Attributes:
        squeeze: added to the desired internal wrench of each arm, payload axes, task rows, shape (m, k_0).
        commands: added to the commands of each arm, shape (k,) each.
        law: the law; None for none.
        kind: name of what is commanded.
    """

    def __init__(
        self, squeeze: Array, commands: Sequence[Array], law: CellController | None, kind: str = "torque"
    ) -> None:
        self.squeeze, self.commands, self.law, self.kind = squeeze, tuple(commands), law, kind

    @property
    def command_kind(self) -> str:
        """What it commands to every arm."""
        return self.kind

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the law's state; without a law the commands that hold the start."""
        if self.law is not None:
            return self.law.init(measurements, self._with_squeeze(references))
        rest = [np.zeros(len(commands)) for commands in self.commands]
        if self.kind != "torque":
            return tuple(rest)
        return tuple(
            none if arm.holding_torque is None else arm.holding_torque
            for arm, none in zip(measurements, rest, strict=True)
        )

    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return the law's commands with the additions."""
        base, kept = state, state
        if self.law is not None:
            command = self.law.step(measurements, self._with_squeeze(references), state)
            base, kept = command.values, command.state
        values = [value + added for value, added in zip(base, self.commands, strict=True)]
        return CellCommand(state=kept, **{_FIELDS[self.kind]: values})

    def messages(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> list[Outgoing]:
        """Return what the arms of the law tell each other."""
        return (
            [] if self.law is None else self.law.messages(measurements, self._with_squeeze(references), state)
        )

    def _with_squeeze(self, references: Sequence[ArmReference]) -> list[ArmReference]:
        return [
            reference._replace(internal_wrench=reference.internal_wrench + added)
            for reference, added in zip(references, self.squeeze, strict=True)
        ]
