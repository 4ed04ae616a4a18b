"""Drafts of new cells: placed arms, grasps and motions, and how far bodies are apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.schema.pose import Pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.design.placing.contacts import Layout, Shoulders, Side, contacts
from coop_pin.design.placing.placement import ArmPlacement
from coop_pin.design.placing.workspace import Workspace, common_places
from coop_pin.feasibility.cell_distances import CellDistances
from coop_pin.feasibility.distances import distances, measured
from coop_pin.feasibility.reachability import reachability
from coop_pin.model.cell_arm import CellArm

MotionName: TypeAlias = Literal["line", "circle", "hold"]
"""Motion of the payload of a new cell."""
_WAYS = {"sides": "from the sides", "ahead": "beside it with tools ahead", "above": "from above"}
_POSES = 5
"""Poses along the motion at which distances are looked at."""
_LEFT = 0.1
"""Least margin of a place that is looked at for its distances: a proposal asks for as much of the torque."""
_CLEAR = 3
"""Places with the clearance that are tried."""


class Draft(NamedTuple):
    """Cell whose bases are placed, still without gains.

    Attributes:
        scenario: scenario with the motion that is asked for.
        motions: this motion and calmer ones, by name.
        remark: why the tools do not approach from the first side; empty if they do.
        gap: least distance between bodies along the motion, in the postures of the search, m.
    """

    scenario: Scenario
    motions: dict[str, dict[str, Any]]
    remark: str
    gap: float


def placed_drafts(
    cell: Cell, layout: Layout, sides: Sequence[Side], distance: float | None, **options: Any
) -> Iterator[Draft]:
    """Yield drafts with the clearance, at most three, then that nearest to it and that of the largest margin.

    They come in the order of sides and of margins, each once.

    Args:
        cell: arms, of which the bases are not used, payload and clearance.
        layout: bases around the payload, on one side of it, or one base of one robot.
        sides: sides from which the tools may approach.
        distance: distance of the bases from the payload's centre, m; by the arms' reach when omitted.
        options: name, motion and squeeze of the scenario.

    Raises:
        InfeasibleMotionError: cause "reach": there is no common workspace from any side.
    """
    tried, clear = list[Draft](), list[Draft]()
    for draft in _looked_at(cell, layout, sides, distance, **options):
        tried.append(draft)
        if draft.gap > cell.clearance:
            clear.append(draft)
            yield draft
        if len(clear) == _CLEAR:
            break
    widest = max(tried, key=lambda draft: draft.gap)
    yield from (draft for draft in (widest, tried[0]) if draft not in clear)


def _looked_at(
    cell: Cell, layout: Layout, sides: Sequence[Side], distance: float | None, **options: Any
) -> Iterator[Draft]:
    """Yield the drafts of each side, those of one with the largest margins first; raises as their places.

    A place with little margin is looked at only where it is the first one.
    """
    robot = CellDistances(cell) if layout == "one-base" else None
    has_one, errors, why = False, list[InfeasibleMotionError](), list[str]()
    for side in sides:
        remark = f"grasp: {_WAYS[side]}, because {_WAYS[sides[0]]} {why[0]}" if why else ""
        around = searches(cell.arms, cell.payload, side, layout)
        try:
            for workspace in common_places(around, cell.payload, distance):
                if not has_one or workspace.margin > _LEFT:
                    has_one = True
                    yield _draft(cell, workspace, robot, remark, **options)
            why.append(f"bodies come closer than {1e3 * cell.clearance:g} mm")
        except InfeasibleMotionError as error:
            errors.append(error)
            why.append(error.detail)
    if not has_one:
        raise errors[0]


def _draft(
    cell: Cell,
    workspace: Workspace,
    robot: CellDistances | None,
    remark: str,
    *,
    name: str,
    motion: MotionName,
    squeeze: float,
) -> Draft:
    """Return the draft of a cell in a workspace."""
    height, stroke, places = workspace
    start = Pose(xyz=(0.0, 0.0, height))
    by_arm = dict(zip(cell.arms, places, strict=True))
    motions = calmer_motions(motion, start, stroke, 0.0 if cell.rows == "planar" else 0.6 * stroke)
    stands = {arm: at.base.xyz[2] for arm, at in by_arm.items() if robot is None and cell.rows == "full"}
    raised = ", ".join(f"{arm} by {z:g} m" for arm, z in stands.items() if z > 0.0)
    remark = "; ".join(filter(None, [remark, raised and f"bases RAISED above the ground: {raised}"]))
    robots = ", ".join(dict.fromkeys(Path(arm.urdf).stem for arm in cell.arms.values()))
    scenario = Scenario.draft(
        name=name,
        summary=f"{robots}: a payload of {cell.payload.mass:g} kg",
        cell=cell.replace(
            arms={
                arm: cell.arms[arm].replace(base=at.base, posture=at.posture) for arm, at in by_arm.items()
            },
            grasps={arm: at.grasp for arm, at in by_arm.items()},
        ),
        controller={"force_path": {"kind": "late"}},
        start=start,
        motion=next(iter(motions.values())),
        squeeze={"kind": "tip-force", "force": squeeze},
        duration=8.0,
        clock={"rate_hz": 500.0, "steps_per_tick": 2},
    )
    return Draft(scenario, motions, remark, _gap(scenario, robot))


def _gap(scenario: Scenario, robot: CellDistances | None) -> float:
    """Return the least distance between bodies along the motion, m; infinite without a pair.

    Args:
        scenario: a draft.
        robot: distances of its robot, which stands at the origin there; None of arms with bases of their own.
    """
    reach = reachability(scenario, poses=_POSES)
    if robot is None:
        nearest = distances(scenario, reach).nearest
    else:
        arms = {name: arm.replace(base=Pose()) for name, arm in scenario.cell.arms.items()}
        first = CellArm(scenario.cell.replace(arms=arms), reach.arms[0].arm)
        configurations = [list(q) for q in zip(*(arm.q for arm in reach.arms), strict=False)]
        payload = [first.payload_pose(q[0]) for q in configurations]
        times = reach.arms[0].times[: len(payload)]
        nearest = measured(scenario, robot, times, configurations, payload).nearest
    return np.inf if nearest is None else nearest.distance


def searches(named: Mapping[str, Arm], held: Payload, side: Side, layout: Layout) -> list[ArmPlacement]:
    """Return the search for the place of each arm, with grasps from a side."""
    shoulders = Shoulders.of(named.values()) if layout == "one-base" else None
    around = contacts(held, len(named), side, layout)
    return [
        ArmPlacement(name, arm, contact, held.mass / len(named), shoulders)
        for (name, arm), contact in zip(named.items(), around, strict=True)
    ]


def calmer_motions(kind: MotionName, start: Pose, stroke: float, lift: float) -> dict[str, dict[str, Any]]:
    """Return motions, each calmer than that before, with their names.

    They go no farther than half of the stroke in x and y, and the lift in z.
    """
    rest = {"at rest": {"kind": "hold", "pose": start}}
    if kind == "hold":
        return rest
    if kind == "circle":
        circle = {"kind": kind, "pose": start, "angular_rate": 2.0, "start_time": 0.5}
        parts = {"as asked for": 0.25, "on a circle of half the size": 0.125}
        return {name: circle | {"radius": round(part * stroke, 4)} for name, part in parts.items()} | rest
    x, y, z = start.xyz
    common, lines = {"kind": kind, "start": start, "start_time": 0.5, "duration": 3.0}, {}
    for name, part, turn in (
        ("as asked for", 1.0, 0.15),
        ("without a turn", 1.0, 0.0),
        ("half as far, without a turn", 0.5, 0.0),
        ("a quarter as far, without a turn", 0.25, 0.0),
    ):
        way = 0.5 * part * stroke
        goal = Pose(xyz=(x + way, y + way, round(z + part * lift, 4)), rpy=(0.0, 0.0, turn))
        lines[name] = common | {"goal": goal}
    return lines | rest
