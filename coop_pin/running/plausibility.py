"""Implausible numbers of a scenario: what is likely in a wrong unit, or does not fit together."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array, require_type
from coop_pin.base.errors import InfeasibleMotionError
from coop_pin.base.schema.base import Description
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.schema.pose import Pose
from coop_pin.base.spatial import inverse_pose, pose_error
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.payload import Payload
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility.least_squeeze import with_enough_squeeze
from coop_pin.model.joint_limits import JointLimits
from coop_pin.results.finding import Finding, Kind

_WHOLE_TURN = 2.0 * np.pi
_LARGEST_M = 10.0
"""Positions and sizes beyond it are likely millimetres, m."""
_OFF_START = 0.02
"""Distance and angle between the start and the motion's start that count, m and rad."""
_EPOCH_S = 1e7
"""Times beyond it are likely stamps of a clock, s: a third of a year."""
_SQUEEZE = 10.0
"""Proposed squeeze, N."""
_OUTSIDE_M = 0.01
"""Distance of a tip from the payload's shape that counts: pads and flanges have some, m."""
_SAME = 1e-5
"""Part of a mass that counts as the same."""
_COMPLIANT = {"kind": "compliant", "stiffness": "firm"}


def implausible_numbers(scenario: Scenario) -> tuple[Finding, ...]:
    """Return numbers of a scenario that are likely mistakes, each with the likely unit.

    Angles that look like degrees, positions and sizes beyond 10 m, postures beyond joint limits, a start away
    from the motion's start, a motion that is not within the run, grasps outside the payload's shape, no
    squeeze, a law that does not read the plan of the grasps, and an inertia of another mass.

    Args:
        scenario: scenario that would be run.
    """
    require_type("scenario", scenario, Scenario)
    with np.errstate(over="ignore", invalid="ignore"):  # of lengths of 1e300 m, which are named
        return (
            *_units(scenario, ""),
            *_postures(scenario),
            *_start(scenario),
            *_motion(scenario),
            *_grasps(scenario),
            *_squeeze(scenario),
            *_plan(scenario),
            *_pads(scenario.cell),
            *_inertia(scenario.cell.payload),
        )


def _plan(scenario: Scenario) -> Iterator[Finding]:
    """Yield a law whose arms do not read that one of them holds nothing."""
    law = scenario.controller
    if scenario.has_grasp_plan and not (law.user_code or law.load_transfer.follows_plan):
        diverges = "poses of all arms" in law.needs
        consequence = (
            "the pose of an arm that lets go stays in the mean that all follow, so that the run diverges"
            if diverges
            else "an arm that lets go, or takes hold, goes on with the load share of the cell"
        )
        yield _warning(
            "grasp plan",
            "controller.kind",
            f"the law {law.kind!r} does not read the plan of the grasps: {consequence}; 'payload-space' reads"
            " it",
        )
    if scenario.put_downs and not (law.user_code or law.load_transfer.releases):
        yield _warning(
            "grasp plan",
            "controller",
            f"the law {law.kind!r} does not let go of the load at a put-down, so that its integral presses on"
            " the table: 'payload-space' does with a force_path, gains.anchor_gain and anchor_bias = 'none'",
        )


def _pads(cell: Cell) -> Iterator[Finding]:
    """Yield pads of which a run can tell nothing."""
    rigid = [name for name in cell.arms if name not in cell.unclosed]
    if cell.rows == "planar" and len(rigid) > 1 and (padded := [name for name in cell.pads if name in rigid]):
        yield _warning(
            "pad",
            "cell.pads",
            f"the pads of {padded}: rigid bodies leave the force across the plane open, and with it the"
            " friction that a run uses (NaN); make their grasps compliant",
            {f"cell.grasps.{name}.{field}": value for name in padded for field, value in _COMPLIANT.items()},
        )


def _inertia(payload: Payload) -> Iterator[Finding]:
    """Yield the inertia of a homogeneous body of this shape and another mass: one was changed alone."""
    m, (x, y, z) = payload.mass, payload.size
    bodies = {
        "box": [Payload.box(m, payload.size), *([Payload.bar(m, x, thickness=y)] if y == z else [])],
        "cylinder": [Payload.cylinder(m, x / 2.0, z)],
        "mesh": [],
    }
    for body in bodies[payload.shape]:
        part = float(np.trace(payload.inertia_matrix) / np.trace(body.inertia_matrix))
        is_alike = np.allclose(payload.inertia, part * np.array(body.inertia), atol=0.0)
        if is_alike and abs(part - 1.0) > _SAME and max(payload.size) <= _LARGEST_M:
            sentence = f"cell.payload has {m:g} kg, and the inertia of a homogeneous {payload.shape} of"
            sentence += f" {part * m:.4g} kg: a changed mass does not change it"
            remedy = {"cell.payload.inertia": [*body.inertia]}
            yield Finding("inertia", "cell.payload.inertia", "note", sentence, part * m, m, remedy)


def _units(value: Any, path: str) -> Iterator[Finding]:
    """Yield poses and sizes in a likely wrong unit, in all fields below one."""
    if isinstance(value, Description):
        fields = fields_of(value)
        if isinstance(value, Pose):
            yield from _pose(value, path)
        if max(fields.get("size") or (0.0,)) > _LARGEST_M:
            sentence = f"{path}.size is {_row(fields['size'])} m; is it in mm?"
            yield _warning("unit", f"{path}.size", sentence, {f"{path}.size": _metres(fields["size"])})
    elif isinstance(value, Mapping):
        fields = dict(value)
    elif isinstance(value, tuple):
        fields = {str(index): entry for index, entry in enumerate(value)}
    else:
        return
    for name, entry in fields.items():
        if isinstance(entry, Description | Mapping | tuple):
            yield from _units(entry, f"{path}.{name}".lstrip("."))


def _pose(pose: Pose, path: str) -> Iterator[Finding]:
    if max(map(abs, pose.rpy)) > _WHOLE_TURN:
        rad, field = np.radians(pose.rpy), f"{path}.rpy"
        sentence = f"{field} is {_row(pose.rpy)} rad, beyond a whole turn; are these degrees? Then write"
        yield _warning("unit", field, f"{sentence} {_row(rad)}", {field: rad.tolist()})
    if max(map(abs, pose.xyz)) > _LARGEST_M:
        field, sentence = f"{path}.xyz", f"{path}.xyz is {_row(pose.xyz)} m; is it in mm?"
        yield _warning("unit", field, sentence, {field: _metres(pose.xyz)})


def _postures(scenario: Scenario) -> Iterator[Finding]:
    """Yield postures beyond the limits of their joints."""
    for name, arm in scenario.cell.arms.items():
        limits = JointLimits(arm, name)
        angles = np.array(arm.posture or ())
        if len(angles) != len(limits.lower):
            continue  # without a posture; a wrong number of angles is refused by the model
        beyond = np.flatnonzero((angles < limits.lower - 1e-9) | (angles > limits.upper + 1e-9))
        if beyond.size:
            k, in_degrees = int(beyond[0]), bool(np.abs(angles).max() > _WHOLE_TURN)
            field, unit = f"cell.arms.{name}.posture", " Are these degrees?" if in_degrees else ""
            within = np.clip(np.radians(angles) if in_degrees else angles, limits.lower, limits.upper)
            yield _warning(
                "posture",
                field,
                f"{field} is beyond joint limits ({beyond.size}):"
                f" {limits.joints.names[k]} at {angles[k]:.4g}, allowed {limits.lower[k]:.4g} to"
                f" {limits.upper[k]:.4g} {limits.joints.units[k]}.{unit} The arm starts on another branch",
                {field: within.tolist()},
            )


def _start(scenario: Scenario) -> Iterator[Finding]:
    """Yield a start away from that of a motion from rest: a jump of the reference at the first tick.

    A motion that moves at t = 0 cannot be met from rest at all.
    """
    with contextlib.suppress(Exception):  # a user's motion may fail: the run tells it
        target = scenario.payload_motion.at(0.0)
        if np.any(target.V_WP_d):
            return
        error = pose_error(scenario.start.matrix, np.array(target.X_WP_d))
        linear, angular = (np.linalg.norm(part) for part in (error[:3], error[3:]))
        if max(linear, angular if scenario.cell.controls_turns else 0.0) > _OFF_START:
            begin = Pose.from_matrix(np.array(target.X_WP_d))
            yield _warning(
                "start",
                "start",
                f"start is {1e3 * linear:.3g} mm and {angular:.3g} rad away from the motion's start:"
                " the reference jumps at the first tick. Make start and motion agree",
                {"start.xyz": list(begin.xyz), "start.rpy": list(begin.rpy)},
            )


def _motion(scenario: Scenario) -> Iterator[Finding]:
    """Yield a motion that has not begun, or is not over, by the end of the run, with the likely unit."""
    with contextlib.suppress(Exception):  # a table may be missing: the run tells it
        begin, end = scenario.payload_motion.span
        if begin < scenario.duration and (end <= scenario.duration or end == np.inf):
            return
        state = f"begins at {begin:.6g} s" if begin >= scenario.duration else f"ends at {end:.6g} s"
        sentence = f"the motion {state}, after the end of the run at {scenario.duration:g} s"
        is_stamped = begin > _EPOCH_S or end - begin > _EPOCH_S
        if is_stamped:
            unit = "ns" if end - begin > _EPOCH_S or begin > _EPOCH_S**2 else "s since 1970"
            sentence += f". Are its times in {unit}? Write them in s from the start of the run"
        remedy = {} if is_stamped else {"duration": float(end)}
        finding = _warning("motion", "motion", sentence, remedy)
        yield finding if begin >= scenario.duration or is_stamped else finding._replace(severity="note")


def _grasps(scenario: Scenario) -> Iterator[Finding]:
    """Yield tips outside the payload's shape; of several links, of those that hold the link of P."""
    payload = scenario.cell.payload
    of_P = "" if payload.links is None else payload.links.link
    for name, grasp in scenario.cell.grasps.items():
        if scenario.cell.held_links.get(name, of_P) != of_P:
            continue
        gap = _outside(inverse_pose(payload.shape_pose.matrix) @ (*grasp.xyz, 1.0), payload)
        if gap > _OUTSIDE_M:
            sentence = f"the tip of arm {name!r} is {1e3 * gap:.3g} mm outside the payload's shape"
            yield _warning("grasp frame", f"cell.grasps.{name}", f"{sentence}: see its grasp")


def _outside(point: Array, payload: Any) -> float:
    """Return the distance of a point in the shape's frame from its box or cylinder, m."""
    x, y, z = np.abs(point[:3])
    half = np.array(payload.size) / 2.0
    if payload.shape == "cylinder":
        return float(np.linalg.norm(np.maximum((np.hypot(x, y) - half[0], z - half[2]), 0.0)))
    return float(np.linalg.norm(np.maximum((x, y, z) - half, 0.0)))


def _squeeze(scenario: Scenario) -> Iterator[Finding]:
    """Yield that several arms do not squeeze."""
    with contextlib.suppress(Exception):  # a user's squeeze may fail: the run tells it
        times = np.linspace(0.0, scenario.duration, 5).tolist()
        wrenches = [scenario.squeeze.at(time, scenario.cell.grasps) for time in times]
        holders = len(scenario.cell.arms) - len(scenario.cell.tools)
        if holders == 1 < len(scenario.cell.arms) and np.any(wrenches):
            yield _warning(
                "squeeze", "squeeze", "squeeze: one arm alone holds the payload, and presses nothing"
            )
        if holders > 1 and not np.any(wrenches):
            sentence = "squeeze is zero: the arms do not press the payload, where grasps hold by friction"
            yield _warning("squeeze", "squeeze", sentence, tip_forces(scenario))


def tip_forces(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a squeeze by tip forces, 10 N or what patches need with a margin.

    Args:
        scenario: a scenario without a squeeze.
    """
    force = _SQUEEZE
    with contextlib.suppress(InfeasibleMotionError):
        squeeze: Any = with_enough_squeeze(scenario)[0].squeeze
        force = max(force, float(np.ceil(squeeze.force))) if squeeze.kind == "tip-force" else force
    return {"squeeze.kind": "tip-force", "squeeze.force": force}


def _warning(kind: Kind, field: str, sentence: str, remedy: Mapping[str, Any] | None = None) -> Finding:
    return Finding(kind, field, "warning", sentence, remedy=remedy or {})


def _metres(millimetres: Any) -> list[float]:
    return [length / 1e3 for length in millimetres]


def _row(values: Any) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"
