"""Closing the chain: joint angles that bring an arm's tip to its grasp, within the joint limits, near a posture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.chain.ik_solver import IKSolution, IKSolver
from coop_pin.errors import JointLimitError, UnreachablePoseError
from coop_pin.model.arm_model import ArmModel

_NEIGHBOURS = 12
_SEEDS = 16
_BRANCH_SEEDS = 96
_SLIDES = 4
_FIRST_SLIDE = 5
_WHOLE_SLIDE = 60
_SAME_BRANCH = 1e-3
_SAME_DISTANCE = 1e-5


def solve_ik(name: str, arm: ArmModel, X_WP: ArrayLike, posture: ArrayLike | None = None) -> Array:
    """Return joint angles that hold the payload at a pose within the joint limits, nearest to a posture, shape (nq,).

    Levenberg-Marquardt from the posture, from around it, and from seeds spread over the joint ranges. A
    redundant arm then slides along its self-motion to the angles nearest to the posture. Deterministic.

    Args:
        name: the arm, for messages.
        arm: its model, with its grasp.
        X_WP: payload pose, shape (4, 4).
        posture: angles that choose the elbow, one for each joint, shape (nv,), or a configuration, shape
            (nq,); zeros when omitted.

    Raises:
        JointLimitError: only joint limits prevent it; with the joint.
        UnreachablePoseError: with the gap that is left: the least distance found between tip and grasp, and
            the angle left there.
    """
    return _branches(name, arm, X_WP, posture, _SEEDS, _SLIDES)[0]


def ik_branches(name: str, arm: ArmModel, X_WP: ArrayLike, posture: ArrayLike | None = None) -> list[Array]:
    """Return every distinct way found to hold the payload at a pose within the joint limits, the nearest to a posture first.

    Two branches differ by more than whole turns; each is unwound to where it is nearest to the posture. The
    branches of a redundant arm are families: each is represented by its angles nearest to the posture.
    Whether all are found is not
    certain: the search starts from 96 seeds.

    Args:
        name: the arm, for messages.
        arm: its model, with its grasp.
        X_WP: payload pose, shape (4, 4).
        posture: as for solve_ik.

    Raises:
        JointLimitError, UnreachablePoseError: there is none, as for solve_ik.
    """
    return _branches(name, arm, X_WP, posture, _BRANCH_SEEDS, None)


def _branches(
    name: str, arm: ArmModel, X_WP: ArrayLike, posture: ArrayLike | None, seeds: int, slides: int | None
) -> list[Array]:
    """Return the distinct branches, sorted by distance to the posture; of a redundant arm, those of the nearest landings."""
    search = IKSolver(arm)
    target = search.grasp(as_array("X_WP", X_WP, 4, 4))
    near = configuration_near(name, arm, posture)
    starts = [near, *search.ranges.around(near, _NEIGHBOURS), *search.ranges.spread(seeds)]
    found = sorted(_landings(search, target, starts, near), key=lambda q: search.distance(q, near))
    if not found:
        raise _missed(name, search, target, starts, near)
    if search.is_redundant:
        found = _slid(
            search, target, _slid(search, target, found, near, _FIRST_SLIDE)[:slides], near, _WHOLE_SLIDE
        )
    distinct: list[Array] = []
    for q in found:
        if all(search.distance(search.ranges.unwound(q, other), other) > _SAME_BRANCH for other in distinct):
            distinct.append(q)
    return distinct


def configuration_near(name: str, arm: ArmModel, posture: ArrayLike | None) -> Array:
    """Return the configuration of a posture given as angles, shape (nv,), or as a configuration, shape (nq,); zeros when None."""
    if posture is None:
        return np.array(pin.neutral(arm.model))
    argument = f"posture of arm {name!r}"
    if np.shape(posture) == (arm.nv,):
        return arm.configuration(as_array(argument, posture, arm.nv))
    return np.array(pin.normalize(arm.model, as_array(argument, posture, arm.nq)))


def _slid(search: IKSolver, target: pin.SE3, found: list[Array], near: Array, steps: int) -> list[Array]:
    """Return closed configurations slid along their self-motion towards the posture, the nearest first."""
    slid = (search.ranges.unwound(search.slide(target, q, near, steps=steps), near) for q in found)
    within = [q for q in slid if not search.ranges.beyond(q).any()]
    return sorted(within or found[:1], key=lambda q: search.distance(q, near))


def _landings(search: IKSolver, target: pin.SE3, starts: list[Array], near: Array) -> Iterator[Array]:
    """Yield the closed configurations within the limits that the starts lead to, unwound towards the posture."""
    for start in starts:
        landing = search.descend(target, start)
        if landing.is_closed:
            q = search.ranges.unwound(landing.q, near)
            if not search.ranges.beyond(q).any():
                yield q


def _missed(
    name: str, search: IKSolver, target: pin.SE3, starts: list[Array], near: Array
) -> UnreachablePoseError:
    """Return the error that says by how much the arm misses, and the joint that is to blame where it is limits alone."""
    nearest = min((search.approach(target, start) for start in starts), key=_distance_then_angle)
    beyond: list[Array] = []
    for start in starts:
        landing = search.descend(target, start, limited=False)
        if landing.is_closed:
            beyond.append(search.ranges.unwound(landing.q, near))
    if not beyond:
        return UnreachablePoseError(name, nearest.distance, nearest.angle)
    q = min(beyond, key=lambda q: float(np.abs(search.ranges.beyond(q)).max()))
    joint = int(np.abs(search.ranges.beyond(q)).argmax())
    ranges, value = search.ranges, float(search.ranges.values(q)[joint])
    limits = float(ranges.lower[joint]), float(ranges.upper[joint])
    return JointLimitError(name, nearest.distance, nearest.angle, ranges.names[joint], value, *limits)


def _distance_then_angle(landing: IKSolution) -> tuple[float, float]:
    return round(landing.distance / _SAME_DISTANCE), landing.angle
