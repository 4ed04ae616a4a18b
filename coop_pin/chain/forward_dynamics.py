"""Forward dynamics of a closed chain: accelerations and closure wrenches, checked by their definitions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ConstraintSolveError
from coop_pin.chain.closure_set import ClosureState
from coop_pin.chain.inverse_dynamics import multipliers_of, residual_allowed
from coop_pin.chain.kkt_solver import ConstraintSVD


class ChainDynamics(NamedTuple):
    """Forward dynamics of a closed chain.

    Attributes:
        acceleration: a, shape (nv,).
        closure_wrenches: wrench on body a of each closure at frame a, in axes of a, N and N m, shape
            (closures, 6).
            If rows are redundant, it is not unique for rigid bodies; this is the one of least multipliers.
        rank: number of independent closure rows.
        residual: largest entry of J a + gamma + stabilisation, m/s^2 or rad/s^2.
    """

    acceleration: Array
    closure_wrenches: Array
    rank: int
    residual: float


def checked_dynamics(
    state: ClosureState, svd: ConstraintSVD, a: Array, wrenches: Array, residual: Array
) -> ChainDynamics:
    """Return accelerations and closure wrenches of a solver, these with least multipliers.

    Args:
        state: closures of the state.
        svd: singular value decomposition of the constraint Jacobian.
        a: acceleration, shape (nv,).
        wrenches: closure wrenches of the solver, shape (closures, 6).
        residual: J a + gamma + stabilisation, shape (r,).

    Raises:
        ConstraintSolveError: the residual is too large.
    """
    largest = float(np.abs(residual).max(initial=0.0))
    # Near a singular pose the truncated rows add to it.
    allowed = residual_allowed(a) + 10.0 * svd.dropped * float(np.linalg.norm(svd.factor.T @ a))
    if not largest <= allowed:
        raise ConstraintSolveError(largest, allowed)
    if svd.rank < len(state.position):
        # Each proximal step adds rounding / mu along null(J^T): 1e-5 of a Bennett linkage's wrenches.
        wrenches = state.wrench_map @ (svd.left @ (svd.left.T @ multipliers_of(state, wrenches)))
    return ChainDynamics(a, wrenches, svd.rank, largest)
