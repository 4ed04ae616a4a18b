"""Minimal coordinates of a closed chain: independent joints, null space, reduced mass matrix and bias."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from coop_pin.arrays import Array
from coop_pin.chain.closure_set import ClosureState
from coop_pin.chain.kkt_solver import ConstraintSVD
from coop_pin.errors import ArgumentError

Indices: TypeAlias = NDArray[np.intp]

_CONDITION_ALLOWED = 1e8
"""Condition number of the independent rows of the null space beyond which they are dependent."""


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


def velocity_basis(svd: ConstraintSVD) -> Array:
    """Return Z with J Z = 0 and Z^T M Z = 1, shape (nv, d).

    Args:
        svd: decomposition of the constraint Jacobian, J L^-T = U s V^T. The last columns of a complete
            orthonormal basis that begins with V span what is orthogonal to it, and L^-T takes them to
            velocities.
    """
    Q = np.linalg.qr(svd.right, mode="complete")[0]
    return np.asarray(scipy.linalg.solve_triangular(svd.factor, Q[:, svd.rank :], lower=True, trans=1))


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


def stated_coordinates(Z: Array, names: tuple[str, ...], indices: Indices) -> MinimalCoordinates:
    """Return stated independent velocities.

    Args:
        Z: basis of the velocities, shape (nv, d).
        names: names of their joints, for the message.
        indices: their entries of v.

    Raises:
        ArgumentError: they are not as many as the degrees of freedom, or depend on each other.
    """
    coordinates = best_conditioned(Z, indices)
    if coordinates is None or len(indices) != Z.shape[1]:
        raise ArgumentError(
            f"the joints {', '.join(names) or '(none)'} are not independent coordinates here: {len(indices)}"
            f" are stated, the closed chain has {Z.shape[1]} degrees of freedom; leave joints out to have"
            " them chosen"
        )
    return coordinates


def reduced_dynamics(
    svd: ConstraintSVD, state: ClosureState, h: Array, coordinates: MinimalCoordinates
) -> ReducedDynamics:
    """Return reduced mass matrix and bias.

    Args:
        svd: decomposition of the constraint Jacobian; its factor L gives M = L L^T.
        state: closures of the state, for J and gamma.
        h: Coriolis, centrifugal and gravity forces of the tree, shape (nv,).
        coordinates: independent velocities at the state.
    """
    N, LT = coordinates.null_space, svd.factor.T
    a_0 = svd.least_motion(-state.drift)
    a_0 = a_0 - N @ a_0[coordinates.indices]
    LN = LT @ N
    return ReducedDynamics(coordinates, LN.T @ LN, N.T @ (h + svd.factor @ (LT @ a_0)))
