"""Arms from the names and files of robots: tips, locked joints, groups of an SRDF file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from coop_pin.base.errors import FieldError, UrdfError
from coop_pin.description.cell.arm import Arm
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.description.urdf.srdf import Srdf


class RobotFiles(NamedTuple):
    """How the files of robots become arms.

    Attributes:
        package_dirs: folders that are searched first.
        xacro_args: arguments by name.
        locked: joints that do not move, besides those that move no tip, and their angles, rad or m.
        impossible_inertia: treatment of inertias that no body has, a field of the arms.
    """

    package_dirs: tuple[str, ...] = ()
    xacro_args: Mapping[str, str] = MappingProxyType({})
    locked: Mapping[str, float] = MappingProxyType({})
    impossible_inertia: str = "refuse"

    def robot(self, robot: str | Path) -> Robot:
        """Return the kinematics of a robot."""
        file = find_urdf(robot, package_dirs=self.package_dirs, xacro_args=self.xacro_args)
        return Robot(load_checked(file, parts=False))

    def held(self, links: Robot, tip: str, others: Sequence[str] = ()) -> dict[str, float]:
        """Return the locked joints of an arm: those stated, and those that do not move its tip alone."""
        stated = {joint: angle for joint, angle in self.locked.items() if joint in links.joints}
        return links.idle(tip, others) | stated

    def arm(self, robot: str | Path, tip: str, locked: Mapping[str, float]) -> Arm:
        """Return the arm of a robot that ends at a tip."""
        return Arm.from_urdf(robot, tip, **self._asdict() | {"locked": locked})


def named_arms(arms: Sequence[str | Path | Arm], tips: Sequence[str], files: RobotFiles) -> dict[str, Arm]:
    """Return the arms by name: left and right, or numbered."""
    if not arms:
        raise FieldError("has no entries; name two or more arms, or one robot with two", "arms")
    if len(tips) not in (0, len(arms)):
        raise FieldError(
            f"has {len(tips)} entries for {len(arms)} arms; give one for each arm, or none", "tips"
        )
    every = zip(_names(len(arms)), arms, tips or ("",) * len(arms), strict=True)
    return {name: arm if isinstance(arm, Arm) else _arm(arm, tip, name, files) for name, arm, tip in every}


def _arm(robot: str | Path, tip: str, name: str, files: RobotFiles) -> Arm:
    """Return the arm of a robot that ends at a tip; other joints are locked.

    Raises:
        UrdfError: there is no such robot or link, or the tip is not clear; with the candidates.
    """
    try:
        links = files.robot(robot)
    except UrdfError as error:
        raise error.below(f"arms.{name}") from None
    tools = (tip,) if tip else links.tools()
    if len(tools) != 1:
        listed = ", ".join(map(repr, tools))
        raise UrdfError(f"{str(robot)!r} may hold with {listed}; choose one in tips", f"arms.{name}", tools)
    return files.arm(robot, tools[0], files.held(links, tools[0]))


def arms_of_robot(
    robot: str | Path | Arm, tips: Sequence[str], files: RobotFiles, srdf_file: str | Path | None = None
) -> tuple[dict[str, Arm], str]:
    """Return the arms of one robot from left to right, by name, and a remark on joints that move several.

    Joints that move no tip or several are locked at their angles nearest to zero. Left is where arms begin
    along +y, or end where they begin in line. Groups of an SRDF file stand for tips, and its first state
    that has all joints of an arm is its posture.

    Args:
        robot: name or file of the robot.
        tips: links, or groups of the SRDF file.
        files: packages and arguments.
        srdf_file: SRDF file of the robot.

    Raises:
        UrdfError: there is no such robot, or its tips are not clear; with the candidates.
        NameNotFoundError: there is no such link.
        FieldError: the robot is an arm, whose tip is stated.
    """
    if isinstance(robot, Arm):
        raise FieldError("has one entry, an Arm; name two or more arms, or one robot with two", "arms")
    try:
        links = files.robot(robot)
    except UrdfError as error:
        raise error.below("arms.0") from None
    srdf = None if srdf_file is None else Srdf.read(srdf_file)
    tools = tuple(tips) or (links.tools() if srdf is None else srdf.arms(links)) or links.tools()
    if len(tools) < 2 or (len(tools) > 2 and not tips):
        listed = ", ".join(map(repr, tools))
        switches = ", switches of a xacro in xacro_args" if str(robot).endswith(".xacro") else ""
        reason = (
            f"{str(robot)!r} may hold with {listed}; name the tips of its arms in tips{switches}, or two or"
            " more robots"
        )
        raise UrdfError(reason, "arms.0", tools)
    if srdf is not None:
        tools = tuple(srdf.tips.get(tool, tool) for tool in tools)
    locked = {tip: files.held(links, tip, [other for other in tools if other != tip]) for tip in tools}
    movers = {tip: links.movers(tip) for tip in tools}
    alone = {tip: _alone(tip, movers) for tip in tools}
    if idle := [tip for tip, joints in alone.items() if not joints]:
        listed = ", ".join(map(repr, tools))
        reason = f"{str(robot)!r} has no two arms: of {listed}, {idle[0]!r} has no joint that moves it alone"
        raise UrdfError(
            f"{reason}; name the tips of its arms in tips, or two or more robots", "arms.0", tools
        )
    ways = {tip: links.pose(joints[0], {})[1, 3] for tip, joints in alone.items()}
    tools = tuple(sorted(tools, key=lambda tip: (-round(ways[tip], 2), -links.pose(tip, {})[1, 3])))
    arms = {
        name: files.arm(robot, tip, locked[tip]) for name, tip in zip(_names(len(tools)), tools, strict=True)
    }
    if srdf is not None:
        arms = {name: arm.replace(posture=srdf.posture(arm.moving_joints())) for name, arm in arms.items()}
    shared = [joint for joint in links.joints if sum(joint in chain for chain in movers.values()) > 1]
    angles = next(iter(arms.values())).locked
    held = ", ".join(f"{joint} at {angles[joint]:g}" for joint in shared)
    remark = (
        f"no arm moves another: locked {held}; a drive of their own: cell.shared_joints.{shared[0]}"
        if shared
        else ""
    )
    return arms, remark


def _alone(tip: str, movers: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the joints that move a tip and no other one, from the root on."""
    others = {joint for other, joints in movers.items() if other != tip for joint in joints}
    return [joint for joint in movers[tip] if joint not in others]


def _names(count: int) -> list[str]:
    return ["left", "right"] if count == 2 else [f"arm{k + 1}" for k in range(count)]
