"""Motion of a payload as arms on shared joints see it: relative to what carries them."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import inverse_pose
from coop_pin.description.scenario import Scenario
from coop_pin.reference.splines import Waypoint

_POSES = 61
"""Poses of the motion through which the spline of a relative one goes."""


def seen_by_arms(scenario: Scenario) -> Scenario:
    """Return the scenario whose arms do the same on joints that are held, for analyses; itself without any.

    The motion is X' = D(r)^-1 X_d, of the payload relative to what the shared joints carry when they are at
    their references r: poses at 61 times and a spline through them, where a joint moves. Inertial forces of
    the joints' motion are left out; a lift of 0.2 m/s^2 adds 2 % to the weights.

    Args:
        scenario: Scenario of a cell with shared joints.
    """
    cell, carrier = scenario.cell, scenario.cell.carrier
    if carrier is None:
        return scenario
    held, motion = cell.replace(shared_joints={}), scenario.payload_motion
    if all(joint.follow == "hold" for joint in cell.shared_joints.values()):
        return scenario.replace(cell=held)
    points = list[Waypoint]()
    for time in np.linspace(0.0, scenario.duration, _POSES).tolist():
        X = inverse_pose(carrier.displacement(shared_positions(scenario, time))) @ motion.at(time).X_WP_d
        points.append(Waypoint(time=time, **dict(scenario.start.from_matrix(X))))
    return scenario.replace(cell=held, motion={"kind": "waypoints", "points": points})


def shared_positions(scenario: Scenario, time: float) -> Array:
    """Return the references r of the shared joints of a cell, m or rad, shape (n,).

    Args:
        scenario: Scenario; without shared joints n is zero.
        time: s.
    """
    cell, carrier, motion = scenario.cell, scenario.cell.carrier, scenario.payload_motion
    if carrier is None:
        return np.zeros(0)
    joints = [cell.shared_joints[name] for name in carrier.joints]
    rows, begin = zip(joints, carrier.start, carrier.screws, strict=True), motion.at(0.0).X_WP_d
    target = motion.at(time)
    return np.array([joint.reference(time, start, S, target, begin)[0] for joint, start, S in rows])
