"""Topics of a log: samples of one kind of message as arrays, by the field names of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FileReadError
from coop_pin.description.log_table import ArmLog, LogTable
from coop_pin.description.scenario import Scenario

Kind = Literal["JointState", "WrenchStamped", "PoseStamped"]
FIELDS: dict[Kind, dict[str, str]] = {
    "JointState": {"position": "", "velocity": "", "effort": ""},
    "WrenchStamped": {"force": "xyz", "torque": "xyz"},
    "PoseStamped": {"position": "xyz", "orientation": "xyzw"},
}
"""Fields of the messages that are read, with their components; joints have names of their own."""


class Topic(NamedTuple):
    """Samples of a topic.

    Attributes:
        kind: kind of its messages.
        time: stamps, s, shape (n,).
        values: fields of the messages by name, shape (n, k) each; without those that are not logged.
        joints: names of the joints, of joint states.
        frame: frame of the messages.
    """

    kind: Kind
    time: Array
    values: Mapping[str, Array]
    joints: tuple[str, ...] = ()
    frame: str = "world"

    def components(self, field: str) -> tuple[str, ...]:
        """Return the names of the components of a field."""
        return self.joints if self.kind == "JointState" else tuple(FIELDS[self.kind][field])

    def require_numbers(self, name: str, file: Path) -> None:
        """Refuse samples without a number, but in rates and efforts of joints, which need not be logged.

        Args:
            name: name of the topic.
            file: file that has it.

        Raises:
            FileReadError: with column, sample and time of the first one.
        """
        for field in ("position",) if self.kind == "JointState" else FIELDS[self.kind]:
            for row, column in np.argwhere(~np.isfinite(self.values[field]))[:1]:
                raise FileReadError(
                    f"column {name}.{field}.{self.components(field)[column]} has no number in row {row + 1}"
                    f" of the topic, at {self.time[row]:.9g} s; write one there, or leave this sample out",
                    str(file),
                )


def table_of(scenario: Scenario) -> LogTable:
    """Return the table ``log`` of a scenario, or the topics that a record is written with if it has none."""
    if scenario.log is not None:
        return scenario.log
    arms = {
        name: ArmLog(joints=f"/{name}/joint_states", wrench=f"/{name}/wrench") for name in scenario.cell.arms
    }
    return LogTable(arms=arms, desired="/desired_pose")
