"""Inverse kinematics of one arm: the solution within the joint limits nearest to a posture, and branches."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_pose, require_type
from coop_pin.base.errors import JointLimitError, UnreachablePoseError
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.ik_solver import IKSolver

_NEIGHBOURS = 12
"""Initial guesses around the posture, which lead to the branch nearest to it."""
_SEEDS = 16
"""Initial guesses over the joint ranges for the nearest branch alone."""
_BRANCH_SEEDS = 96
"""Initial guesses for all branches: an arm with six joints has up to 16."""
_FAMILIES = 4
"""Solutions of a redundant arm, the nearest after ``_FIRST_STEPS``, that go on for ``_ALL_STEPS``."""
_FIRST_STEPS = 5
_ALL_STEPS = 60
_SAME_BRANCH = 1e-3
"""Largest distance of solutions of one branch, rad: above the accuracy of a null-space descent."""
_SAME_DISTANCE = 1e-5
"""Distances to a target out of reach, m, among which the smaller angle decides."""


def solve_ik(arm: ArmModel, X_WP: ArrayLike, *, posture: ArrayLike | None = None) -> Array:
    """Return the configuration that holds the payload at a pose, nearest to a posture, within the limits.

    Shape (nq,). Levenberg-Marquardt from the posture, from around it, and from seeds spread over the joint
    ranges. A redundant arm then moves in its null space to the configuration nearest to the posture.
    Deterministic; the last solutions are remembered within the process.

    Args:
        arm: the model, with its grasp.
        X_WP: payload pose, shape (4, 4).
        posture: preferred angles, one for each joint, shape (nv,), or a configuration, shape (nq,); zeros
            when omitted.

    Raises:
        JointLimitError: only joint limits prevent a solution; with the joint.
        UnreachablePoseError: there is no solution; with the least distance found between tip and grasp, and
            the angle there.
    """
    return _branches(arm, X_WP, posture, _SEEDS, _FAMILIES)[0]


def ik_branches(arm: ArmModel, X_WP: ArrayLike, *, posture: ArrayLike | None = None) -> list[Array]:
    """Return all branches within the joint limits, the nearest to a posture first, each shape (nq,).

    Two branches differ by more than whole turns; each is wrapped to be nearest to the posture. The branches
    of a redundant arm are families: each is represented by its configuration nearest to the posture. The
    search starts from 96 seeds; it is not certain that it finds all.

    Args:
        arm: the model, with its grasp.
        X_WP: payload pose, shape (4, 4).
        posture: preferred angles or configuration, as for solve_ik.

    Raises:
        JointLimitError, UnreachablePoseError: there is none, as for solve_ik.
    """
    return _branches(arm, X_WP, posture, _BRANCH_SEEDS, None)


def _branches(
    arm: ArmModel, X_WP: ArrayLike, posture: ArrayLike | None, seeds: int, families: int | None
) -> list[Array]:
    """Return the distinct branches, sorted by distance to the posture.

    Of a redundant arm, only the given number of families nearest to the posture is kept (all if None).
    """
    require_type("arm", arm, ArmModel)
    X, near = as_pose("X_WP", X_WP), arm.posture(posture)
    question = _Question((arm.key, X.tobytes(), near.tobytes()), arm, X, near)
    return [q.copy() for q in _answer(question, seeds, families)]


@dataclass(frozen=True)
class _Question:
    """Payload pose and posture, compared by the values in ``key``."""

    key: tuple[object, ...]
    arm: ArmModel = field(compare=False)
    X_WP: Array = field(compare=False)
    near: Array = field(compare=False)


@lru_cache(maxsize=64)
def _answer(question: _Question, seeds: int, families: int | None) -> list[Array]:
    arm, near = question.arm, question.near
    solver = IKSolver(arm)
    target = solver.tip_target(question.X_WP)
    starts = [near, *solver.limits.perturb(near, _NEIGHBOURS), *solver.limits.random_configurations(seeds)]
    with np.errstate(over="ignore", invalid="ignore"):  # a pose of 1e300 m is out of reach, and no warning
        solutions = sorted(_solutions(solver, target, starts, near), key=lambda q: solver.distance(q, near))
        if not solutions:
            raise _unreachable(arm.name, solver, target, starts, near)
    if solver.is_redundant:
        nearest = _moved_near(solver, target, solutions, near, _FIRST_STEPS)[:families]
        solutions = _moved_near(solver, target, nearest, near, _ALL_STEPS)
    distinct: list[Array] = []
    for q in solutions:
        if all(
            solver.distance(solver.limits.wrap_near(q, other), other) > _SAME_BRANCH for other in distinct
        ):
            distinct.append(q)
    return distinct


def _solutions(solver: IKSolver, target: pin.SE3, starts: list[Array], near: Array) -> Iterator[Array]:
    """Yield the solutions within the limits from the starts, wrapped near the posture."""
    for start in starts:
        solution = solver.solve(target, start)
        if solution.is_closed:
            q = solver.limits.wrap_near(solution.q, near)
            if not solver.limits.violation(q).any():
                yield q


def _moved_near(
    solver: IKSolver, target: pin.SE3, solutions: list[Array], near: Array, steps: int
) -> list[Array]:
    """Return solutions moved in their null space towards the posture, the nearest first."""
    moved = (solver.null_space_descent(target, q, near, steps=steps) for q in solutions)
    return sorted((solver.limits.wrap_near(q, near) for q in moved), key=lambda q: solver.distance(q, near))


def _unreachable(
    name: str, solver: IKSolver, target: pin.SE3, starts: list[Array], near: Array
) -> UnreachablePoseError:
    """Return the error with the remaining gap, and the joint if only its limit prevents a solution."""
    limits = solver.limits
    nearest = min(
        (solver.nearest(target, start) for start in starts),
        key=lambda solution: (float(np.rint(solution.distance / _SAME_DISTANCE)), solution.angle),
    )
    unlimited = [solver.solve(target, start, limited=False) for start in starts]
    violating = [limits.wrap_near(solution.q, near) for solution in unlimited if solution.is_closed]
    if not violating:
        return UnreachablePoseError(name, nearest.distance, nearest.angle)
    q = min(violating, key=lambda q: float(np.abs(limits.violation(q)).max()))
    joint = int(np.abs(limits.violation(q)).argmax())
    value, lower, upper = (
        float(values[joint]) for values in (limits.joints.of(q), limits.lower, limits.upper)
    )
    return JointLimitError(
        name, nearest.distance, nearest.angle, limits.joints.names[joint], value, lower, upper
    )
