"""Warnings before a run: implausible numbers of a scenario, and what ``coop-pin check`` finds."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, require_type, typed
from coop_pin.base.errors import ArgumentError
from coop_pin.base.memory import free_memory
from coop_pin.base.schema.base import Description
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, pose_error
from coop_pin.description.cell.cell import Cell
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.least_squeeze import least_squeeze
from coop_pin.feasibility.reachability import reachability
from coop_pin.feasibility.statics import start_torques
from coop_pin.feasibility.table_force import table_force
from coop_pin.model.joint_limits import JointLimits
from coop_pin.simulation.simulation import Simulation
from coop_pin.stability.admittance_stability import admittance_stability
from coop_pin.stability.grasp_stability import grasp_stability
from coop_pin.stability.loop_stability import loop_stability
from coop_pin.stability.sampled_stability import start_stability
from coop_pin.stability.step_size import step_stability

_WHOLE_TURN = 2.0 * np.pi
_LARGEST_M = 10.0
"""Positions and sizes beyond it are likely millimetres, m."""
_OFF_START = 0.02
"""Distance and angle between the start and the motion's start that count, m and rad."""
_OUTSIDE_M = 0.01
"""Distance of a tip from the payload's shape that counts: pads and flanges have some, m."""
_LARGE_RECORD = 1e9
"""Memory of a record from which on a run warns of it, bytes."""
_PATH_POSES, _LOOP_POSES = 41, 3
"""Poses at which a run looks for reach, and for stability."""


@typed
def run_warnings(simulation: Simulation) -> Iterator[str]:
    """Yield what makes a run doubtful before it starts, one sentence each: what ``coop-pin check`` tells.

    A record that takes much memory, a squeeze that slips, drives too weak at the start, a path that leaves
    the reach, motion that grows from tick to tick (of an admittance on servos, too), friction in long plant
    steps; ``implausible_numbers`` has
    the rest. What cannot be computed here fails in the run, whose error has its time.

    Args:
        simulation: the run before its first tick; in the end it is as it was.
    """
    scenario, start = simulation.scenario, simulation.state()
    yield from filter(None, [large_record(simulation)])
    with contextlib.suppress(Exception):  # of a user's motion: the run raises it again
        for forces in (least_squeeze(scenario), table_force(scenario)):
            if forces is not None and not forces.ok:
                yield forces.summary().removeprefix("! ")
    with contextlib.suppress(Exception):
        yield from map(str, start_torques(simulation).overloaded)
        path = reachability(scenario, poses=_PATH_POSES)
        yield from (f"arm {arm.arm!r} {problem}" for arm in path.arms for problem in arm.problems())
        reach = reachability(scenario, poses=_LOOP_POSES) if path.ok else None
        stable: list[Any] = [step_stability(simulation, reach)]
        if gains_are_known(scenario) and scenario.cell.unclosed:
            stable.append(grasp_stability(simulation))
        elif gains_are_known(scenario):
            stable += [start_stability(simulation), loop_stability(simulation, reach)]
        elif scenario.has_servos:
            with contextlib.suppress(ArgumentError):  # of another law, or servos that it does not know
                stable.append(admittance_stability(scenario))
        yield from (finding.summary().removeprefix("! ") for finding in stable if not finding.ok)
    simulation.restore(start)


def gains_are_known(scenario: Scenario) -> bool:
    """Return whether analyses of the sampled loop know its gains and grasps.

    Not those of a user's law and of servos, nor of rigid grasps that lay a payload on a table.

    Args:
        scenario: the scenario.
    """
    cell = scenario.cell
    on_tables = bool(cell.tables) and not cell.unclosed
    return not (scenario.controller.user_code or scenario.has_servos or on_tables)


def large_record(simulation: Simulation) -> str:
    """Return what memory the record of a long run takes; "" below 1 GB."""
    memory = simulation.recorder.memory
    if memory < _LARGE_RECORD:
        return ""
    every = simulation.scenario.clock.record_every * math.ceil(memory / _LARGE_RECORD)
    return (
        f"its record takes {1e-9 * memory:.2g} GB of memory of {1e-9 * free_memory():.3g} GB that are free;"
        f" with clock.record_every {every} below 1 GB, and metrics and verdict remain those of all ticks"
    )


def implausible_numbers(scenario: Scenario) -> tuple[str, ...]:
    """Return numbers of a scenario that are likely mistakes, one sentence each with the likely unit.

    Angles that look like degrees, positions and sizes beyond 10 m, postures beyond joint limits, a start away
    from the motion's start, grasps outside the payload's shape, no squeeze, and a law that does not read the
    plan of the grasps.

    Args:
        scenario: scenario that would be run.
    """
    require_type("scenario", scenario, Scenario)
    with np.errstate(over="ignore", invalid="ignore"):  # of lengths of 1e300 m, which are named
        return (
            *_units(scenario, ""),
            *_postures(scenario),
            *_start(scenario),
            *_grasps(scenario),
            *_squeeze(scenario),
            *_plan(scenario),
            *_pads(scenario.cell),
        )


def _plan(scenario: Scenario) -> Iterator[str]:
    """Yield a law whose arms do not read that one of them holds nothing."""
    law = scenario.controller
    if scenario.has_grasp_plan and not (law.user_code or law.load_transfer.follows_plan):
        diverges = "poses of all arms" in law.needs
        consequence = (
            "the pose of an arm that lets go stays in the mean that all follow, so that the run diverges"
            if diverges
            else "an arm that lets go, or takes hold, goes on with the load share of the cell"
        )
        yield (
            f"the law {law.kind!r} does not read the plan of the grasps: {consequence}; 'payload-space' reads"
            " it"
        )
    if scenario.put_downs and not (law.user_code or law.load_transfer.releases):
        yield (
            f"the law {law.kind!r} does not let go of the load at a put-down, so that its integral presses on"
            " the table: 'payload-space' does with a force_path, gains.anchor_gain and anchor_bias = 'none'"
        )


def _pads(cell: Cell) -> Iterator[str]:
    """Yield pads of which a run can tell nothing."""
    rigid = [name for name in cell.arms if name not in cell.unclosed]
    if cell.rows == "planar" and len(rigid) > 1 and (padded := [name for name in cell.pads if name in rigid]):
        yield (
            f"the pads of {padded}: rigid bodies leave the force across the plane open, and with it the"
            " friction that a run uses (NaN); make their grasps compliant"
        )


def _units(value: Any, path: str) -> Iterator[str]:
    """Yield poses and sizes in a likely wrong unit, in all fields below one."""
    if isinstance(value, Description):
        fields = fields_of(value)
        if isinstance(value, Pose):
            yield from _pose(value, path)
        if max(size := fields.get("size") or (0.0,)) > _LARGEST_M:
            yield f"{path}.size is {_row(size)} m; is it in mm?"
    elif isinstance(value, Mapping):
        fields = dict(value)
    elif isinstance(value, tuple):
        fields = {str(index): entry for index, entry in enumerate(value)}
    else:
        return
    for name, entry in fields.items():
        if isinstance(entry, Description | Mapping | tuple):
            yield from _units(entry, f"{path}.{name}".lstrip("."))


def _pose(pose: Pose, path: str) -> Iterator[str]:
    if max(map(abs, pose.rpy)) > _WHOLE_TURN:
        rad = _row(np.radians(pose.rpy))
        yield f"{path}.rpy is {_row(pose.rpy)} rad, beyond a whole turn; are these degrees? Then write {rad}"
    if max(map(abs, pose.xyz)) > _LARGEST_M:
        yield f"{path}.xyz is {_row(pose.xyz)} m; is it in mm?"


def _postures(scenario: Scenario) -> Iterator[str]:
    """Yield postures beyond the limits of their joints."""
    for name, arm in scenario.cell.arms.items():
        limits = JointLimits(arm, name)
        angles = np.array(arm.posture or ())
        if len(angles) != len(limits.lower):
            continue  # without a posture; a wrong number of angles is refused by the model
        beyond = np.flatnonzero((angles < limits.lower - 1e-9) | (angles > limits.upper + 1e-9))
        if beyond.size:
            k, unit = int(beyond[0]), " Are these degrees?" if np.abs(angles).max() > _WHOLE_TURN else ""
            yield (
                f"cell.arms.{name}.posture is beyond joint limits ({beyond.size}):"
                f" {limits.joints.names[k]} at {angles[k]:.4g}, allowed {limits.lower[k]:.4g} to"
                f" {limits.upper[k]:.4g} {limits.joints.units[k]}.{unit} The arm starts on another branch"
            )


def _start(scenario: Scenario) -> Iterator[str]:
    """Yield a start away from that of a motion from rest: a jump of the reference at the first tick.

    A motion that moves at t = 0 cannot be met from rest at all.
    """
    with contextlib.suppress(Exception):  # a user's motion may fail: the run tells it
        target = scenario.motion.replace().at(0.0)
        if np.any(target.V_WP_d):
            return
        error = pose_error(scenario.start.matrix, np.array(target.X_WP_d))
        linear, angular = (np.linalg.norm(part) for part in (error[:3], error[3:]))
        if max(linear, angular if scenario.cell.controls_turns else 0.0) > _OFF_START:
            yield (
                f"start is {1e3 * linear:.3g} mm and {angular:.3g} rad away from the motion's start:"
                " the reference jumps at the first tick. Make start and motion agree"
            )


def _grasps(scenario: Scenario) -> Iterator[str]:
    """Yield tips outside the payload's shape."""
    payload = scenario.cell.payload
    for name, grasp in scenario.cell.grasps.items():
        gap = _outside(inverse_pose(payload.shape_pose.matrix) @ (*grasp.xyz, 1.0), payload)
        if gap > _OUTSIDE_M:
            yield f"the tip of arm {name!r} is {1e3 * gap:.3g} mm outside the payload's shape: see its grasp"


def _outside(point: Array, payload: Any) -> float:
    """Return the distance of a point in the shape's frame from its box or cylinder, m."""
    x, y, z = np.abs(point[:3])
    half = np.array(payload.size) / 2.0
    if payload.shape == "cylinder":
        return float(np.linalg.norm(np.maximum((np.hypot(x, y) - half[0], z - half[2]), 0.0)))
    return float(np.linalg.norm(np.maximum((x, y, z) - half, 0.0)))


def _squeeze(scenario: Scenario) -> Iterator[str]:
    """Yield that several arms do not squeeze."""
    with contextlib.suppress(Exception):  # a user's squeeze may fail: the run tells it
        times = np.linspace(0.0, scenario.duration, 5).tolist()
        wrenches = [scenario.squeeze.at(time, scenario.cell.grasps) for time in times]
        if len(scenario.cell.arms) > 1 and not np.any(wrenches):
            yield (
                "squeeze is zero: the arms do not press the payload. Where grasps hold by friction, add"
                " --squeeze.kind tip-force --squeeze.force 10"
            )


def _row(values: Any) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"
