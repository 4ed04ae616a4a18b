"""Path of the payload to a reference and along it: poses, where it rests, turns that nothing controls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, frozen
from coop_pin.base.errors import UnreachablePoseError
from coop_pin.description.scenario import Scenario
from coop_pin.grasps.cell_chain import CellChain

_APPROACH_POSES = 20
_TURN_STEPS, _CLOSED = 30, 1e-9
"""Largest number of Newton steps from pose to pose, and the error that they leave, m or rad."""
_PROBES, _RESTING = 401, 0.1
"""Times at which a reference is looked at, and how dense poses are where it rests."""
_ROUND_OFF = 1e-6
"""Singular values below this part of the largest are redundant rows."""


class PayloadPath(NamedTuple):
    """Path of the payload from the start of a scenario to the beginning of its reference, and along it.

    Attributes:
        times: s, shape (n,); 0 for all poses before the reference.
        poses: X_WP, shape (n, 4, 4).
        twists: V_WP_d, shape (n, 6); zero before the reference.
    """

    times: Array
    poses: Array
    twists: Array


def payload_path(scenario: Scenario, poses: int) -> PayloadPath:
    """Return the path of a scenario: straight to the reference, then along it, denser where it moves."""
    reference = scenario.motion.replace()  # reads a CSV table again
    times = _pose_times(scenario, poses)
    targets = [reference.at(float(time)) for time in times]
    start, begin = pin.SE3(scenario.start.matrix), pin.SE3(np.array(targets[0].X_WP_d))
    approach = [
        pin.SE3.Interpolate(start, begin, float(part)).homogeneous
        for part in np.linspace(0.0, 1.0, _APPROACH_POSES + 1)[:-1]
    ]
    return PayloadPath(
        frozen(np.concatenate((np.zeros(len(approach)), times))),
        frozen(np.stack((*approach, *(target.X_WP_d for target in targets)))),
        frozen(np.concatenate((np.zeros((len(approach), 6)), [target.V_WP_d for target in targets]))),
    )


def _pose_times(scenario: Scenario, poses: int) -> Array:
    """Return times of poses, s: evenly spaced, a tenth as dense where the reference rests."""
    probes, moves = _moving(scenario)
    if np.all(moves):
        return np.linspace(0.0, scenario.duration, poses)
    passed = np.concatenate(([0.0], np.cumsum(np.where(moves, 1.0, _RESTING))))
    return np.interp(np.linspace(0.0, passed[-1], poses), passed, probes)


def time_at_rest(scenario: Scenario) -> float:
    """Return the time from which on the reference rests, s; the duration if it never does."""
    probes, moves = _moving(scenario)
    return float(probes[1:][moves].max(initial=0.0))


def _moving(scenario: Scenario) -> tuple[Array, Array]:
    """Return probed times, s, and whether the reference moves in the intervals between them."""
    motion, probes = scenario.motion.replace(), np.linspace(0.0, scenario.duration, _PROBES)
    poses = np.array([motion.at(time).X_WP_d for time in probes.tolist()])
    return probes, np.abs(np.diff(poses, axis=0)).max(axis=(1, 2)) > 0.0


def with_free_turn(scenario: Scenario, path: PayloadPath) -> PayloadPath:
    """Return a path of a cell on positional rows with the orientations that its closed chain takes.

    Nothing controls them: from pose to pose the joints of all arms move as little as position and closures
    allow. Springs and dampers of a posture are not considered. From a position on that the chain cannot take,
    the orientations are those of the reference, and at the start those of the start.
    """
    chain = CellChain(scenario.cell.rigid)
    model, closures = chain.mechanism.model, chain.mechanism.closures
    try:
        q = chain.configuration(path.poses[0])
    except UnreachablePoseError:
        return path
    poses = path.poses.copy()
    for X_WP in poses[1:]:
        for _ in range(_TURN_STEPS):
            state = closures.state(q, np.zeros(model.nv))
            error = np.concatenate((state.position, chain.payload_pose(q)[:3, 3] - X_WP[:3, 3]))
            if np.abs(error).max() < _CLOSED:
                break
            J = np.concatenate((state.jacobian, chain.payload_jacobian(q)[:3]))
            q = pin.integrate(model, q, -np.linalg.pinv(J, rcond=_ROUND_OFF) @ error)
        else:
            break
        X_WP[:3, :3] = chain.payload_pose(q)[:3, :3]
    return path._replace(poses=frozen(poses))
