"""KKT solver for constrained forward dynamics, by a truncated SVD of the closure Jacobian."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import dtrsm, dtrsv  # LAPACK's dtrtrs starts threads for a 5 x 5 matrix: a millisecond

from coop_pin.base.arrays import Array
from coop_pin.base.errors import MassMatrixError
from coop_pin.chain.closure_set import ClosureSet, ClosureState
from coop_pin.description.plant import Stabilisation

RANK_TOLERANCE = 1e-5
"""Singular values below this part of the largest are redundant rows; 1e-9 would count rounding and drift."""


class ConstraintSVD(NamedTuple):
    """Truncated singular value decomposition J L^-T = U s V^T of a constraint Jacobian J, with M = L L^T.

    Attributes:
        factor: L, shape (nv, nv).
        left: U, shape (r, rank).
        values: s, shape (rank,).
        right: V, shape (nv, rank).
        dropped: the largest singular value that was truncated; near zero unless the mechanism is close to a
            singular pose.
    """

    factor: Array
    left: Array
    values: Array
    right: Array
    dropped: float

    @property
    def rank(self) -> int:
        """Number of independent rows."""
        return len(self.values)

    def truncated(self, max_rank: int | None) -> ConstraintSVD:
        """Return the decomposition truncated to at most a given rank; itself if max_rank is None."""
        if max_rank is None or max_rank >= self.rank:
            return self
        left, values, right = self.left[:, :max_rank], self.values[:max_rank], self.right[:, :max_rank]
        return ConstraintSVD(self.factor, left, values, right, float(self.values[max_rank]))

    def solve_LT(self, y: Array) -> Array:
        """Return L^-T y, shape (nv,)."""
        return dtrsv(self.factor, y, lower=1, trans=1)

    def least_motion(self, target: Array, damping: float = 0.0) -> Array:
        """Return the x of least x^T M x with J x = target, as far as it is in the range of J, shape (nv,).

        x = M^-1 J^T (J M^-1 J^T)^+ target = L^-T V s^-1 U^T target

        Args:
            target: values of J x, shape (r,).
            damping: mu of Levenberg and Marquardt, in parts of the largest s^2: s / (s^2 + mu s_1^2) instead
                of 1 / s.
        """
        s = self.values
        damped = s if damping == 0.0 else s + damping * s[:1] ** 2 / s
        return self.solve_LT(self.right.dot(self.left.T.dot(target) / damped))


def constraint_svd(mass_matrix: Array, jacobian: Array) -> ConstraintSVD:
    """Return the decomposition of a constraint Jacobian in the metric of the mass matrix.

    Args:
        mass_matrix: M, shape (nv, nv); only the upper triangle is read, which is what pin.crba fills.
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
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values[:1]))
    dropped = float(values[rank]) if rank < values.size else 0.0
    return ConstraintSVD(factor, left[:, :rank], values[:rank], right[:rank].T, dropped)


class KKTSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0 on the independent rows.

    With M = L L^T, J L^-T = U s V^T and y = L^-1 (tau - h)::

        b = s^-1 U^T [-(gamma + 2 zeta omega e' + omega^2 e) - J L^-T y]
        a = L^-T (y + V b),    lambda = U s^-1 b

    The solver keeps its last solution for wrenches().
    """

    def __init__(self, model: pin.Model, closures: ClosureSet, stabilisation: Stabilisation) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._stabilisation = stabilisation
        self._solution: tuple[ClosureState, Array] | None = None

    def acceleration(self, q: Array, v: Array, tau: Array, max_rank: int | None = None) -> Array:
        """Return a, shape (nv,).

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            tau: generalised force, shape (nv,).
            max_rank: rank on the closures, for a state slightly off them; not limited when None.

        Raises:
            MassMatrixError: the mass matrix is not positive definite.
        """
        state, gains = self._closures.state(q, v), self._stabilisation
        svd = constraint_svd(pin.crba(self._model, self._data, q), state.jacobian).truncated(max_rank)
        y = dtrsv(svd.factor, tau - pin.nonLinearEffects(self._model, self._data, q, v), lower=1)
        acceleration = -gains.stabilised(state.drift, state.velocity, state.position)
        b = svd.left.T.dot(acceleration - state.jacobian.dot(svd.solve_LT(y))) / svd.values
        self._solution = state, svd.left.dot(b / svd.values)
        return svd.solve_LT(y + svd.right.dot(b))

    @property
    def forces(self) -> list[pin.Force]:
        """Closure wrenches of the last solution, as of ``wrenches``."""
        return [pin.Force(wrench) for wrench in self.wrenches()]

    def wrenches(self) -> Array:
        """Return the closure wrenches (see ChainDynamics) of the last solution, shape (closures, 6)."""
        if self._solution is None:
            return np.zeros((len(self._closures.closures), 6))
        state, multipliers = self._solution
        return state.wrench_map.dot(multipliers)
