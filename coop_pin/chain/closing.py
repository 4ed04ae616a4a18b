"""Closing the chain: joint angles that bring an arm's tip to its grasp, on the branch nearest to a posture."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.errors import UnreachablePoseError
from coop_pin.model.arm_model import ArmModel
from coop_pin.spatial import inverse_pose, pose_error

_SEEDS = 24
_STEPS = 200
_CLOSED = 1e-13
_ACCEPTED = 1e-9
_LONGEST_STEP = 0.5


def closing_angles(name: str, arm: ArmModel, X_WP: ArrayLike, posture: ArrayLike | None = None) -> Array:
    """Return joint angles that hold the payload at a pose, nearest to a posture.

    Levenberg-Marquardt on the log of the tip error, from the posture and then from seeds spread over the joint ranges.

    Args:
        name: the arm, for messages.
        arm: its model, with its grasp.
        X_WP: payload pose, shape (4, 4).
        posture: angles that choose the elbow, shape (nq,); the neutral configuration when omitted.

    Raises:
        UnreachablePoseError: with the gap left at the best angles found.
    """
    target = as_array("X_WP", X_WP, 4, 4)
    near = pin.neutral(arm.model) if posture is None else as_array(f"posture of arm {name!r}", posture, arm.nq)
    found, best, best_gap = [], near, np.inf
    for seed in (near, *_seeds(arm.model)):
        q, gap = _descend(arm, pin.SE3(target), seed)
        if np.abs(gap).max() < best_gap:
            best, best_gap = q, float(np.abs(gap).max())
        if np.abs(gap).max() < _ACCEPTED:
            found.append(_unwound(arm.model, near, q))
    if not found:
        grasp_pose = target @ inverse_pose(arm.payload_pose(best)) @ arm.tip_pose(best)
        left_open = pose_error(arm.tip_pose(best), grasp_pose)
        raise UnreachablePoseError(name, float(np.linalg.norm(left_open[:3])), float(np.linalg.norm(left_open[3:])))
    return min(found, key=lambda q: float(np.linalg.norm(pin.difference(arm.model, near, q))))


def _descend(arm: ArmModel, target: pin.SE3, q: Array) -> tuple[Array, Array]:
    """Return the angles where the descent ends and the tip error left there, log6, m and rad."""
    damping = 1e-3
    gap, J = _gap(arm, target, q)
    for _ in range(_STEPS):
        if np.abs(gap).max() < _CLOSED or damping > 1e8:
            break
        dq = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), gap)
        dq *= min(1.0, _LONGEST_STEP / max(float(np.abs(dq).max()), 1e-300))
        q_next = pin.integrate(arm.model, q, dq)
        gap_next, J_next = _gap(arm, target, q_next)
        if gap_next @ gap_next < gap @ gap:
            q, gap, J, damping = q_next, gap_next, J_next, max(damping * 0.1, 1e-15)
        else:
            damping *= 10.0
    return q, gap


def _gap(arm: ArmModel, target: pin.SE3, q: Array) -> tuple[Array, Array]:
    """Return the error log6(X_PP_d) and the Jacobian of its decrease, in payload axes."""
    X_WP = pin.SE3(arm.payload_pose(q))
    to_payload_axes = np.kron(np.eye(2), X_WP.rotation.T)
    error = X_WP.actInv(target)
    return pin.log6(error).vector, pin.Jlog6(error.inverse()) @ to_payload_axes @ arm.payload_jacobian(q)


def _seeds(model: pin.Model) -> list[Array]:
    """Return configurations spread over the joint ranges, the same at every call."""
    rng = np.random.default_rng(0)
    lower = np.maximum(model.lowerPositionLimit, -np.pi)
    upper = np.minimum(model.upperPositionLimit, np.pi)
    return [pin.normalize(model, rng.uniform(lower, upper)) for _ in range(_SEEDS)]


def _unwound(model: pin.Model, near: Array, q: Array) -> Array:
    """Return the same pose with every turning joint within half a turn of the posture."""
    if model.nq != model.nv:
        return q
    return near + (q - near + np.pi) % (2.0 * np.pi) - np.pi
