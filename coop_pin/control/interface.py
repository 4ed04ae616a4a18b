"""Arms that are controlled one by one, seen as one controller of the cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from coop_pin.control.contract import ArmController, ArmReference, CellController, Command
from coop_pin.control.measurement import ArmMeasurement
from coop_pin.errors import SingularArmError, SingularJacobianError


class Team(CellController):
    """One ArmController for each arm; each sees its own measurement only.

    Attributes:
        controllers: by arm name, in the order of the cell's arms.
    """

    def __init__(self, controllers: Mapping[str, ArmController]) -> None:
        self.controllers = dict(controllers)

    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> tuple[Any, ...]:
        """Return every arm's first state."""
        return tuple(
            self._for_arm(name, controller.init, measurement, reference)
            for (name, controller), measurement, reference in zip(self.controllers.items(), measurements, references, strict=True)
        )

    def step(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: tuple[Any, ...]) -> Command:
        """Return every arm's torque and next state.

        Raises:
            SingularArmError: an arm's Jacobian is singular.
        """
        commands = [
            self._for_arm(name, controller.step, *inputs)
            for (name, controller), *inputs in zip(self.controllers.items(), measurements, references, state, strict=True)
        ]
        return Command([command.torque for command in commands], tuple(command.state for command in commands))

    @staticmethod
    def _for_arm(name: str, function: Any, *inputs: Any) -> Any:
        """Call an arm's controller; a singular Jacobian is reported with the arm's name, which the arm does not know."""
        try:
            return function(*inputs)
        except SingularJacobianError as error:
            raise SingularArmError(name, error.condition, error.time, error.limit) from None
