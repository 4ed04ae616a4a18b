"""Mass-weighted projection of a state onto the closures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.errors import OpenClosureError
from coop_pin.chain.closure_set import ClosureSet, ClosureState
from coop_pin.chain.kkt_solver import ConstraintSVD, constraint_svd

_STEPS = 60
"""Most Newton steps; convergence is linear at a singular configuration."""
_AT_REST = 1e-13
"""Newton step that is rounding, rad or m."""
_NEARLY_CLOSED = 1e-9
"""Closure error from which steps that do not halve are rounding, and at which a descent ends, m and rad."""
_LONGEST_STEP = 0.5
"""Largest entry of a step of the descent, rad or m: beyond it the linearised closures say little."""
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-14, 1e8
"""Damping of Levenberg-Marquardt; at the most the steps are lost in rounding, and the descent ends."""
_DESCENT_STEPS = 200


STEP_ALLOWED = 1e-6
"""Closure error after a projected integration step, m and rad."""


class Projected(NamedTuple):
    """State projected onto the closures.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        rank: rank of the closure Jacobian there.
    """

    q: Array
    v: Array
    rank: int


class Projection:
    """Projection of states onto the closures of a tree by the least motion in the mass metric."""

    def __init__(self, model: pin.Model, closures: ClosureSet) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._still = np.zeros(model.nv)

    def svd(self, q: Array, state: ClosureState) -> ConstraintSVD:
        """Return the truncated SVD of the closure Jacobian at a configuration, in the mass metric.

        Raises:
            MassMatrixError: the mass matrix is not positive definite.
        """
        return constraint_svd(pin.crba(self._model, self._data, q), state.jacobian)

    def state(self, q: Array, v: Array, allowed: float, max_rank: int | None = None) -> Projected:
        """Return a nearby state on the closures.

        Newton steps dq = -M^-1 J^T (J M^-1 J^T)^+ e are repeated until they are negligible or rounding stops
        them: near a singular pose, if a row has the small singular value s, a remaining error e in it would
        rotate the velocity by e / s^2. The last decomposition also projects the velocity,
        v - M^-1 J^T (J M^-1 J^T)^+ J v.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            allowed: largest accepted closure error, m and rad.
            max_rank: rank of the closures near q, for the first step; not limited when None.

        Raises:
            OpenClosureError: the steps do not converge to a closed configuration.
        """
        last = np.inf
        for _ in range(_STEPS):
            state = self._closures.state(q, v)
            full = self.svd(q, state)
            svd, max_rank = full.truncated(max_rank), None
            dq = svd.least_motion(-state.position)
            length = np.abs(dq).max(initial=0.0)
            if length > 0.5 * last and np.abs(state.position).max() < _NEARLY_CLOSED:
                break
            q = pin.integrate(self._model, q, dq)
            if svd is full:  # not after a step at a lower rank: the next one is at full rank
                last = length
                if length < _AT_REST:
                    break
        if not np.abs(state.position).max(initial=0.0) <= allowed:
            self.require_closed(q, allowed)
        return Projected(q, v - svd.least_motion(state.velocity), svd.rank)

    def velocity(self, q: Array, v: Array) -> Array:
        """Return the velocity nearest in kinetic energy that keeps the closures closed, shape (nv,)."""
        state = self._closures.state(q, v)
        return v - self.svd(q, state).least_motion(state.velocity)

    def descend(self, q: Array) -> Array:
        """Return q of least closure error near a guess, by Levenberg-Marquardt, shape (nq,)."""
        damping = _FIRST_DAMPING
        state = self._closures.state(q, self._still)
        for _ in range(_DESCENT_STEPS):
            if np.abs(state.position).max(initial=0.0) < _NEARLY_CLOSED or damping > _MOST_DAMPING:
                break
            dq = self.svd(q, state).least_motion(-state.position, damping)
            dq *= min(1.0, _LONGEST_STEP / max(float(np.abs(dq).max()), 1e-300))
            tried = pin.integrate(self._model, q, dq)
            after = self._closures.state(tried, self._still)
            if after.position @ after.position < state.position @ state.position:
                q, state, damping = tried, after, max(0.1 * damping, _LEAST_DAMPING)
            else:
                damping *= 10.0
        return q

    def require_closed(self, q: Array, allowed: float) -> None:
        """Raise an error if a closure error exceeds what is allowed (m, rad).

        Raises:
            OpenClosureError: with the largest closure error.
        """
        errors = self._closures.closure_errors(q)
        worst = max(range(len(errors)), key=lambda index: max(errors[index]), default=None)
        if worst is not None and not max(errors[worst]) <= allowed:
            raise OpenClosureError(self._closures.closures[worst].name, *errors[worst], allowed)
