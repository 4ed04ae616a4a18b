"""New cell from the names of arms: placed arms, payload, grasps, start, motion, squeeze, and gains."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import as_array, as_number, as_positive, require_type, typed
from coop_pin.base.errors import (
    FieldError,
    InfeasibleMotionError,
    NameNotFoundError,
    OutOfRangeError,
    suggestion,
)
from coop_pin.base.spatial.task_rows import RowsName
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.design.named_arms import RobotFiles, arms_of_robot, named_arms
from coop_pin.design.placing.contacts import Layout, Side, faces_back
from coop_pin.design.placing.drafts import Draft, MotionName, placed_drafts, searches
from coop_pin.design.suggestion import Suggestion, suggest
from coop_pin.feasibility.motion_feasibility import joint_heights, require_rank
from coop_pin.feasibility.reachability import reachability
from coop_pin.model.cell_arm import CellArm

_EDGES = {"box": (0.4, 0.3, 0.2), "bar": (0.8, 0.05, 0.05), "plate": (0.6, 0.4, 0.02)}
"""Edges of a new payload along x, y and z, m."""
_PROPOSE = functools.partial(suggest, poses=41, task_part=0.5)
"""Proposal for a motion that is ours: a forecast is within a factor of two of the run."""
_SIDES: tuple[Side, ...] = ("sides", "ahead", "above")
"""Sides of a payload from which one robot takes it, the first with a common workspace."""
_RATES = (1.0, 2.0, 4.0)
"""Multiples of the rate that are tried for each motion: spare joints of light arms ask for them."""
_NEAREST = 0.05
"""Least distance of a base from the payload's centre, m."""


@typed
def new_cell(
    arms: Sequence[str | Path | Arm],
    payload: str | Payload = "box",
    *,
    mass: float = 2.0,
    size: ArrayLike | None = None,
    grasp: Side | None = None,
    layout: Layout = "facing",
    tips: Sequence[str] = (),
    distance: float | None = None,
    motion: MotionName = "line",
    squeeze: float = 10.0,
    clearance: float = 0.01,
    package_dirs: Iterable[str] = (),
    xacro_args: Mapping[str, str] = MappingProxyType({}),
    srdf: str | Path | None = None,
    locked: Mapping[str, float] = MappingProxyType({}),
    impossible_inertia: str = "refuse",
    name: str = "new-cell",
    progress: Callable[[str], None] | None = None,
) -> Suggestion:
    """Return a scenario of arms that carry a payload, ready to run, and what limits its gains.

    The bases stand upright around the payload, on one ground; those of arms that hang are raised. Each is
    where its arm has the largest margins of torque, joint range and condition number, at the start and a
    tenth of the least reach around it. The motion stays within that range; rate, gains, postures and steps
    are those of ``cp.suggest``. Arms that move in a horizontal plane hold the payload in that plane. Joints
    stay above the ground, and arms, payload and torso apart by the clearance, where they can, and it is told
    where not. Arms of one robot keep their common base, and joints that move several of them are locked. An
    arm of five joints holds by a hinge, whose turn it lacks.

    Args:
        arms: two or more, or one robot with two: names of robots, URDF or xacro files, or arms, whose bases
            are not used.
        payload: "box", "bar" or "plate", homogeneous, or a payload.
        mass: mass of the payload, kg; not used with a Payload.
        size: edges of the payload along x, y and z, m, shape (3,); those of its kind when omitted; not used
            with a Payload.
        grasp: side from which the tools approach: "above", horizontally, "sides", or from where the arm
            stands, "ahead"; when omitted the first with a workspace of these: the sides, ahead for one robot,
            from above.
        layout: bases all around the payload, "facing", or on one side of it, "side-by-side".
        tips: tip of each arm; the link that is named like a tool when omitted. Joints that do not move it are
            locked.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.
        motion: motion of the payload: along a line, on a level circle, or none.
        squeeze: force of each arm towards the others, N; 0 for none.
        clearance: distance that bodies which may not touch keep where they can, m; the cell states it.
        package_dirs: folders that are searched first for the packages of robots.
        xacro_args: arguments of xacro files, and environment variables that they ask for.
        srdf: SRDF file of one robot: its groups name tips, and its states postures.
        locked: joints that do not move, besides those that move no tip, and their angles, rad or m.
        impossible_inertia: "refuse" inertias that no body has, or "repair" them, with a warning.
        name: name of the scenario.
        progress: function that is called with what begins, as text; many arms take half a minute.

    Raises:
        UrdfError: there is no such robot, file or tip, or several links may be the tip; with their names.
        NameNotFoundError: no robot has a joint of those that are locked.
        FieldError: another argument is not among the allowed ones.
        OutOfRangeError: a base would be at the payload's centre.
        InfeasibleMotionError: the cell cannot be: cause "reach" (bases too far away, no common workspace),
            "torque" (the payload is too heavy), "rank", or another one of ``cp.suggest``.
    """
    for argument, value, allowed in (
        ("grasp", grasp or "sides", get_args(Side)),
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
    files = RobotFiles(tuple(package_dirs), dict(xacro_args), dict(locked), impossible_inertia)
    is_robot = len(arms) == 1
    if srdf is not None and not is_robot:
        raise FieldError("is for one robot with two arms; name tips and postures of others", "srdf")
    named, shared = (
        arms_of_robot(arms[0], tips, files, srdf) if is_robot else (named_arms(arms, tips, files), "")
    )
    joints = dict.fromkeys(joint for arm in named.values() for joint in arm.robot.joints)
    if strangers := [joint for joint in locked if joint not in joints]:
        raise NameNotFoundError("joint", strangers[0], joints, "the robots")
    if mobile := [name for name, arm in named.items() if arm.mobile_base]:
        raise FieldError(
            f"{mobile[0]!r} has a mobile base; make the cell without, then add mobile_base", "arms"
        )
    held = _payload(payload, mass, size)
    if is_robot and faces_back([*named.values()]):
        named = dict(zip(named, reversed(named.values()), strict=True))
    shape: Layout = "one-base" if is_robot else layout
    placements = searches(named, held, grasp or "sides", shape)
    is_planar = all(arm.is_planar for arm in placements)
    rows: RowsName = "planar" if is_planar else "full"
    grasps = {arm.name: arm.holds[0].grasp for arm in placements}
    cell = Cell(arms=named, payload=held, grasps=grasps, rows=rows, clearance=clearance)
    try:
        require_rank(cell)
    except InfeasibleMotionError as error:
        advice = (
            "a new cell takes arms of five joints or more, or that move in one horizontal plane: take another"
            " arm, or add the joint that it lacks to its file"
        )
        raise InfeasibleMotionError(error.cause, f"{error.detail}; {advice}") from None
    tell = progress or (lambda _: None)
    tell(f"places of the bases of {len(named)} arms")
    only_one = grasp is not None or is_planar or distance is not None
    sides = (grasp or "sides",) if only_one else _SIDES if is_robot else ("sides", "above")
    hinged = ", ".join(arm.name for arm in placements if arm.is_hinged)
    if hinged and not grasp:  # from above their axes would be one line
        sides = tuple(side for side in sides if side != "above")
    drafts = placed_drafts(cell, shape, sides, distance, name=name, motion=motion, squeeze=squeeze)
    tell(f"gains and steps of the law of {len(named)} arms")
    suggested, remarks = _proposed(drafts)
    scenario = suggested.scenario.override(dict(_rounded(suggested)))
    low = () if is_planar or is_robot else _below_ground(scenario)
    hinges = (
        f"grasps: hinges of {hinged}, which lack a turn; no forecast covers them: run it to see its errors"
    )
    remarks = (*filter(None, [shared, *remarks, hinged and hinges]), *low)
    return dataclasses.replace(suggested, scenario=scenario, changes=(*suggested.changes, *remarks))


def _proposed(drafts: Iterable[Draft]) -> tuple[Suggestion, tuple[str, ...]]:
    """Return the proposal for the first draft that has one, and remarks; raises the error of the last one."""
    errors = list[InfeasibleMotionError]()
    for draft in drafts:
        try:
            suggested, calmed = feasible(draft.scenario, draft.motions, _PROPOSE)
        except InfeasibleMotionError as error:
            errors.append(error)
        else:
            return suggested, (draft.remark, calmed)
    raise errors[-1]


def feasible(
    draft: Scenario, motions: Mapping[str, dict[str, Any]], propose: Callable[[Scenario], Any]
) -> tuple[Any, str]:
    """Return the proposal for the first motion that has one, at the rate or a multiple of it, and a remark.

    Args:
        draft: scenario without a motion.
        motions: motions by their names, each calmer than that before.
        propose: function that returns a proposal for a scenario, or raises.

    Raises:
        InfeasibleMotionError: one that no motion changes, or that of the first: neither it nor rest can be.
    """
    errors, rate = list[InfeasibleMotionError](), draft.clock.rate_hz
    for name, motion in motions.items():
        for factor in _RATES:
            clock = draft.clock.replace(rate_hz=factor * rate)
            changed = draft.replace(motion=motion, clock=clock)
            try:
                suggested = propose(changed)
            except InfeasibleMotionError as error:
                errors.append(error)
                if error.cause != "stability":
                    break
            else:
                words = f"{name}, at {factor * rate:g} Hz" if factor > 1.0 else name
                return suggested, f"motion: {words}, because: {errors[0].detail}" if errors else ""
        if errors[-1].cause in ("torque", "rank", "friction"):
            raise errors[-1]  # which no other motion changes
    raise errors[0]


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
        grasp = cell.grasps[name]
        yield f"cell.grasps.{name}", grasp.by_axis() | grasp.model_dump(include={"kind", "axis"})


def _payload(payload: str | Payload, mass: float, size: ArrayLike | None) -> Payload:
    """Return a payload, or the homogeneous box of a kind."""
    if isinstance(payload, Payload):
        return payload
    if payload not in _EDGES:
        raise FieldError(f"is {payload!r}; {suggestion(str(payload), list(_EDGES))}", "payload")
    edges = _EDGES[payload] if size is None else as_array("size", size, 3).tolist()
    return Payload.box(mass, edges)
