"""Searching for joint angles that bring an arm's tip to its grasp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from coop_pin.arrays import Array
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.joint_limits import JointRanges
from coop_pin.model.pinocchio_model import frame_id

CLOSED = 1e-9
"""A gap below this is closed, m and rad."""


class IKSolution(NamedTuple):
    """Where a search ended.

    Attributes:
        q: joint angles, shape (nq,).
        gap: where the grasp is, seen from the tip: [p, log R] of X_EE_d, m and rad, shape (6,).
    """

    q: Array
    gap: Array

    @property
    def distance(self) -> float:
        """Between tip and grasp, m."""
        return float(np.linalg.norm(self.gap[:3]))

    @property
    def angle(self) -> float:
        """Between tip and grasp, rad."""
        return float(np.linalg.norm(self.gap[3:]))

    @property
    def is_closed(self) -> bool:
        """Whether nothing is left."""
        return bool(np.abs(self.gap).max() < CLOSED)


_FINISHED = 1e-13
_STALLED = 1e-6
_LONGEST_STEP = 0.5
_LONGEST_SLIDE = 0.3
_STEPS_BACK = 12
_RANK_CUT = 1e-6
_EVEN = np.ones(6)


class IKSolver:
    """Searches on the kinematics of one arm, with Pinocchio called directly: some 30 microseconds a step.

    Attributes:
        model: the arm's Pinocchio model.
        ranges: its joint limits.
        is_redundant: whether the arm can move while its tip stands still.
    """

    def __init__(self, arm: ArmModel) -> None:
        self.model = arm.model
        self.ranges = JointRanges(arm.model)
        self._data = arm.model.createData()
        self._tip = frame_id(arm.model, "tip")
        X_JE, X_JP = (arm.model.frames[frame_id(arm.model, name)].placement for name in ("tip", "payload"))
        self._X_PE = X_JP.actInv(X_JE)
        A = self._gap(pin.SE3.Identity(), self.ranges.spread(1)[0], _EVEN)[1]
        self.is_redundant = bool(np.linalg.matrix_rank(A, tol=_RANK_CUT) < self.model.nv)

    def grasp(self, X_WP: Array) -> pin.SE3:
        """Return where the tip must be to hold the payload at a pose: X_WE_d = X_WP X_PE."""
        return pin.SE3(X_WP) * self._X_PE

    def distance(self, q: Array, near: Array) -> float:
        """Return the length of the way from one configuration to another, rad."""
        return float(np.linalg.norm(pin.difference(self.model, q, near)))

    def descend(
        self, target: pin.SE3, q: Array, *, limited: bool = True, angle_weight: float = 1.0, steps: int = 200
    ) -> IKSolution:
        """Return where Levenberg-Marquardt ends: dq = A^T (A A^T + lambda I)^-1 e, e the weighted gap and A = -de/dv.

        Args:
            target: wanted tip pose X_WE_d.
            q: where to start, shape (nq,).
            limited: keep the joints that limits can stop within them.
            angle_weight: of the angle against the distance, m/rad. Far below one, the distance is made least
                first.
            steps: at most.
        """
        weights = np.repeat((1.0, angle_weight), 3)
        q = self.ranges.hold(q) if limited else q
        damping = 1e-3
        gap, A = self._gap(target, q, weights)
        size = float(gap @ gap)
        for _ in range(steps):
            if size < _FINISHED**2 or damping > 1e8:
                break
            if limited:
                A = np.where(self.ranges.stopped(q, A.T @ gap), 0.0, A)
            q_next = pin.integrate(self.model, q, _damped_step(A, gap, damping))
            q_next = self.ranges.hold(q_next) if limited else q_next
            gap_next, A_next = self._gap(target, q_next, weights)
            size_next = float(gap_next @ gap_next)
            if size_next < size:
                stalled = size > CLOSED**2 and size - size_next < _STALLED * angle_weight**2 * size
                q, gap, A, size, damping = q_next, gap_next, A_next, size_next, max(damping * 0.1, 1e-15)
                if stalled:
                    break
            else:
                damping *= 10.0
        return IKSolution(q, gap / weights)

    def approach(self, target: pin.SE3, q: Array) -> IKSolution:
        """Return the angles within the limits that come nearest to a grasp out of reach: least distance first, then least angle.

        The weight of the angle falls from descent to descent, so that the distance is made least to a
        millionth.
        """
        for angle_weight in (1.0, 0.1, 0.01, 0.001):
            landing = self.descend(target, q, angle_weight=angle_weight)
            q = landing.q
        return landing

    def slide(
        self, target: pin.SE3, q: Array, near: Array, *, limited: bool = True, steps: int = 60
    ) -> Array:
        """Return the configuration nearest to another that self-motion leads to: dq = (I - A^+ A) (near - q).

        Every step is closed again by a descent, and taken only if it comes nearer.

        Args:
            target: wanted tip pose X_WE_d.
            q: a configuration that is closed there, shape (nq,).
            near: the configuration to come near to, shape (nq,).
            limited: keep the joints that limits can stop within them.
            steps: at most.
        """
        gain, distance = 1.0, self.distance(q, near)
        for _ in range(steps):
            step = self._self_motion(target, q, pin.difference(self.model, q, near), limited)
            length = float(np.linalg.norm(step))
            if length < _STALLED or gain < _STALLED:
                break
            moved = pin.integrate(self.model, q, step * min(gain, _LONGEST_SLIDE / length))
            landing = self.descend(target, moved, limited=limited, steps=_STEPS_BACK)
            distance_there = self.distance(landing.q, near)
            if landing.is_closed and distance_there < distance:
                q, distance, gain = landing.q, distance_there, min(1.0, 2.0 * gain)
            else:
                gain *= 0.25
        return q

    def _self_motion(self, target: pin.SE3, q: Array, pull: Array, limited: bool) -> Array:
        """Return the part of a pull that leaves the tip still, shape (nv,); limited: without the joints it would drive beyond a limit."""
        A = self._gap(target, q, _EVEN)[1]
        stopped = np.zeros(len(pull), dtype=bool)
        while True:
            A_held, held = np.where(stopped, 0.0, A), np.where(stopped, 0.0, pull)
            step: Array = held - np.linalg.pinv(A_held, rcond=_RANK_CUT) @ (A_held @ held)
            further = self.ranges.stopped(q, step) & ~stopped
            if not (limited and further.any()):
                return step
            stopped |= further

    def _gap(self, target: pin.SE3, q: Array, weights: Array) -> tuple[Array, Array]:
        """Return the weighted gap [p, log R] of X_EE_d in tip axes and the Jacobian of its decrease, shapes (6,) and (6, nv)."""
        pin.computeJointJacobians(
            self.model, self._data, q
        )  # computeFrameJacobian in local axes would leave the placements stale
        X_EE_d = pin.updateFramePlacement(self.model, self._data, self._tip).actInv(target)
        J = pin.getFrameJacobian(self.model, self._data, self._tip, pin.LOCAL)
        gap = np.concatenate((X_EE_d.translation, pin.log3(X_EE_d.rotation)))
        A = np.empty_like(J)
        A[:3] = J[:3] - pin.skew(X_EE_d.translation) @ J[3:]
        A[3:] = pin.Jlog3(X_EE_d.rotation.T) @ J[3:]
        return gap * weights, A * weights[:, None]


def _damped_step(A: Array, gap: Array, damping: float) -> Array:
    """Return dq = A^T (A A^T + damping I)^-1 gap, cut to a longest entry."""
    gram = A @ A.T
    gram.flat[:: len(gram) + 1] += damping
    _, solution, _ = dposv(gram, gap)
    step: Array = A.T @ solution
    largest = float(np.abs(step).max())
    return step if largest <= _LONGEST_STEP else step * (_LONGEST_STEP / largest)
