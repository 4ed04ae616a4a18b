"""Configurations at rest: an arm whose tip is nearest to a pose, and a spring that bears a load."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.grasps.force_elements import Side
from coop_pin.grasps.spring_damper import SpringDamper
from coop_pin.model.pinocchio_model import jacobian_matrix

MOST_STEPS = 60
"""Most steps of the searches for rest."""
SETTLED = 1e-14
"""Last step of those searches, m and rad."""
_BALANCED = 1e-9
"""Moment that a spring at rest may lack, as a part of its stiffness."""
_SPREAD = 1e-6
"""Singular value of an arm's Jacobian, as a part of the largest, in whose direction a tip does not move."""


def reached(model: Any, data: Any, q: Array, tip: Side, joints: slice, target: Any) -> Array:
    """Return q with the joints of an arm moved so that a frame on it is nearest to a target."""
    for _ in range(MOST_STEPS):
        pin.computeJointJacobians(model, data, q)
        missing = tip.pose.actInv(target)
        error = np.concatenate((missing.translation, pin.log3(missing.rotation)))
        J = tip.X_JF.toActionMatrixInverse() @ jacobian_matrix(
            pin.getJointJacobian(model, data, tip.joint, pin.LOCAL)
        )
        step = np.zeros(model.nv)
        step[joints] = np.linalg.lstsq(J[:, joints], error, rcond=_SPREAD)[0]
        q = pin.integrate(model, q, step)
        if np.abs(step).max() < SETTLED:
            break
    return q


def at_rest(stiffness: Array, load: Array, name: str) -> Any:
    """Return X_GE at which a spring has a wrench on its arm.

    Args:
        stiffness: Diagonal of K, shape (6,).
        load: Wrench on the arm about the grasp in its axes, N and N m, shape (6,).
        name: Name of the arm, for the error.

    Raises:
        FieldError: no rotation has the moment.
    """
    spring = SpringDamper.of(stiffness[None], np.zeros((1, 6)))
    p, turn = -load[:3] / stiffness[:3], np.zeros(3)
    moment = load[3:] - np.cross(p, load[:3])
    for _ in range(MOST_STEPS):
        missing = moment - spring.elastic(p[None], pin.exp3(turn)[None])[0, 3:]
        if np.abs(missing / stiffness[3:]).max() < SETTLED:
            break
        turn = turn - missing / stiffness[3:]
    if not np.abs(missing / stiffness[3:]).max() < _BALANCED:
        raise FieldError(
            f"is {stiffness[3:].tolist()} N m/rad in rotation; the arm's share of the weight asks for a"
            f" moment of {np.linalg.norm(moment):.3g} N m, which no deflection has: use a stiffer grasp, or"
            " one nearer to P",
            f"cell.grasps.{name}.stiffness",
        )
    return pin.SE3(pin.exp3(turn), p)
