"""The closure Jacobian in the metric of the mass matrix, cut at its rank."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import dtrsm, dtrsv  # LAPACK's dtrtrs starts threads for a 5 x 5 matrix: a millisecond

from coop_pin.arrays import Array
from coop_pin.chain.closure_set import ClosureSet, ClosureState
from coop_pin.description.baumgarte import Stabilisation
from coop_pin.errors import MassMatrixError

# Singular values below this part of the largest are redundant rows; 1e-9 would take rounding and drift for
# constraints.
RANK_CUT = 1e-5


class ConstraintSVD(NamedTuple):
    """The singular value decomposition of J L^-T, with M = L L^T, cut at its rank.

    Attributes:
        factor: L, shape (nv, nv).
        left: U, shape (r, rank).
        values: s, shape (rank,).
        right: V, shape (nv, rank).
        dropped: the largest singular value that was cut off; next to zero unless the mechanism is close to a
            singular pose.
    """

    factor: Array
    left: Array
    values: Array
    right: Array
    dropped: float

    @property
    def rank(self) -> int:
        """The number of independent rows."""
        return len(self.values)

    def at_most(self, rank: int | None) -> ConstraintSVD:
        """Return the decomposition cut at a rank: a little off the closures, redundant rows look independent."""
        if rank is None or rank >= self.rank:
            return self
        return ConstraintSVD(
            self.factor,
            self.left[:, :rank],
            self.values[:rank],
            self.right[:, :rank],
            float(self.values[rank]),
        )

    def weighted(self, x: Array) -> Array:
        """Return L^-1 x, shape (nv,)."""
        y: Array = dtrsv(self.factor, x, lower=1)
        return y

    def unweighted(self, y: Array) -> Array:
        """Return L^-T y, shape (nv,)."""
        x: Array = dtrsv(self.factor, y, lower=1, trans=1)
        return x

    def least_motion(self, target: Array, damping: float = 0.0) -> Array:
        """Return the joint motion x of least M-norm with J x = target (its part in the range), shape (nv,).

        Args:
            target: shape (r,).
            damping: mu of Levenberg and Marquardt, in parts of the largest s^2: s / (s^2 + mu s_1^2) instead
                of 1 / s.
        """
        return self.unweighted(self.right.dot(self.left.T.dot(target) / self._damped(damping)))

    def _damped(self, damping: float) -> Array:
        return self.values if damping == 0.0 else self.values + damping * self.values[:1] ** 2 / self.values


def constraint_svd(mass_matrix: Array, jacobian: Array) -> ConstraintSVD:
    """Decompose a closure Jacobian in the metric of the mass matrix.

    Args:
        mass_matrix: M, of which the upper triangle is read (that is what crba fills), shape (nv, nv).
        jacobian: J, shape (r, nv).

    Raises:
        MassMatrixError: the mass matrix is not positive definite.
    """
    try:
        factor = np.asarray(np.linalg.cholesky(mass_matrix.T), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise MassMatrixError(float(np.linalg.eigvalsh(np.nan_to_num(mass_matrix), "U").min())) from None
    weighted = dtrsm(1.0, factor, jacobian.T, lower=1).T if len(jacobian) else jacobian
    left, values, right = np.linalg.svd(weighted, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK_CUT * values[0])) if values.size else 0
    dropped = float(values[rank]) if rank < values.size else 0.0
    return ConstraintSVD(factor, left[:, :rank], values[:rank], right[:rank].T, dropped)


class KKTSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0 on the independent rows.

    With M = L L^T, J L^-T = U s V^T and y = L^-1 (tau - h)::

        b = s^-1 U^T [-(gamma + 2 zeta omega e' + omega^2 e) - J L^-T y],    a = L^-T (y + V b),    lambda = U s^-1 b
    """

    def __init__(self, model: pin.Model, closures: ClosureSet, stabilisation: Stabilisation) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._stabilisation = stabilisation
        self._solved: tuple[ClosureState, Array] | None = None

    def acceleration(self, q: Array, v: Array, tau: Array, most_rank: int | None = None) -> Array:
        """Return a, shape (nv,).

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).
            most_rank: the rank on the closures, where the state may be a little off them.

        Raises:
            MassMatrixError: the mass matrix is not positive definite.
        """
        state, gains = self._closures.state(q, v), self._stabilisation
        weighted = constraint_svd(pin.crba(self._model, self._data, q), state.jacobian).at_most(most_rank)
        y = weighted.weighted(tau - pin.nonLinearEffects(self._model, self._data, q, v))
        wanted = -(state.drift + gains.velocity_gain * state.velocity + gains.position_gain * state.position)
        b = weighted.left.T.dot(wanted - state.jacobian.dot(weighted.unweighted(y))) / weighted.values
        self._solved = state, weighted.left.dot(b / weighted.values)
        return weighted.unweighted(y + weighted.right.dot(b))

    def wrenches(self) -> Array:
        """Return the wrench on body a of each closure at a, in axes a, of the last solve, shape (closures, 6)."""
        if self._solved is None:
            return np.zeros((len(self._closures.closures), 6))
        state, multipliers = self._solved
        return state.wrench_map.dot(multipliers)
