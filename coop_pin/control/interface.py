"""Arms that are controlled one by one, seen as one controller of the cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from coop_pin.arrays import Array, Mask
from coop_pin.errors import SingularJacobianError


class ArmMeasurement(NamedTuple):
    """One arm at one tick, in drive coordinates and the cell's k_0 task rows. The arrays are read-only.

    Attributes:
        time: t_k, s.
        q: drive angles, rad, shape (nq,).
        v: drive rates, rad/s, shape (k,).
        payload_pose: X_WP as this arm's own forward kinematics sees it, shape (4, 4).
        payload_twist: V_WP likewise, in world axes, shape (k_0,).
        payload_jacobian: J_phi with V_WP = J_phi v, shape (k_0, k).
        internal_wrench: measured internal wrench on this arm about P in world axes, shape (k_0,), or None
            where the scenario's force path provides none.
        saturated: which drive torques were cut at their limits over the last tick, shape (k,); all false at
            the first.
    """

    time: float
    q: Array
    v: Array
    payload_pose: Array
    payload_twist: Array
    payload_jacobian: Array
    internal_wrench: Array | None
    saturated: Mask


class ArmReference(NamedTuple):
    """What is desired of one arm at one tick.

    Attributes:
        pose: X_WP_d, shape (4, 4).
        twist: V_WP_d in world axes, task rows, shape (k_0,).
        acceleration: A_WP_d in world axes, task rows, shape (k_0,).
        internal_wrench: f_d of this arm about P in *payload* axes, task rows, N and N m, shape (k_0,).
    """

    pose: Array
    twist: Array
    acceleration: Array
    internal_wrench: Array


class Command(NamedTuple):
    """What a controller answers.

    Attributes:
        torque: drive torques, N m; shape (k,) for one arm, a list of them for a cell.
        state: the controller's state for the next tick.
    """

    torque: Any
    state: Any


class ArmController(ABC):
    """Controls one arm from its own measurements: the decentralised laws. Immutable; state goes in and comes out."""

    @abstractmethod
    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> Any:
        """Return the state at the first tick."""

    @abstractmethod
    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Command:
        """Return the torque to hold until the next tick, and the state for it."""


class CellController(ABC):
    """Controls all arms from all measurements: the centralised and model-based laws."""

    @abstractmethod
    def init(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]) -> Any:
        """Return the state at the first tick."""

    @abstractmethod
    def step(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any
    ) -> Command:
        """Return one torque for each arm to hold until the next tick, and the state for it."""


class DecentralisedController(CellController):
    """One ArmController for each arm; each sees its own measurement only.

    Attributes:
        controllers: by arm name, in the order of the cell's arms.
    """

    def __init__(self, controllers: Mapping[str, ArmController]) -> None:
        self.controllers = dict(controllers)

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Any, ...]:
        """Return every arm's first state."""
        return tuple(
            self._for_arm(name, controller.init, measurement, reference)
            for (name, controller), measurement, reference in zip(
                self.controllers.items(), measurements, references, strict=True
            )
        )

    def step(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: tuple[Any, ...],
    ) -> Command:
        """Return every arm's torque and next state.

        Raises:
            SingularJacobianError: an arm's Jacobian is singular.
        """
        commands = [
            self._for_arm(name, controller.step, *inputs)
            for (name, controller), *inputs in zip(
                self.controllers.items(), measurements, references, state, strict=True
            )
        ]
        return Command([command.torque for command in commands], tuple(command.state for command in commands))

    @staticmethod
    def _for_arm(name: str, function: Any, *inputs: Any) -> Any:
        """Call an arm's controller; a singular Jacobian is reported with the arm's name, which the arm does not know."""
        try:
            return function(*inputs)
        except SingularJacobianError as error:
            raise SingularJacobianError(error.condition, error.time, error.limit, name) from None
