"""Constrained forward dynamics by a KKT system with a rank cut: any rows; the second formulation and the oracle."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closures import Closures
from coop_pin.chain.mass_weighted import mass_weighted
from coop_pin.description.clock import Stabilisation
from coop_pin.model.pinocchio_model import symmetric


class RankCutSolver:
    """M a + h = tau + J^T lambda with J a + gamma + 2 zeta omega e' + omega^2 e = 0 on the independent rows.

    With M = L L^T, J L^-T = U s V^T and y = L^-1 (tau - h)::

        b = -(gamma + 2 zeta omega e' + omega^2 e) - J M^-1 (tau - h),    a = L^-T (y + V s^-1 U^T b),    lambda = U s^-2 U^T b
    """

    def __init__(self, model: pin.Model, closures: Closures, stabilisation: Stabilisation) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._stabilisation = stabilisation
        self._wrenches = np.zeros((len(closures.closures), 6))

    def acceleration(self, q: Array, v: Array, tau: Array) -> Array:
        """Return a, shape (nv,).

        Raises:
            MassMatrixError: the mass matrix is not positive definite.
        """
        M = symmetric(pin.crba(self._model, self._data, q))
        h = pin.nonLinearEffects(self._model, self._data, q, v)
        state, gains = self._closures.state(q, v), self._stabilisation
        weighted = mass_weighted(M, state.jacobian)
        y = weighted.weighted(tau - h)
        wanted = -(state.drift + gains.velocity_gain * state.velocity + gains.position_gain * state.position)
        b = wanted - state.jacobian.dot(weighted.unweighted(y))
        self._wrenches = state.wrench_map.dot(weighted.multipliers(b))
        return weighted.unweighted(y + weighted.right.dot(weighted.left.T.dot(b) / weighted.values))

    def wrenches(self) -> Array:
        """Return the wrench on body a of each closure at a, in axes a, of the last solve, shape (closures, 6)."""
        return self._wrenches
