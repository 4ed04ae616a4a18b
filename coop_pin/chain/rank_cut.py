"""Constrained forward dynamics by a KKT system with a rank cut: any rows; the second formulation and the oracle."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closure_set import Closures, ClosureState
from coop_pin.chain.kkt_solver import mass_weighted
from coop_pin.description.plant import Stabilisation


class RankCutSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0 on the independent rows.

    With M = L L^T, J L^-T = U s V^T and y = L^-1 (tau - h)::

        b = s^-1 U^T [-(gamma + 2 zeta omega e' + omega^2 e) - J L^-T y],    a = L^-T (y + V b),    lambda = U s^-1 b
    """

    def __init__(self, model: pin.Model, closures: Closures, stabilisation: Stabilisation) -> None:
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
        weighted = mass_weighted(pin.crba(self._model, self._data, q), state.jacobian).at_most(most_rank)
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
