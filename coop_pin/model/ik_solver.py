"""Inverse-kinematics solver of one arm: Levenberg-Marquardt, nearest pose and null-space motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from coop_pin.base.arrays import Array
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.pinocchio_model import frame_id, jacobian_matrix

CLOSED = 1e-9
"""A pose error below this counts as closed, m and rad."""


class IKSolution(NamedTuple):
    """Result of an inverse-kinematics solve.

    Attributes:
        q: configuration, shape (nq,).
        gap: pose of the target in the tip's frame: [p, log R] of X_EE_d, m and rad, shape (6,); of a joint in
            axes of C, zero in the rows that it leaves free.
    """

    q: Array
    gap: Array

    @property
    def distance(self) -> float:
        """Distance between tip and target, m."""
        return float(np.linalg.norm(self.gap[:3]))

    @property
    def angle(self) -> float:
        """Angle between tip and target, rad."""
        return float(np.linalg.norm(self.gap[3:]))

    @property
    def is_closed(self) -> bool:
        """Whether the tip is at the target."""
        return bool(np.abs(self.gap).max() < CLOSED)


_FINISHED = 1e-13
"""Weighted gap at which the iteration ends, m: some units of rounding of a pose at a metre."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-15, 1e8
"""Damping of Levenberg-Marquardt: at first that of a cautious step; at the least that of Newton's method,
with A A^T still regular; at the most the steps are lost in rounding, and the iteration ends."""
_STALLED = 1e-6
"""Relative decrease of the squared gap that is no progress, as towards a target out of reach; likewise the
length of a null-space step, rad, and its gain."""
_LONGEST_STEP = 0.5
"""Largest entry of a step, rad or m: beyond it the linearised gap says little."""
_LONGEST_NULL_SPACE_STEP = 0.3
"""Longest null-space step, rad: the tip leaves its target with the square of it, and must return."""
_STEPS_BACK = 12
"""Most steps that return the tip after a null-space step; if they do not, the step was too long."""
_LONGEST_FOLLOW_STEP = 0.2
"""Largest change of a joint between poses of a path, rad or m; beyond it the solution may be on another
branch, and the pose step is halved."""
_HALVINGS = 6
"""Most halvings of a pose step, to 1/64: near a singular pose joints move far in any step."""
_FOLLOW_STEPS = 40
"""Most steps from pose to pose: the initial guess is close."""
_FOLLOW_DESCENTS = 2
"""Null-space steps at each pose of a path: a posture draws the arm but does not hold it, as in the laws."""
_FOLLOW_ANGLE_WEIGHT = 1e-3
"""Weight of the angle out of reach, m/rad: least distance first, as at the end of ``nearest``."""
_RANK_TOLERANCE = 1e-6
"""Singular values of the Jacobian below it count as zero, absolute for redundancy, relative in a step."""
_UNWEIGHTED = np.ones(6)


class IKSolver:
    """Inverse-kinematics solver of one arm; a step takes some 30 microseconds.

    Attributes:
        model: the arm's Pinocchio model.
        limits: joint limits of the arm.
        is_redundant: whether its Jacobian has a null space.
    """

    def __init__(self, arm: ArmModel) -> None:
        self.model = arm.model
        self.limits = arm.limits
        self._data = arm.model.createData()
        self._base_joints = arm.base_joints
        self._tip = frame_id(arm.model, "tip")
        X_JE, X_JP = (arm.model.frames[frame_id(arm.model, name)].placement for name in ("tip", "payload"))
        self._X_PE = X_JP.actInv(X_JE)
        self._to_held = arm.to_held_rows
        q = self.limits.random_configurations(1)[0]
        A = self._jacobian(self._gap(pin.SE3.Identity(), q, _UNWEIGHTED)[1], _UNWEIGHTED)
        self.is_redundant = bool(np.linalg.matrix_rank(A, tol=_RANK_TOLERANCE) < self.model.nv)

    def tip_target(self, X_WP: Array) -> pin.SE3:
        """Return the tip pose that holds the payload at X_WP: X_WE_d = X_WP X_PE."""
        return pin.SE3(X_WP) * self._X_PE

    def distance(self, q: Array, near: Array) -> float:
        """Return the joint-space distance between two configurations, rad; that of a mobile base is none."""
        return float(np.linalg.norm(self._step(q, near)))

    def _step(self, q: Array, near: Array) -> Array:
        """Return the joint-space step to a configuration without those of a mobile base, shape (nv,)."""
        step: Array = pin.difference(self.model, q, near)
        step[: self._base_joints] = 0.0
        return step

    def solve(
        self, target: pin.SE3, q: Array, *, limited: bool = True, angle_weight: float = 1.0, steps: int = 200
    ) -> IKSolution:
        """Return the solution by Levenberg-Marquardt from an initial guess.

        dq = A^T (A A^T + lambda I)^-1 e, with e the weighted gap and A = -de/dv.

        Args:
            target: desired tip pose X_WE_d.
            q: initial guess, shape (nq,).
            limited: whether to stay within the joint limits that restrict the workspace.
            angle_weight: weight of the angle relative to the distance, m/rad. Far below one, the distance
                is minimised first.
            steps: largest number of steps.
        """
        weights = _UNWEIGHTED if angle_weight == 1.0 else np.repeat((1.0, angle_weight), 3)
        q = self.limits.clip(q) if limited else q
        damping = _FIRST_DAMPING
        gap, X_EE_d = self._gap(target, q, weights)
        size, is_new = float(gap @ gap), True
        for _ in range(steps):
            if size < _FINISHED**2 or damping > _MOST_DAMPING:
                break
            if is_new:
                A = self._jacobian(X_EE_d, weights)
                if limited:
                    A = np.where(self.limits.at_limit(q, A.T @ gap), 0.0, A)
            q_next = pin.integrate(self.model, q, _damped_step(A, gap, damping))
            q_next = self.limits.clip(q_next) if limited else q_next
            gap_next, X_EE_d = self._gap(target, q_next, weights)
            size_next = float(gap_next @ gap_next)
            is_new = size_next < size
            if is_new:
                stalled = size > CLOSED**2 and size - size_next < _STALLED * angle_weight**2 * size
                q, gap, size = q_next, gap_next, size_next
                damping = max(damping * 0.1, _LEAST_DAMPING)
                if stalled:
                    break
            else:
                damping *= 10.0
        return IKSolution(q, gap / weights)

    def nearest(self, target: pin.SE3, q: Array) -> IKSolution:
        """Return the configuration within the limits nearest to a target out of reach.

        The distance is minimised first, then the angle: the weight of the angle falls from solve to solve,
        which minimises the distance to a millionth. Arguments as of solve.
        """
        for angle_weight in (1.0, 0.1, 0.01, 0.001):
            solution = self.solve(target, q, angle_weight=angle_weight)
            q = solution.q
        return solution

    def null_space_descent(
        self, target: pin.SE3, q: Array, near: Array, *, limited: bool = True, steps: int = 60
    ) -> Array:
        """Return the configuration nearest to another by null-space motion, dq = (I - A^+ A) (near - q).

        Every step is followed by a solve that brings the tip back to the target, and is accepted only if it
        reduces the distance.

        Args:
            target: desired tip pose X_WE_d.
            q: a solution for the target, shape (nq,).
            near: the configuration to approach, shape (nq,).
            limited: whether to stay within the joint limits that restrict the workspace.
            steps: largest number of steps.
        """
        gain, distance = 1.0, self.distance(q, near)
        for _ in range(steps):
            step = self._null_space_step(target, q, self._step(q, near), limited)
            length = float(np.linalg.norm(step))
            if length < _STALLED or gain < _STALLED:
                break
            moved = pin.integrate(self.model, q, step * min(gain, _LONGEST_NULL_SPACE_STEP / length))
            solution = self.solve(target, moved, limited=limited, steps=_STEPS_BACK)
            new_distance = self.distance(solution.q, near)
            if solution.is_closed and new_distance < distance:
                q, distance, gain = solution.q, new_distance, min(1.0, 2.0 * gain)
            else:
                gain *= 0.25
        return q

    def follow(self, poses: Sequence[Array], q: Array, near: Array) -> list[IKSolution]:
        """Return the solutions along a path, each continued from the one before, without joint limits.

        If a pose is out of reach, the arm takes the nearest configuration, least distance first, and
        continues from there. A redundant arm is drawn towards a posture, as by the posture term of its
        controller.

        Args:
            poses: payload poses X_WP, each shape (4, 4), close to each other.
            q: a solution for the first, shape (nq,).
            near: the posture, shape (nq,).
        """
        solutions: list[IKSolution] = []
        last, halvings = self.tip_target(poses[0]), _HALVINGS
        for X_WP in poses:
            target = self.tip_target(X_WP)
            solution = self.follow_step(last, target, q, halvings)
            if solution.is_closed and self.is_redundant:
                q = self.null_space_descent(target, solution.q, near, limited=False, steps=_FOLLOW_DESCENTS)
                solution = solution._replace(q=q)
            solutions.append(solution)
            last, q, halvings = target, solution.q, _HALVINGS if solution.is_closed else 0
        return solutions

    def follow_step(self, last: pin.SE3, target: pin.SE3, q: Array, halvings: int = _HALVINGS) -> IKSolution:
        """Return the solution after a step of the target, which is halved until no joint moves far at once.

        Args:
            last: tip pose before the step.
            target: tip pose after the step.
            q: configuration before the step, shape (nq,).
            halvings: largest number of halvings.
        """
        solution = self.solve(target, q, limited=False, steps=_FOLLOW_STEPS)
        moved = float(np.abs(pin.difference(self.model, q, solution.q)).max())
        if solution.is_closed and moved < _LONGEST_FOLLOW_STEP:
            return solution
        if halvings:
            middle = pin.SE3.Interpolate(last, target, 0.5)
            halfway = self.follow_step(last, middle, q, halvings - 1)
            if halfway.is_closed:
                return self.follow_step(middle, target, halfway.q, halvings - 1)
        if solution.is_closed:
            return solution
        return self.solve(target, q, limited=False, angle_weight=_FOLLOW_ANGLE_WEIGHT, steps=_FOLLOW_STEPS)

    def _null_space_step(self, target: pin.SE3, q: Array, pull: Array, limited: bool) -> Array:
        """Return the null-space part of a pull, without the joints at a limit if limited, shape (nv,)."""
        A = self._jacobian(self._gap(target, q, _UNWEIGHTED)[1], _UNWEIGHTED)
        stopped = np.zeros(len(pull), dtype=bool)
        while True:
            A_held, held = np.where(stopped, 0.0, A), np.where(stopped, 0.0, pull)
            step: Array = held - np.linalg.pinv(A_held, rcond=_RANK_TOLERANCE) @ (A_held @ held)
            further = self.limits.at_limit(q, step) & ~stopped
            if not (limited and further.any()):
                return step
            stopped |= further

    def _gap(self, target: pin.SE3, q: Array, weights: Array) -> tuple[Array, pin.SE3]:
        """Return the weighted gap [p, log R] of X_EE_d in tip axes, shape (6,), and X_EE_d."""
        # Not computeFrameJacobian, which in local axes does not update the placements.
        pin.computeJointJacobians(self.model, self._data, q)
        X_EE_d = pin.updateFramePlacement(self.model, self._data, self._tip).actInv(target)
        gap = np.empty(6)
        gap[:3], gap[3:] = X_EE_d.translation, pin.log3(X_EE_d.rotation)
        if self._to_held is not None:
            gap = self._to_held @ gap
        return gap if weights is _UNWEIGHTED else gap * weights, X_EE_d

    def _jacobian(self, X_EE_d: pin.SE3, weights: Array) -> Array:
        """Return A = -d(gap)/dv at the configuration of the last gap, shape (6, nv)."""
        J = jacobian_matrix(pin.getFrameJacobian(self.model, self._data, self._tip, pin.LOCAL))
        A = np.empty_like(J)
        A[:3] = J[:3] - pin.skew(X_EE_d.translation) @ J[3:]
        A[3:] = pin.Jlog3(X_EE_d.rotation.T) @ J[3:]
        if self._to_held is not None:
            A = self._to_held @ A
        return A if weights is _UNWEIGHTED else A * weights[:, None]


def _damped_step(A: Array, gap: Array, damping: float) -> Array:
    """Return dq = A^T (A A^T + damping I)^-1 gap, scaled down to a largest entry."""
    gram = A @ A.T
    gram.reshape(-1)[:: len(gram) + 1] += damping
    _, solution, _ = dposv(gram, gap)
    step: Array = A.T @ solution
    if step @ step <= _LONGEST_STEP**2:  # most are: faster than the largest entry
        return step
    largest = float(np.abs(step).max())
    return step if largest <= _LONGEST_STEP else step * (_LONGEST_STEP / largest)
