"""Topics of a log: samples of one kind of message as arrays, by the field names of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

from coop_pin.base.arrays import Array
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


def table_of(scenario: Scenario) -> LogTable:
    """Return the table ``log`` of a scenario, or the topics that a record is written with if it has none."""
    if scenario.log is not None:
        return scenario.log
    arms = {
        name: ArmLog(joints=f"/{name}/joint_states", wrench=f"/{name}/wrench") for name in scenario.cell.arms
    }
    return LogTable(arms=arms, desired="/desired_pose")
