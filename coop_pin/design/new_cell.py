"""New cell from the names of arms: placed arms, payload, grasps, start, motion, squeeze, and gains."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import as_array, as_number, as_positive, require_type, typed
from coop_pin.base.errors import FieldError, InfeasibleMotionError, OutOfRangeError, UrdfError, suggestion
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial.task_rows import RowsName
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.description.urdf import find_urdf, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.design.placement import ArmPlacement, Layout, Side, common_places, contacts
from coop_pin.design.suggestion import Suggestion, suggest
from coop_pin.feasibility.motion_feasibility import joint_heights, require_rank
from coop_pin.feasibility.reachability import reachability
from coop_pin.model.cell_arm import CellArm

MotionName: TypeAlias = Literal["line", "circle", "hold"]
"""Motion of the payload of a new cell."""
_EDGES = {"box": (0.4, 0.3, 0.2), "bar": (0.8, 0.05, 0.05), "plate": (0.6, 0.4, 0.02)}
"""Edges of a new payload along x, y and z, m."""
_POSES = 41
_NEAREST = 0.05
"""Least distance of a base from the payload's centre, m."""


@typed
def new_cell(
    arms: Sequence[str | Path | Arm],
    payload: str | Payload = "box",
    *,
    mass: float = 2.0,
    size: ArrayLike | None = None,
    grasp: Side = "sides",
    layout: Layout = "facing",
    tips: Sequence[str] = (),
    distance: float | None = None,
    motion: MotionName = "line",
    squeeze: float = 10.0,
    package_dirs: Iterable[str] = (),
    xacro_args: Mapping[str, str] = MappingProxyType({}),
    name: str = "new-cell",
    progress: Callable[[str], None] | None = None,
) -> Suggestion:
    """Return a scenario of arms that carry a payload, ready to run, and what limits its gains.

    The bases stand upright around the payload, on one ground. Each is where its arm has the largest margins
    of torque, joint range and condition number, at the start and a tenth of the least reach around it. The
    motion stays within that range; rate, gains, postures and steps are those of ``cp.suggest``. Arms that
    move in a horizontal plane hold the payload in that plane. Joints stay above the ground where they can,
    and it is told where not; other collisions are not considered. Arms of one robot keep their common base,
    and joints that move several of them are locked.

    Args:
        arms: two or more, or one robot with two: names of robots, URDF or xacro files, or arms, whose bases
            are not used.
        payload: "box", "bar" or "plate", homogeneous, or a payload.
        mass: mass of the payload, kg; not used with a Payload.
        size: edges of the payload along x, y and z, m, shape (3,); those of its kind when omitted; not used
            with a Payload.
        grasp: side from which the tools approach: "above", or horizontally, "sides".
        layout: bases all around the payload, "facing", or on one side of it, "side-by-side".
        tips: tip of each arm; the link that is named like a tool when omitted. Joints that do not move it are
            locked.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.
        motion: motion of the payload: along a line, on a level circle, or none.
        squeeze: force of each arm towards the others, N; 0 for none.
        package_dirs: folders that are searched first for the packages of robots.
        xacro_args: arguments of xacro files.
        name: name of the scenario.
        progress: function that is called with what begins, as text; many arms take half a minute.

    Raises:
        UrdfError: there is no such robot, file or tip, or several links may be the tip; with their names.
        FieldError: another argument is not among the allowed ones.
        OutOfRangeError: a base would be at the payload's centre.
        InfeasibleMotionError: the cell cannot be: cause "reach" (bases too far away, no common workspace),
            "torque" (the payload is too heavy), "rank", or another one of ``cp.suggest``.
    """
    for argument, value, allowed in (
        ("grasp", grasp, ("above", "sides")),
        ("layout", layout, ("facing", "side-by-side")),
        ("motion", motion, get_args(MotionName)),
    ):
        if value not in allowed:
            raise FieldError(f"is {value!r}; {suggestion(str(value), allowed)}", argument)
    if distance is not None and (distance := as_positive("distance", distance)) < _NEAREST:
        raise OutOfRangeError("distance", distance, f"at least {_NEAREST} m: bases have a width")
    require_type("arms", arms, list, tuple)
    if as_number("squeeze", squeeze) < 0.0:
        raise OutOfRangeError("squeeze", squeeze, "at least 0 N: each arm pushes towards the others")
    files = _Files(tuple(package_dirs), dict(xacro_args))
    is_robot = len(arms) == 1
    named, shared = _arms_of_robot(arms[0], tips, files) if is_robot else (_arms(arms, tips, files), "")
    if mobile := [name for name, arm in named.items() if arm.mobile_base]:
        raise FieldError(
            f"{mobile[0]!r} has a mobile base; make the cell without, then add mobile_base", "arms"
        )
    held = _payload(payload, mass, size)
    around = contacts(held, len(named), grasp, "one-base" if is_robot else layout)
    placing = [
        ArmPlacement(arm, named[arm], contact, held.mass / len(named))
        for arm, contact in zip(named, around, strict=True)
    ]
    is_planar = all(arm.is_planar for arm in placing)
    rows: RowsName = "planar" if is_planar else "full"
    try:
        require_rank(Cell(arms=named, payload=held, grasps=dict.fromkeys(named, Pose()), rows=rows))
    except InfeasibleMotionError as error:
        command = "coop-pin run five-joint-pair --out five, then edit the arms of five/scenario.toml"
        advice = (
            "a new cell has full rows. To hold a payload with fewer joints start from the catalogue's cell"
        )
        raise InfeasibleMotionError(error.cause, f"{error.detail}; {advice}: {command}") from None
    tell = progress or (lambda _: None)
    tell(f"places of the bases of {len(named)} arms")
    height, stroke, places = common_places(placing, held, distance, one_base=is_robot)
    by_arm = dict(zip(named, places, strict=True))
    start = Pose(xyz=(0.0, 0.0, height))
    robots = ", ".join(dict.fromkeys(Path(arm.urdf).stem for arm in named.values()))
    draft = Scenario.draft(
        name=name,
        summary=f"{robots}: a payload of {held.mass:g} kg",
        cell=Cell(
            arms={
                arm: named[arm].replace(base=arm_placement.base, posture=arm_placement.posture)
                for arm, arm_placement in by_arm.items()
            },
            payload=held,
            grasps={arm: arm_placement.grasp for arm, arm_placement in by_arm.items()},
            rows=rows,
        ),
        controller={"force_path": {"kind": "late"}},
        start=start,
        motion=_motion(motion, start, stroke, 0.0 if is_planar else 0.6 * stroke),
        squeeze={"kind": "tip-force", "force": squeeze},
        duration=8.0,
        clock={"rate_hz": 500.0, "steps_per_tick": 2},
    )
    tell(f"gains and steps of the law of {len(named)} arms")
    suggested = suggest(draft, poses=_POSES)
    scenario = suggested.scenario.override(dict(_rounded(suggested)))
    remarks = (*filter(None, [shared]), *(() if is_planar or is_robot else _below_ground(scenario)))
    return dataclasses.replace(suggested, scenario=scenario, changes=(*suggested.changes, *remarks))


def _motion(kind: MotionName, start: Pose, stroke: float, lift: float) -> dict[str, Any]:
    """Return a motion that goes no farther than half of the stroke in x and y, and the lift in z."""
    if kind == "circle":
        circle = {"radius": round(0.25 * stroke, 4), "angular_rate": 2.0, "start_time": 0.5}
        return {"kind": kind, "pose": start, **circle}
    if kind == "hold":
        return {"kind": kind, "pose": start}
    x, y, z = start.xyz
    goal = Pose(xyz=(x + 0.5 * stroke, y + 0.5 * stroke, round(z + lift, 4)), rpy=(0.0, 0.0, 0.15))
    return {"kind": kind, "start": start, "goal": goal, "start_time": 0.5, "duration": 3.0}


def _below_ground(scenario: Scenario) -> Iterator[str]:
    """Yield the lowest joint of each arm that goes below the ground on which the bases stand."""
    for reach in reachability(scenario, poses=5).arms:
        model = CellArm(scenario.cell, reach.arm)
        z, joint = min((z, joint) for q in reach.q for joint, z in joint_heights(model, q).items())
        if z < 0.0:
            yield (
                f"{reach.arm}: {joint} goes {-z:.2f} m below the ground; raise the payload (start, motion) or"
                " choose another posture"
            )


def _rounded(suggested: Suggestion) -> Iterator[tuple[str, Any]]:
    """Yield postures and grasps with few digits, by their paths: a user edits them."""
    cell = suggested.scenario.cell
    for name, arm in cell.arms.items():
        yield f"cell.arms.{name}.posture", np.round(arm.posture or (), 4)
        yield f"cell.grasps.{name}", cell.grasps[name].by_axis()


class _Files(NamedTuple):
    """Where robots find their packages, and arguments of their xacro files."""

    package_dirs: tuple[str, ...]
    xacro_args: dict[str, str]

    def robot(self, robot: str | Path) -> Robot:
        """Return the kinematics of a robot."""
        return Robot(load_checked(find_urdf(robot, **self._asdict()), parts=False))


def _arms(arms: Sequence[str | Path | Arm], tips: Sequence[str], files: _Files) -> dict[str, Arm]:
    """Return the arms by name: left and right, or numbered."""
    if not arms:
        raise FieldError("has no entries; name two or more arms, or one robot with two", "arms")
    if len(tips) not in (0, len(arms)):
        raise FieldError(
            f"has {len(tips)} entries for {len(arms)} arms; give one for each arm, or none", "tips"
        )
    every = zip(_names(len(arms)), arms, tips or ("",) * len(arms), strict=True)
    return {name: arm if isinstance(arm, Arm) else _arm(arm, tip, name, files) for name, arm, tip in every}


def _arm(robot: str | Path, tip: str, name: str, files: _Files) -> Arm:
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
    return Arm.from_urdf(robot, tools[0], locked=links.idle(tools[0]), **files._asdict())


def _arms_of_robot(robot: str | Path | Arm, tips: Sequence[str], files: _Files) -> tuple[dict[str, Arm], str]:
    """Return the arms of one robot from left to right, by name, and a remark on joints that move several.

    Joints that move no tip or several are locked at their angles nearest to zero. Left is along +y.

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
    tools = tuple(tips) or links.tools()
    if len(tools) < 2 or (len(tools) > 2 and not tips):
        listed = ", ".join(map(repr, tools))
        reason = (
            f"{str(robot)!r} may hold with {listed}; name the tips of its arms in tips, or two or more robots"
        )
        raise UrdfError(reason, "arms.0", tools)
    tools = tuple(sorted(tools, key=lambda tip: -float(links.pose(tip, {})[1, 3])))
    arms = {
        name: Arm.from_urdf(
            robot,
            tip,
            locked=links.idle(tip, [other for other in tools if other != tip]),
            **files._asdict(),
        )
        for name, tip in zip(_names(len(tools)), tools, strict=True)
    }
    movers = [links.movers(tip) for tip in tools]
    shared = [joint for joint in links.joints if sum(joint in chain for chain in movers) > 1]
    angles = next(iter(arms.values())).locked
    locked = ", ".join(f"{joint} at {angles[joint]:g}" for joint in shared)
    return arms, f"one joint cannot move two arms: locked {locked}" if locked else ""


def _names(count: int) -> list[str]:
    return ["left", "right"] if count == 2 else [f"arm{k + 1}" for k in range(count)]


def _payload(payload: str | Payload, mass: float, size: ArrayLike | None) -> Payload:
    """Return a payload, or the homogeneous box of a kind."""
    if isinstance(payload, Payload):
        return payload
    if payload not in _EDGES:
        raise FieldError(f"is {payload!r}; {suggestion(str(payload), list(_EDGES))}", "payload")
    edges = _EDGES[payload] if size is None else as_array("size", size, 3).tolist()
    return Payload.box(mass, edges)
