"""Motion of a payload as arms on shared joints see it: relative to what carries them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, typed
from coop_pin.base.spatial import exp3, inverse_pose, log3
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.differential_base import Steering
from coop_pin.description.scenario import Scenario
from coop_pin.reference.splines import Waypoint

_POSES = 61
"""Poses of the motion through which the spline of a relative one goes."""
_SAMPLES = 201
"""Instants of the way of a base."""
_STILL = 1e-3
"""Speed below which a base counts as resting, m/s."""


@typed
def seen_by_arms(scenario: Scenario) -> Scenario:
    """Return the scenario whose arms do the same on joints that are held, for analyses; itself without any.

    The motion is X' = D(r)^-1 X_d, of the payload relative to what the shared joints carry when they are at
    their references r: poses at 61 times and a spline through them, where a joint moves. Inertial forces of
    the joints' motion are left out; a lift of 0.2 m/s^2 adds 2 % to the weights.

    Bases that roll are parked. Those that follow the payload are as if they went with it on the ground, D =
    its displacement along the ground and about the upright; the turn of each under its arm is left out, and
    ``rolling_course`` has it. Where bases have ways of their own, D is that of the first of these.

    Args:
        scenario: Scenario of a cell with shared joints, or with bases that roll.
    """
    cell, motion = scenario.cell, scenario.payload_motion
    if not cell.carriers:
        return scenario
    held = held_cell(cell)
    follows = [joint.follow for joint in cell.shared_joints.values()]
    if all(follow == "hold" for follow in (*follows, *(base.follow for base in cell.wheels.values()))):
        return scenario.replace(cell=held)
    points = list[Waypoint]()
    for time in np.linspace(0.0, scenario.duration, _POSES).tolist():
        X = inverse_pose(displacement(scenario, time)) @ motion.at(time).X_WP_d
        points.append(Waypoint(time=time, **dict(scenario.start.from_matrix(X))))
    return scenario.replace(cell=held, motion={"kind": "waypoints", "points": points})


def held_cell(cell: Cell) -> Cell:
    """Return a cell whose shared joints are held and whose bases are parked."""
    parked = {
        name: arm.replace(mobile_base=arm.wheels.replace(follow="parked"))
        for name, arm in cell.arms.items()
        if arm.wheels is not None
    }
    return cell.replace(shared_joints={}, arms={**cell.arms, **parked})


def displacement(scenario: Scenario, time: float, arm: str = "") -> Array:
    """Return D, by which what carries the arms has moved them at a time, s, shape (4, 4).

    Of bases that roll it is that of the first with a way of its own, a steering or a stated place, else of
    the first that follows the payload, or that of a named arm.
    """
    cell = scenario.cell
    if cell.carrier is not None:
        return cell.carrier.displacement(shared_positions(scenario, time))
    moving = {name: base for name, base in cell.wheels.items() if base.follow != "hold"}
    if not moving or (arm and arm not in moving):
        return np.eye(4)
    first = min(moving, key=lambda name: moving[name].follow == "payload")
    name = arm or first
    X_WB, motion, base = cell.arms[name].base.matrix, scenario.payload_motion, moving[name]
    way, begin = motion.at(time), motion.at(0.0).X_WP_d
    if isinstance(base.follow, Steering):
        yaw = base.steered(base.follow)[1] * base.follow.profile(time)[1]
    else:
        turned = X_WB[:3, :3].T @ way.X_WP_d[:3, :3] @ begin[:3, :3].T @ X_WB[:3, :3]
        yaw = np.arctan2(turned[1, 0], turned[0, 0])
    D = np.eye(4)
    D[:3, :3] = exp3(np.array((0.0, 0.0, yaw)))
    D[:2, 3] = base.reference(time, X_WB, way, begin)[0] - base.ahead * D[:2, 0]
    return np.asarray(X_WB @ D @ inverse_pose(X_WB))


def shared_positions(scenario: Scenario, time: float) -> Array:
    """Return the references r of the joints under the arms of a cell, m or rad, shape (n,).

    Those of a base that rolls are x, y and yaw of the displacement D.

    Args:
        scenario: Scenario; without such joints n is zero.
        time: s.
    """
    cell, carrier, motion = scenario.cell, scenario.cell.carrier, scenario.payload_motion
    if carrier is not None:
        joints = [cell.shared_joints[name] for name in carrier.joints]
        rows, begin = zip(joints, carrier.start, carrier.screws, strict=True), motion.at(0.0).X_WP_d
        target = motion.at(time)
        return np.array([joint.reference(time, start, S, target, begin)[0] for joint, start, S in rows])
    poses = [np.zeros(0)]
    for name, base in cell.wheels.items():
        if base.follow == "hold":
            poses.append(np.zeros(3))
            continue
        X_WB = cell.arms[name].base.matrix
        X = inverse_pose(X_WB) @ displacement(scenario, time) @ X_WB
        poses.append(np.array((*X[:2, 3], np.arctan2(X[1, 0], X[0, 0]))))
    return np.concatenate(poses)


class RollingCourse(NamedTuple):
    """Way of a base that rolls, if the point b under its arm keeps to its reference r.

    Attributes:
        time: s, shape (n,).
        heading: theta, from the start, rad, shape (n,).
        turn: angle by which the base has turned under the payload, rad, shape (n,).
        rates: speed along the heading and turn rate, m/s and rad/s, shape (n, 2).
        off: angle between the heading and the velocity of b, from 0 to pi, rad, shape (n,); 0 at rest.
        side: acceleration across the heading, of the middle of the axle, m/s^2, shape (n,).
    """

    time: Array
    heading: Array
    turn: Array
    rates: Array
    off: Array
    side: Array


def rolling_course(scenario: Scenario, arm: str, samples: int = _SAMPLES) -> RollingCourse:
    """Return the way of the base of an arm: theta' = n . r' / ahead, by Heun's method.

    Args:
        scenario: Scenario of a cell.
        arm: Arm whose base rolls.
        samples: Number n of instants.
    """
    cell, motion = scenario.cell, scenario.payload_motion
    base, X_WB, begin = cell.wheels[arm], cell.arms[arm].base.matrix, motion.at(0.0).X_WP_d
    time = np.linspace(0.0, scenario.duration, samples)
    targets = [motion.at(t) for t in time.tolist()]
    velocity = np.array(
        [base.reference(t, X_WB, way, begin)[1] for t, way in zip(time.tolist(), targets, strict=True)]
    )

    def rates(theta: float, k: int) -> Array:
        e = np.array((np.cos(theta), np.sin(theta)))
        return np.array((e @ velocity[k], (e[0] * velocity[k, 1] - e[1] * velocity[k, 0]) / base.ahead))

    heading, driven = np.zeros(samples), np.zeros((samples, 2))
    for k in range(samples - 1):
        driven[k], step = rates(heading[k], k), time[k + 1] - time[k]
        ahead = rates(heading[k] + step * driven[k, 1], k + 1)
        heading[k + 1] = heading[k] + 0.5 * step * (driven[k, 1] + ahead[1])
    driven[-1] = rates(heading[-1], -1)
    speed = np.linalg.norm(velocity, axis=1)
    across = np.arccos(np.clip(driven[:, 0] / np.maximum(speed, _STILL), -1.0, 1.0))
    Z = X_WB[:3, :3].T
    turned = np.array([log3(Z @ way.X_WP_d[:3, :3] @ begin[:3, :3].T @ Z.T)[2] for way in targets])
    off = np.where(speed > _STILL, across, 0.0)
    return RollingCourse(time, heading, heading - np.unwrap(turned), driven, off, driven[:, 0] * driven[:, 1])
