"""Minimal coordinates of a closed chain: independent joints, null space, reduced mass matrix and bias."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
import scipy.linalg
from numpy.typing import NDArray

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError
from coop_pin.chain.closure_set import ClosureSet
from coop_pin.chain.projection import Projection
from coop_pin.model.mechanism_model import velocity_at

Indices: TypeAlias = NDArray[np.intp]

_CONDITION_ALLOWED = 1e8
"""Condition number of the independent rows of the null space beyond which they are dependent."""
_STEPS, _AT_REST, _CLOSED = 60, 1e-12, 1e-9
"""Most Newton steps, the step that is rounding and the accepted closure error, rad or m."""


class MinimalCoordinates(NamedTuple):
    """Independent velocities nu of a closed chain, ``v = N nu`` with ``nu = v[indices]``.

    Attributes:
        indices: entries of v that are independent, shape (d,): d degrees of freedom.
        null_space: N with J N = 0 and N[indices] = 1, shape (nv, d).
    """

    indices: Indices
    null_space: Array


class ReducedDynamics(NamedTuple):
    """Dynamics in minimal coordinates, ``M_r nu' + b_r = N^T tau``.

    Attributes:
        coordinates: the independent velocities nu.
        mass_matrix: M_r = N^T M N, shape (d, d); the kinetic energy is nu^T M_r nu / 2.
        bias: b_r = N^T (h + M a_0), with J a_0 + gamma = 0 and a_0[indices] = 0, shape (d,).
    """

    coordinates: MinimalCoordinates
    mass_matrix: Array
    bias: Array


def best_conditioned(Z: Array, candidates: Indices) -> MinimalCoordinates | None:
    """Return independent velocities among candidates, by QR with pivoting; None if they are too few.

    Args:
        Z: basis of the velocities, shape (nv, d).
        candidates: entries of v to choose from.
    """
    degrees = Z.shape[1]
    if len(candidates) < degrees:
        return None
    if degrees == 0:
        return MinimalCoordinates(candidates[:0], Z)
    pivots = scipy.linalg.qr(Z[candidates].T, mode="r", pivoting=True)[1]
    indices = np.sort(candidates[pivots[:degrees]])
    if not np.linalg.cond(Z[indices]) <= _CONDITION_ALLOWED:
        return None
    N = np.linalg.solve(Z[indices].T, Z.T).T
    N[indices] = np.eye(degrees)
    return MinimalCoordinates(indices, N)


class MinimalForm:
    """Minimal coordinates of a tree with closures: null space, dynamics, and motion of independent joints."""

    def __init__(self, model: pin.Model, closures: ClosureSet, projection: Projection) -> None:
        self._model, self._data, self._closures, self._projection = (
            model,
            model.createData(),
            closures,
            projection,
        )
        self._still = np.zeros(model.nv)
        joints = [(index, model.joints[index]) for index in range(1, model.njoints)]
        self._names = {int(joint.idx_v): model.names[index] for index, joint in joints if joint.nv == 1}

    def require_positions(self) -> None:
        """Refuse wheels that roll: they leave more positions free than velocities.

        Raises:
            ArgumentError: there are some.
        """
        if self._closures.rolling:
            raise ArgumentError(
                "a linear model has as many positions as velocities, and wheels that roll leave more; park"
                " the base (follow = 'parked'), or leave out the rows of rolling"
            )

    def indices(self, names: Sequence[str]) -> Indices:
        """Return the entries of v of joints with one degree of freedom each.

        Raises:
            NameNotFoundError: a joint does not exist; ArgumentError: it has more degrees of freedom.
        """
        rates = [velocity_at(self._model, {name: 1.0}) for name in names]
        return np.array([np.argmax(v) for v in rates], dtype=np.intp)

    def coordinates(self, q: Array, joints: Sequence[str] | None = None) -> MinimalCoordinates:
        """Return independent velocities: those of stated joints, or of the best condition.

        Raises:
            ArgumentError: the stated joints do not determine the motion.
        """
        svd = self._projection.svd(q, self._closures.state(q, self._still))
        # J L^-T = U s V^T: the last columns of an orthonormal basis that begins with V span what is
        # orthogonal to it, and L^-T takes them to velocities: J Z = 0 and Z^T M Z = 1.
        Q = np.linalg.qr(svd.right, mode="complete")[0]
        Z = np.asarray(scipy.linalg.solve_triangular(svd.factor, Q[:, svd.rank :], lower=True, trans=1))
        if joints is not None:
            indices = self.indices(joints)
            stated = best_conditioned(Z, indices)
            if stated is None or len(indices) != Z.shape[1]:
                raise ArgumentError(
                    f"the joints {', '.join(joints) or '(none)'} are not independent coordinates here:"
                    f" {len(indices)} are stated, the closed chain has {Z.shape[1]} degrees of freedom; leave"
                    " joints out to have them chosen"
                )
            return stated
        single = best_conditioned(Z, np.array([*self._names], dtype=np.intp))
        return single or best_conditioned(Z, np.arange(len(Z))) or MinimalCoordinates(np.arange(0), Z)

    def joints(self, coordinates: MinimalCoordinates) -> tuple[str, ...]:
        """Return the names of the independent joints.

        Raises:
            ArgumentError: one of them has more than one degree of freedom.
        """
        if not {*coordinates.indices.tolist()} <= {*self._names}:
            raise ArgumentError(
                "a joint of more than one degree of freedom is needed as an independent coordinate; hold the"
                " floating body by closures"
            )
        return tuple(self._names[int(index)] for index in coordinates.indices)

    def dynamics(self, q: Array, v: Array, joints: Sequence[str] | None = None) -> ReducedDynamics:
        """Return reduced mass matrix and bias at a state."""
        coordinates, state = self.coordinates(q, joints), self._closures.state(q, v)
        svd = self._projection.svd(q, state)
        h = np.array(pin.nonLinearEffects(self._model, self._data, q, v))
        N, LT = coordinates.null_space, svd.factor.T
        a_0 = svd.least_motion(-state.drift)
        a_0 = a_0 - N @ a_0[coordinates.indices]
        LN = LT @ N
        return ReducedDynamics(coordinates, LN.T @ LN, N.T @ (h + svd.factor @ (LT @ a_0)))

    def moved(self, q: Array, coordinates: MinimalCoordinates, deviation: Array) -> Array:
        """Return the configuration on the closures whose independent joints are moved by a deviation.

        Newton steps dq with dq[indices] = 0 close the others: dq = x - N x[indices], x = -M^-1 J^T (...)^+ e.

        Raises:
            ArgumentError: the steps do not close it, since the chain is singular nearby.
        """
        N, indices = coordinates.null_space, coordinates.indices
        q = pin.integrate(self._model, q, N @ deviation)
        for _ in range(_STEPS):
            state = self._closures.state(q, self._still)
            x = self._projection.svd(q, state).least_motion(-state.position)
            dq = x - N @ x[indices]
            q = pin.integrate(self._model, q, dq)
            if np.abs(dq).max(initial=0.0) < _AT_REST:
                break
        gap = float(np.abs(self._closures.state(q, self._still).position).max(initial=0.0))
        if not gap <= _CLOSED:
            raise ArgumentError(
                f"the closed chain is singular near q: with its independent joints moved by"
                f" {float(np.abs(deviation).max()):.3g} rad or m the closures stay open by {gap:.3g}"
            )
        return q
