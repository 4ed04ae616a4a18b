"""Following a path of payload poses with one arm, on the branch it starts on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.ik_solver import TipSearch
from coop_pin.chain.landing import Landing

_LONGEST_STEP = 0.2
_HALVINGS = 6
_STEPS = 40
_SLIDES = 2
_ANGLE_WEIGHT = 1e-3


def follow(search: TipSearch, poses: Sequence[Array], q: Array, near: Array) -> list[Landing]:
    """Return where an arm stands at every pose of a path, carried on from pose to pose.

    Limits are not looked at: no law avoids them. Where a pose is out of reach, the arm takes the angles that come nearest, least
    distance first, and carries on from there. A redundant arm is drawn towards a posture, as its law's spring would draw it.

    Args:
        search: the arm.
        poses: payload poses X_WP, each shape (4, 4), a short way from one to the next.
        q: angles that hold the first, shape (nq,).
        near: the posture, shape (nq,).
    """
    landings: list[Landing] = []
    last, halvings = search.grasp(poses[0]), _HALVINGS
    for X_WP in poses:
        target = search.grasp(X_WP)
        landing = step_to(search, last, target, q, halvings)
        if landing.is_closed and search.is_redundant:
            landing = landing._replace(q=search.slide(target, landing.q, near, limited=False, steps=_SLIDES))
        landings.append(landing)
        last, q, halvings = target, landing.q, _HALVINGS if landing.is_closed else 0
    return landings


def step_to(search: TipSearch, last: pin.SE3, target: pin.SE3, q: Array, halvings: int = _HALVINGS) -> Landing:
    """Return where an arm stands after a step of its grasp, halved until no joint moves far in one go.

    Args:
        search: the arm.
        last: where its grasp was.
        target: where it is now.
        q: where the arm stood, shape (nq,).
        halvings: of the step, at most.
    """
    landing = search.descend(target, q, limited=False, steps=_STEPS)
    moved = float(np.abs(pin.difference(search.model, q, landing.q)).max())
    if landing.is_closed and moved < _LONGEST_STEP:
        return landing
    if halvings:
        middle = pin.SE3.Interpolate(last, target, 0.5)
        halfway = step_to(search, last, middle, q, halvings - 1)
        if halfway.is_closed:
            return step_to(search, middle, target, halfway.q, halvings - 1)
    return landing if landing.is_closed else search.descend(target, q, limited=False, angle_weight=_ANGLE_WEIGHT, steps=_STEPS)
