"""SRDF file of a robot: the tips of its groups, and joint angles of its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Self

from coop_pin.base.errors import UrdfError
from coop_pin.description.urdf.robot import Robot
from coop_pin.description.urdf.xml import number_list, read_document


class Srdf(NamedTuple):
    """What an SRDF file says of the arms of a robot.

    Attributes:
        tips: last link of each group that is a chain, by the group's name; of a group of joints none.
        states: joint angles of each state of a group, rad or m, in the order of the file.
    """

    tips: Mapping[str, str]
    states: tuple[Mapping[str, float], ...]

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Return what a file says.

        Raises:
            UrdfError: there is no such file, or it is no SRDF.
        """
        try:
            root = read_document(Path(path).read_bytes())
        except OSError as error:
            raise UrdfError(f"cannot be read: {error}", "srdf") from None
        tips = {
            str(chain.getparent().get("name")): str(chain.get("tip_link"))
            for chain in root.iterfind("group/chain")
        }
        states = tuple(
            {
                str(joint.get("name")): angles[0]
                for joint in state.iterfind("joint")
                if (angles := number_list(str(joint.get("value")), 1))  # one of a floating joint has several
            }
            for state in root.iterfind("group_state")
        )
        return cls(tips, states)

    def arms(self, robot: Robot) -> tuple[str, ...]:
        """Return the groups of two arms: chains of most joints, of which none contains another."""
        moved = {group: robot.movers(tip) for group, tip in self.tips.items()}
        longest = max(map(len, moved.values()), default=0)
        ends = {moved[group]: group for group in moved if len(moved[group]) == longest}
        return tuple(ends.values()) if len(ends) == 2 else ()

    def posture(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return the angles of the first state that has all of some joints; None without any."""
        for state in self.states:
            if all(joint in state for joint in joints) and any(state[joint] for joint in joints):
                return tuple(state[joint] for joint in joints)
        return None
