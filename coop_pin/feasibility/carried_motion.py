"""Motion of a payload as arms on shared joints see it: relative to what carries them."""

from __future__ import annotations

import numpy as np

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
    joints, motion = [cell.shared_joints[name] for name in carrier.joints], scenario.payload_motion
    held = cell.replace(shared_joints={})
    if all(joint.follow == "hold" for joint in joints):
        return scenario.replace(cell=held)
    points, begin = list[Waypoint](), motion.at(0.0).X_WP_d
    for time in np.linspace(0.0, scenario.duration, _POSES).tolist():
        target = motion.at(time)
        rows = zip(joints, carrier.start, carrier.screws, strict=True)
        angles = [joint.reference(time, start, S, target, begin)[0] for joint, start, S in rows]
        X = inverse_pose(carrier.displacement(np.array(angles))) @ target.X_WP_d
        points.append(Waypoint(time=time, **dict(scenario.start.from_matrix(X))))
    return scenario.replace(cell=held, motion={"kind": "waypoints", "points": points})
