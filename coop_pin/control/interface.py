"""Interface between plant and controller: measurements and references in, commands out.

ControlledArm is what a law may know besides measurements. An ArmController sees one arm, a CellController all
arms; DecentralisedController combines one ArmController for each arm into a CellController. State is a value:
``init`` and ``step`` return it, ``step`` takes it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import SingularJacobianError
from coop_pin.base.spatial.generic_numbers import Traceable
from coop_pin.base.spatial.task_rows import TaskRows


class Message(NamedTuple):
    """Latest message that an arm has heard from a neighbour.

    Attributes:
        numbers: numbers that were said, rounded as they were sent, shape (w,); zero before the first.
        age: ticks since it was said; inf before the first.
    """

    numbers: Array
    age: float


class ArmMeasurement(NamedTuple):
    """Measurement of one arm at one tick, in drive coordinates and task rows; the arrays are read-only.

    The arm has k drives, the cell k_0 task rows.

    Attributes:
        time: t_k, s.
        q: drive coordinates T @ joint angles, rad, shape (k,).
        v: drive velocities T @ joint velocities, rad/s, shape (k,).
        payload_pose: X_WP by this arm's own forward kinematics, shape (4, 4).
        payload_twist: V_WP likewise, in world axes, shape (k_0,).
        payload_jacobian: J_phi with V_WP = J_phi v, shape (k_0, k).
        internal_wrench: measured internal wrench on this arm about P in world axes, shape (k_0,); None
            when the scenario's force path provides none.
        saturated: mask of the drive torques that were cut at their limits over the last tick, shape (k,); all
            false at the first. Of a servo, at the beginning of that tick.
        internal_wrench_age: ticks since ``internal_wrench`` was sampled; inf before the first sample.
        interaction_wrench: this arm's own wrist wrench F_i, on the arm by the payload, about P in world axes
            as its own kinematics see them, shape (k_0,); None without a wrist sensor.
        interaction_wrench_age: ticks since it was sampled; inf before the first sample.
        holding_torque: torque that each drive reports at rest before the controller takes over, N m, shape
            (k,), without the robot's own gravity compensation: as commands they hold the cell; in the first
            measurement only.
        reported_torque: the part of the law's last command that acted, N m, shape (k,), as drives report it:
            the command itself where nothing cut it, without the robot's own gravity compensation and before
            lag. A lost drive reports 0; a missed tick is no cut. Zero in the first measurement; None where
            drives report nothing.
        slip: largest distance that a patch of an arm that holds has slid since then, m; None at the first
            tick and without patches.
        messages: latest message of each arm that this one hears, by name in the order of the cell's arms, its
            own among them as it was sent; None where the scenario has no network, or the law says nothing.
    """

    time: float
    q: Array
    v: Array
    payload_pose: Array
    payload_twist: Array
    payload_jacobian: Array
    internal_wrench: Array | None
    saturated: Mask
    internal_wrench_age: float = np.inf
    interaction_wrench: Array | None = None
    interaction_wrench_age: float = np.inf
    holding_torque: Array | None = None
    reported_torque: Array | None = None
    slip: float | None = None
    messages: Mapping[str, Message] | None = None


class ArmReference(NamedTuple):
    """Desired motion and internal wrench of one arm at one tick; the arrays are read-only.

    Attributes:
        pose: X_WP_d, shape (4, 4).
        twist: V_WP_d in world axes, task rows, shape (k_0,).
        acceleration: A_WP_d in world axes, task rows, shape (k_0,).
        internal_wrench: f_d of this arm about P in *payload* axes, task rows, N and N m, shape (k_0,).
        load_share: c_i of the agreed plan where grasps open and close; None where it stays that of the arm.
    """

    pose: Array
    twist: Array
    acceleration: Array
    internal_wrench: Array
    load_share: float | None = None

    def share(self, arm: ControlledArm) -> float:
        """Return c_i of an arm: that of the plan, or else the arm's own."""
        return arm.load_share if self.load_share is None else self.load_share


MEASURED = {
    "time": "t_k, s",
    "q": "drive coordinates, rad",
    "v": "drive velocities, rad/s",
    "saturated": "1.0 where the torque was cut at its limit over the last tick, else 0.0",
    "internal_wrench": "internal wrench on this arm about P in world axes, task rows, N and N m",
    "internal_wrench_age": "ticks since it was sampled; INFINITY before the first sample",
    "interaction_wrench": "wrench on this arm by the payload about P in world axes, task rows, N and N m",
    "interaction_wrench_age": "ticks since it was sampled; INFINITY before the first sample",
    "holding_torque": "torques that hold the arm at rest, N m; read at the start only",
    "reported_torque": "part of the last command that acted, N m: the command where nothing cut it",
}
DESIRED = {
    "pose": "desired pose of P in the world, row by row",
    "twist": "desired twist of P in world axes, task rows, m/s and rad/s",
    "acceleration": "desired acceleration of P in world axes, task rows",
    "internal_wrench": "desired internal wrench on this arm about P in payload axes, task rows",
}
"""Fields that exported laws are given, and their meaning; pose, twist and Jacobian follow from q and v."""


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


class ControlledArm(NamedTuple):
    """Numbers that a law may know of its arm and cell besides measurements.

    Attributes:
        name: Name of the arm.
        leads: Whether it is the first of the cell's arms.
        rows: The k_0 task rows.
        period: T, s.
        load_share: c.
        drives: Number k of drives.
        posture: Drive angles to which spare joints return, rad, shape (k,); None for continuous joints.
        gravity: Gravity, m/s^2, shape (3,).
        start_pose: X_WP at t_0, shape (4, 4).
        oldest_wrench: Age that measured wrenches reach without being lost, ticks.
        base_drives: Number of its first drives that move a mobile base.
        way_out: Normal of the face on which it holds the payload by friction, out of it in payload axes,
            shape (3,): it starts with the squeeze on. None with another grasp.
    """

    name: str
    leads: bool
    rows: TaskRows
    period: float
    load_share: float
    drives: int
    posture: Array | None
    gravity: Array
    start_pose: Array
    oldest_wrench: int
    base_drives: int = 0
    way_out: Array | None = None

    @property
    def pressed(self) -> bool:
        """Whether it holds the payload by friction."""
        return self.way_out is not None


class SampledWrist(NamedTuple):
    """Timing of a wrist sensor, in ticks.

    Attributes:
        delay: Age of a sample when it arrives.
        every: Ticks from one sample to the next.
    """

    delay: int
    every: int


class CellTiming(NamedTuple):
    """Arms of a cell, and the timing of its wrists and drives, against which a law is checked.

    Attributes:
        arms: Names of the arms.
        rows: Number k_0 of task rows.
        period: T, s.
        wrists: Wrist sensors that the arms have.
        lag: Largest time constant of the arms' drives, ticks.
    """

    arms: Sequence[str]
    rows: int
    period: float = np.nan
    wrists: Collection[SampledWrist] = ()
    lag: float = 0.0


class ArmController(Traceable, ABC):
    """Controller of one arm from its own measurements: the decentralised laws. Immutable.

    Attributes:
        needs: quantities that it uses besides kinematics: "model", "regressor", "own wrench", "internal
            wrench" (made of every wrist's wrench), "wrenches of all arms", "told mass", "poses of all arms",
            "states of all arms", "role", "holding torque" and "start pose", both once.
    """

    needs: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the state at the first tick."""

    @abstractmethod
    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> ArmCommand:
        """Return the command until the next tick, and the state for it."""

    @property
    def command_kind(self) -> str:
        """What it commands: "torque", "velocity" or "position"; a class attribute replaces it."""
        return "torque"

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Array:
        """Return what this arm tells the others at a tick, before any arm steps, shape (w,); nothing here.

        Args:
            measurement: Measurement of the tick, without messages.
            reference: Reference of the tick.
            state: State that ``step`` returned; None once more before ``init``, which hears messages, too.
        """
        return np.zeros(0)

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return sentences on what a state says of a run; none by default.

        Args:
            pose: Desired pose of the payload, shape (4, 4).
            state: State that ``step`` returned.
        """
        return []


class CellController(Traceable, ABC):
    """Controller of all arms from all measurements: the centralised laws.

    Attributes:
        needs: quantities, as of an ArmController.
    """

    needs: ClassVar[tuple[str, ...]] = ()

    @property
    def command_kind(self) -> str:
        """What it commands to every arm, as of an ArmController."""
        return "torque"

    def commands_of(self, arm: str) -> str:
        """Return what it commands to an arm: "torque", "velocity" or "position"."""
        return self.command_kind

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
    ) -> list[Array]:
        """Return what each arm tells the others at a tick; none of a law that sees all arms."""
        return []

    def remarks(self, pose: Array, state: Any) -> list[str]:
        """Return sentences on what a state says of a run, as an ArmController; none by default."""
        return []


class DecentralisedController(CellController):
    """One ArmController for each arm; each sees its own measurement only.

    Attributes:
        controllers: controllers by arm name, in the order of the cell's arms.
    """

    def __init__(self, controllers: Mapping[str, ArmController]) -> None:
        self.controllers = dict(controllers)

    def commands_of(self, arm: str) -> str:
        """Return what the controller of an arm commands."""
        return self.controllers[arm].command_kind

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
        """
        laws = self.controllers.values()
        commands = self._for_arms([law.step for law in laws], measurements, references, state)
        return CellCommand.of_arms(commands)

    def messages(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> list[Array]:
        """Return what each arm tells the others at a tick; see ArmController."""
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
        results = list[Any]()
        try:
            for function, arguments in zip(functions, zip(*inputs, strict=True), strict=True):
                results.append(function(*arguments))
        except SingularJacobianError as error:
            name = list(self.controllers)[len(results)]
            raise SingularJacobianError(error.condition, error.time, error.limit, name) from None
        return results
