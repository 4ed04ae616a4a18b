"""Feed-forward: stated drive torques that are added to the commands of any law."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, Matrix, Vector, check_arm_names
from coop_pin.control.controller import CellCommand
from coop_pin.control.law_wrapper import CellLawWrapper
from coop_pin.control.measurement import ArmMeasurement, ArmReference, Outgoing


class FeedForward(Description):
    """Torques that are added to the commands of the law, a part of the scenario as the reference is.

    Between two times they are interpolated; before the first there are none, and the last ones stay. Laws
    without a model remain so: whoever wrote the table may have used one (``cp.carry.plan_carry`` does).

    Attributes:
        times: s, strictly increasing.
        torques: torques of the drives of every arm at each time, N m; one row for each time.
    """

    times: Vector
    torques: dict[str, Matrix]

    @model_validator(mode="after")
    def _one_row_for_each_time(self) -> Self:
        if not self.times or not (np.diff(self.times) > 0.0).all():
            raise FieldError("does not increase strictly; give at least one time, sorted", "times")
        for name, rows in self.torques.items():
            if len(rows) != len(self.times) or len({len(row) for row in rows}) != 1:
                detail = f"has {len(rows)} rows for {len(self.times)} times; give one row for each time,"
                raise FieldError(f"{detail} all with one torque for each drive", f"torques.{name}")
        return self

    @cached_property
    def _tables(self) -> list[Array]:
        return [np.array(rows) for rows in self.torques.values()]

    def of(self, arms: Iterable[str]) -> Self:
        """Return the same torques in the order of the cell's arms.

        Raises:
            FieldError: an arm has none, or is not of the cell.
        """
        check_arm_names(self.torques, arms := [*arms], "torques")
        return self.replace(torques={name: self.torques[name] for name in arms})

    def at(self, time: float) -> list[Array]:
        """Return the torques of each arm at a time, s; N m, shape (k,) each."""
        last = len(self.times) - 1
        if time < self.times[0]:
            return [np.zeros(table.shape[1]) for table in self._tables]
        i = min(int(np.searchsorted(self.times, time, side="right")) - 1, max(last - 1, 0))
        if i == last:
            return [table[i] for table in self._tables]
        part = min((time - self.times[i]) / (self.times[i + 1] - self.times[i]), 1.0)
        return [(1.0 - part) * table[i] + part * table[i + 1] for table in self._tables]


class FeedForwardState(NamedTuple):
    """Memory of a law with feed-forward.

    Attributes:
        law: state of the law.
        added: torques that were added to the last command, N m, shape (k,) for each arm.
    """

    law: Any
    added: Sequence[Array]


Added = Callable[[float, Sequence[Array]], Sequence[Array]]
"""Torques to add at a time, s, to commands of the law; N m, shape (k,) for each arm."""


@dataclass(frozen=True, eq=False)
class FeedForwardController(CellLawWrapper):
    """Law of all arms with torques that are added to its commands.

    The torque that is reported to the law is the part of its own command that acted: cuts are its own.

    Attributes:
        added: torques to add.
    """

    added: Added

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> FeedForwardState:
        """Return the state at the first tick; raises as the law."""
        nothing = [np.zeros(len(measured.q)) for measured in measurements]
        return FeedForwardState(self.law.init(measurements, references), nothing)

    def step(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: FeedForwardState,
    ) -> CellCommand:
        """Return the torques of this tick and the state of the next; raises as the law."""
        command = self.law.step(_without(measurements, state.added), references, state.law)
        added = self.added(measurements[0].time, command.torques)
        torques = [torque + more for torque, more in zip(command.torques, added, strict=True)]
        return replace(command, torques=torques, state=FeedForwardState(command.state, added))

    def messages(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: FeedForwardState | None,
    ) -> list[Outgoing]:
        """Return the messages of the law's arms."""
        if state is None:
            return self.law.messages(measurements, references, None)
        return self.law.messages(_without(measurements, state.added), references, state.law)

    def remarks(self, pose: Array, state: FeedForwardState) -> list[str]:
        """Return the remarks of the law."""
        return self.law.remarks(pose, state.law)


def _without(measurements: Sequence[ArmMeasurement], added: Sequence[Array]) -> list[ArmMeasurement]:
    """Return measurements whose reported torques are without the added ones."""
    return [
        each
        if each.reported_torque is None or not more.any()
        else each._replace(reported_torque=each.reported_torque - more)
        for each, more in zip(measurements, added, strict=True)
    ]
