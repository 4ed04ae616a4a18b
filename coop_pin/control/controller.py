"""Controllers of one arm and of all arms, and their commands: measurements and references in, torques out.

An ArmController has the measurements of one arm, a CellController those of all; a DecentralisedController is
one ArmController for each arm. State is a value: ``init`` and ``step`` return it, ``step`` takes it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import CommandError, SingularJacobianError
from coop_pin.base.spatial.generic_numbers import Traceable
from coop_pin.control.measurement import ArmMeasurement, ArmReference, Outgoing

COMMANDS = {"torque": "N m", "velocity": "rad/s", "position": "rad"}
"""What an arm may take as commands, and the unit for revolute drives."""


@dataclass(frozen=True, eq=False, slots=True)
class ArmCommand:
    """Controller output for one arm: torque, velocity or position of its drives until the next tick.

    A controller gives the one that its ``command_kind`` names; see coop_pin.description.servo for what the
    robot makes of a velocity or a position. It unpacks into that one and the state.

    Attributes:
        torque: drive torques to hold, N m, shape (k,).
        state: the controller's state for the next tick.
        velocity: velocities of the drives to hold, rad/s, shape (k,).
        position: positions of the drives to reach at the next tick, rad, shape (k,).
    """

    torque: Array | None = None
    state: Any = None
    velocity: Array | None = None
    position: Array | None = None

    def __iter__(self) -> Iterator[Any]:
        return iter((self.values, self.state))

    @property
    def values(self) -> Any:
        """The one that is given, shape (k,)."""
        return next(value for value in (self.torque, self.velocity, self.position) if value is not None)


@dataclass(frozen=True, eq=False, slots=True)
class CellCommand:
    """Controller output for a cell: for each arm, in their order, what ArmCommand has for one.

    It unpacks into what is given for each arm and the state.

    Attributes:
        torques: drive torques of each arm to hold until the next tick, N m, shape (k,) each; None for an arm
            that takes something else.
        state: the controller's state for the next tick.
        velocities: velocities likewise, rad/s.
        positions: positions likewise, rad.
    """

    torques: Sequence[Any] = ()
    state: Any = None
    velocities: Sequence[Any] = ()
    positions: Sequence[Any] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter((self.values, self.state))

    @classmethod
    def of_arms(cls, commands: Sequence[ArmCommand]) -> CellCommand:
        """Return the commands of all arms."""
        torques, states = [one.torque for one in commands], tuple([one.state for one in commands])
        for torque in torques:
            if torque is None:
                velocities = [one.velocity for one in commands]
                return cls(torques, states, velocities, [one.position for one in commands])
        return cls(torques, states)

    def of(self, kind: str) -> Sequence[Any]:
        """Return the values of all arms of a kind of COMMANDS."""
        return {"torque": self.torques, "velocity": self.velocities, "position": self.positions}[kind]

    @property
    def values(self) -> list[Any]:
        """What is given for each arm, shape (k,) each."""
        kinds = [values for kind in COMMANDS if len(values := self.of(kind))]
        return [next(value for value in each if value is not None) for each in zip(*kinds, strict=True)]


def require_command(time: float, step: Callable[..., Any], command: Any, kind: type[Any]) -> None:
    """Refuse what a law returns in place of a command.

    Args:
        time: Time of the tick, s.
        step: The law's function.
        command: Result of the function.
        kind: ArmCommand or CellCommand.

    Raises:
        CommandError: the result is no command.
    """
    if not isinstance(command, kind):
        problem = "nothing" if command is None else f"an object of type {type(command).__name__}"
        torques = "torques" if kind is CellCommand else "torque"
        raise CommandError(time, step, problem, f"write: return cp.{kind.__name__}({torques}, state)")


class _AnyController(Traceable, ABC):
    """What controllers of one arm and of all arms answer alike."""

    needs: ClassVar[tuple[str, ...]] = ()

    @property
    def command_kind(self) -> str:
        """What it commands: "torque", "velocity" or "position"; a class attribute replaces it."""
        return "torque"

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return remarks on a run by a state of the law, for people to read; none by default.

        Args:
            pose: Desired pose of the payload, shape (4, 4).
            state: State that ``step`` returned.
        """
        return []


class ArmController(_AnyController):
    """Controller of one arm from its own measurements: the decentralised laws. Immutable.

    Attributes:
        needs: quantities that it uses with kinematics: "model", "regressor", "own wrench", "internal
            wrench" (made of every wrist's wrench), "wrenches of all arms", "learned mass", "poses of all
            arms", "states of all arms", "role", "holding torque" and "start pose", both once.
    """

    @abstractmethod
    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the state at the first tick."""

    @abstractmethod
    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> ArmCommand:
        """Return the command until the next tick, and the state for it."""

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Outgoing:
        """Return the message of this arm to the others, sent before any arm steps, shape (w,); empty here.

        With None, or a SentIf whose condition fails, nothing is sent, and receivers keep the last message.

        Args:
            measurement: Measurement of the tick, without messages.
            reference: Reference of the tick.
            state: State that ``step`` returned; None once more before ``init``, which has messages, too.
        """
        return np.zeros(0)


class CellController(_AnyController):
    """Controller of all arms from all measurements: the centralised laws.

    Attributes:
        needs: quantities, as of an ArmController.
    """

    def commands_of(self, arm: str) -> str:
        """Return what it commands to an arm: "torque", "velocity" or "position"."""
        return self.command_kind

    def step_of(self, arm: str) -> Callable[..., Any]:
        """Return the function that commands an arm."""
        return self.step

    @abstractmethod
    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the state at the first tick."""

    @abstractmethod
    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> CellCommand:
        """Return each arm's command until the next tick, and the state for it."""

    def messages(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> list[Outgoing]:
        """Return the message of each arm to the others; none of a law that has all measurements."""
        return []


class DecentralisedController(CellController):
    """One ArmController for each arm; each sees its own measurement only.

    Attributes:
        controllers: controllers by arm name, in the order of the cell's arms.
    """

    def __init__(self, controllers: Mapping[str, ArmController]) -> None:
        """Take the laws.

        Raises:
            WrongTypeError: they are no mapping of names to laws of one arm.
        """
        require_type("controllers", controllers, Mapping)
        for name, law in controllers.items():
            require_type(f"the controller of {name!r}", law, ArmController)
        self.controllers = dict(controllers)

    def commands_of(self, arm: str) -> str:
        """Return what the controller of an arm commands."""
        return self.controllers[arm].command_kind

    def step_of(self, arm: str) -> Callable[..., Any]:
        """Return the step of the controller of an arm."""
        return self.controllers[arm].step

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Any, ...]:
        """Return the first state of each arm.

        Raises:
            SingularJacobianError: an arm's Jacobian is singular.
        """
        laws = self.controllers.values()
        return tuple(self._for_arms([law.init for law in laws], measurements, references))

    def step(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: tuple[Any, ...],
    ) -> CellCommand:
        """Return the command and the next state of each arm.

        Raises:
            SingularJacobianError: an arm's Jacobian is singular.
            CommandError: an arm's law returns no ArmCommand.
        """
        steps = [law.step for law in self.controllers.values()]
        commands = self._for_arms(steps, measurements, references, state)
        try:
            return CellCommand.of_arms(commands)
        except AttributeError:
            for step, command in zip(steps, commands, strict=True):
                require_command(measurements[0].time, step, command, ArmCommand)
            raise

    def messages(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> list[Outgoing]:
        """Return the message of each arm to the others; see ArmController."""
        laws = self.controllers.values()
        states = [None] * len(laws) if state is None else state
        return [
            law.message(*inputs) for law, *inputs in zip(laws, measurements, references, states, strict=True)
        ]

    def remarks(self, pose: Array, state: tuple[Any, ...]) -> list[str]:
        """Return the sentences of all arms, with their names."""
        pairs = zip(self.controllers.items(), state, strict=True)
        return [f"{name}: {text}" for (name, law), one in pairs for text in law.remarks(pose, one)]

    def _for_arms(self, functions: Sequence[Callable[..., Any]], *inputs: Sequence[Any]) -> list[Any]:
        """Return the results of all arms; errors get the name of the arm, which its controller lacks."""
        results: list[Any] = []
        try:
            for function, arguments in zip(functions, zip(*inputs, strict=True), strict=True):
                results.append(function(*arguments))
        except SingularJacobianError as error:
            name = list(self.controllers)[len(results)]
            raise SingularJacobianError(error.condition, error.time, error.limit, name) from None
        return results
