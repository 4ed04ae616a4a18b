"""Mass-weighted projection of a state onto the closures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.chain.closure_set import ClosureSet, ClosureState
from coop_pin.chain.kkt_solver import ConstraintSVD, constraint_svd
from coop_pin.errors import OpenClosureError

_STEPS = 60
_AT_REST = 1e-13
_NEARLY_CLOSED = 1e-9
_LONGEST_STEP = 0.5
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-14, 1e8
_DESCENT_STEPS = 200


class Projected(NamedTuple):
    """A state on the closures.

    Attributes:
        q: configuration, shape (nq,).
        v: velocity, shape (nv,).
        rank: of the closure Jacobian there.
    """

    q: Array
    v: Array
    rank: int


class Projection:
    """Moves states onto the closures of a tree by the least motion in the metric of its mass matrix."""

    def __init__(self, model: pin.Model, closures: ClosureSet) -> None:
        self._model, self._data, self._closures = model, model.createData(), closures
        self._still = np.zeros(model.nv)

    def weighted(self, q: Array, state: ClosureState) -> ConstraintSVD:
        """Return the decomposition of the closure Jacobian at a configuration.

        Raises:
            MassMatrixError: the mass matrix is not positive definite.
        """
        return constraint_svd(pin.crba(self._model, self._data, q), state.jacobian)

    def state(self, q: Array, v: Array, allowed: float, most_rank: int | None = None) -> Projected:
        """Return a nearby state on the closures.

        Newton's steps dq = -M^-1 J^T (J M^-1 J^T)^+ e go on until they no longer matter or rounding stops
        them: near a singular pose, where a row has the small singular value s, an error e left in it would
        turn the velocity by e / s^2. The last decomposition serves the velocity, v - M^-1 J^T (J M^-1 J^T)^+
        J v, too.

        Args:
            q: configuration, shape (nq,).
            v: velocity, shape (nv,).
            allowed: how far closures may stand open in the end, m and rad.
            most_rank: the rank next to q on the closures, used for the first step.

        Raises:
            OpenClosureError: the closures cannot be closed from here.
        """
        last = np.inf
        for _ in range(_STEPS):
            state = self._closures.state(q, v)
            found = self.weighted(q, state)
            weighted, most_rank = found.at_most(most_rank), None
            dq = weighted.least_motion(-state.position)
            length = np.abs(dq).max(initial=0.0)
            if length > 0.5 * last and np.abs(state.position).max() < _NEARLY_CLOSED:
                break
            q = pin.integrate(self._model, q, dq)
            if weighted is found:  # a step cut at a lower rank says nothing about the next one
                last = length
                if length < _AT_REST:
                    break
        if not np.abs(state.position).max(initial=0.0) <= allowed:
            self.require_closed(q, allowed)
        return Projected(q, v - weighted.least_motion(state.velocity), weighted.rank)

    def velocity(self, q: Array, v: Array) -> Array:
        """Return the nearest velocity, in kinetic energy, that keeps the closures, shape (nv,)."""
        state = self._closures.state(q, v)
        return v - self.weighted(q, state).least_motion(state.velocity)

    def descend(self, q: Array) -> Array:
        """Return a configuration with closures as little open as Levenberg and Marquardt's steps find from a guess, shape (nq,)."""
        damping = _FIRST_DAMPING
        state = self._closures.state(q, self._still)
        for _ in range(_DESCENT_STEPS):
            if np.abs(state.position).max(initial=0.0) < _NEARLY_CLOSED or damping > _MOST_DAMPING:
                break
            dq = self.weighted(q, state).least_motion(-state.position, damping)
            dq *= min(1.0, _LONGEST_STEP / max(float(np.abs(dq).max()), 1e-300))
            tried = pin.integrate(self._model, q, dq)
            after = self._closures.state(tried, self._still)
            if after.position @ after.position < state.position @ state.position:
                q, state, damping = tried, after, max(0.1 * damping, _LEAST_DAMPING)
            else:
                damping *= 10.0
        return q

    def require_closed(self, q: Array, allowed: float) -> None:
        """Refuse a configuration whose closures are open by more than allowed (m, rad).

        Raises:
            OpenClosureError: naming the widest gap.
        """
        closure_errors = self._closures.closure_errors(q)
        widest = max(range(len(closure_errors)), key=lambda index: max(closure_errors[index]), default=None)
        if widest is not None and not max(closure_errors[widest]) <= allowed:
            raise OpenClosureError(self._closures.closures[widest].name, *closure_errors[widest], allowed)
