"""Constrained forward dynamics by a KKT system with a rank cut: any rows; the second formulation and the oracle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import solve_triangular

from coop_pin.arrays import Array
from coop_pin.chain.closures import Closures
from coop_pin.description.clock import Stabilisation
from coop_pin.model.pinocchio_model import symmetric

# Singular values below this part of the largest are redundant rows; 1e-9 would take rounding and drift for constraints.
RANK_CUT = 1e-5


class MassWeightedClosure(NamedTuple):
    """The singular value decomposition of J L^-T, with M = L L^T, cut at its rank.

    Attributes:
        factor: L, shape (nv, nv).
        left: U, shape (r, rank).
        values: s, shape (rank,).
        right: V, shape (nv, rank).
    """

    factor: Array
    left: Array
    values: Array
    right: Array

    @property
    def rank(self) -> int:
        """The number of independent rows."""
        return len(self.values)

    def least_motion(self, target: Array) -> Array:
        """Return the joint motion x of least M-norm with J x = target (its part in the range), shape (nv,)."""
        weighted = self.right @ ((self.left.T @ target) / self.values)
        return np.asarray(solve_triangular(self.factor, weighted, trans="T", lower=True))

    def multipliers(self, target: Array) -> Array:
        """Return the least lambda with J M^-1 J^T lambda = target (its part in the range), shape (r,)."""
        return self.left @ ((self.left.T @ target) / self.values**2)


def mass_weighted(mass_matrix: Array, jacobian: Array) -> MassWeightedClosure:
    """Decompose a closure Jacobian in the metric of the mass matrix."""
    factor = np.asarray(np.linalg.cholesky(mass_matrix), dtype=np.float64)
    weighted = solve_triangular(factor, jacobian.T, lower=True).T
    left, values, right = np.linalg.svd(weighted, full_matrices=False)
    rank = int(np.sum(values > RANK_CUT * values[0])) if values.size and values[0] > 0.0 else 0
    return MassWeightedClosure(factor, left[:, :rank], values[:rank], right[:rank].T)


class RankCutSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0 on the independent rows."""

    def __init__(self, model: pin.Model, closures: Closures, stabilisation: Stabilisation) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._stabilisation = stabilisation
        self._wrenches = np.zeros((len(closures.closures), 6))

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return a, shape (nv,)."""
        M = symmetric(pin.crba(self._model, self._data, q))
        h = pin.nonLinearEffects(self._model, self._data, q, v)
        free = np.linalg.solve(M, tau - h)
        state = self._closures.state(q, v)
        gains = self._stabilisation
        target = -(state.drift + gains.velocity_gain * state.velocity + gains.position_gain * state.position) - state.jacobian @ free
        weighted = mass_weighted(M, state.jacobian)
        self._wrenches = state.wrench_map @ weighted.multipliers(target)
        return np.asarray(free + weighted.least_motion(target))

    def wrenches(self) -> Array:
        """Return the wrench on body a of each closure at a, in axes a, of the last solve, shape (closures, 6)."""
        return self._wrenches
