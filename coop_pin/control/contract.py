"""The two contracts of controllers: one arm alone, or all arms together. State is a value."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

from coop_pin.arrays import Array
from coop_pin.control.measurement import ArmMeasurement


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
    def step(self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference], state: Any) -> Command:
        """Return one torque for each arm to hold until the next tick, and the state for it."""
