"""Least squeeze within friction cones: internal wrenches with which pads just hold the payload."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, Mask
from coop_pin.description.cell import Cell
from coop_pin.errors import ArgumentError
from coop_pin.spatial import rotate_vector6, shift_wrench

_LARGEST = 1e5
"""Largest sum of normal forces that is considered, in parts of the largest load over mu."""
_GAP, _FASTER = 1e-11, 30.0
"""Accepted distance from the least cost, and growth of the barrier's weight t."""
_AT_REST, _QUADRATIC, _NEWTON_STEPS = 1e-8, 0.06, 100
"""Decrement of Newton's method that is rounding, that from which it needs no damping, and its most steps."""


class Squeeze(NamedTuple):
    """Least squeeze of a cell by friction, of one state or of n states.

    Attributes:
        internal: internal wrench f_i on each arm by the payload, about P in world axes, shape (..., m, 6).
        normal: normal force N_i of each pad, load included, N, shape (..., m).
    """

    internal: Array
    normal: Array


class _Cones(NamedTuple):
    """Second-order cones ``|S x + s| <= n . x + n_0``; S (c, k, x), s (c, k), n (c, x), n_0 (c,)."""

    S: Array
    s: Array
    n: Array
    n_0: Array


def friction_squeeze(cell: Cell, X_WP: Array, loads: Array, rows: Mask) -> Squeeze:
    """Return the internal wrenches f_i of least sum of N_i at which all pads stick; the f_i sum to zero.

    ::

        |(t_i, m_i / r_i)| <= mu_i N_i,    |b_i / l_i| <= N_i

    (t_i, N_i, b_i, m_i) is the wrench of load and f_i on arm i about the middle of its pad in axes of the
    plane: friction, normal force, moment in the plane and about the normal; r_i is the torsion radius, l_i
    are the levers of the pad. The first cone is an ellipsoid, outside the limit surface of
    ``spatial.limit_surface`` by up to 8 % for a disc and 16 % for a rectangle of 3 to 1. The second keeps the
    patch from tipping. Among equals it is the solution farthest from the cones.

    Args:
        cell: description, with a pad of every arm.
        X_WP: payload pose, shape (4, 4).
        loads: load of each arm about P in world axes, N and N m, shape (m, 6).
        rows: mask of the rows, about P in world axes, in which f_i may be, shape (6,).

    Raises:
        ArgumentError: no f_i keeps all pads within their cones.
    """
    m = len(loads)
    scale = (float(np.abs(loads).max()) or 1.0) / min(pad.mu for pad in cell.pads.values())
    sums_to_zero = np.linalg.svd(np.ones((1, m)))[2][1:].T
    basis = np.einsum("ij,rk->irjk", sums_to_zero, np.eye(6)[:, rows]).reshape(m, 6, -1)
    A, b, limits = np.zeros((m, 6, basis.shape[2])), np.zeros((m, 6)), np.zeros((2 * m, 6))
    for i, name in enumerate(cell.arms):
        pad, X = cell.pads[name], X_WP @ cell.grasps[name].matrix @ cell.pads[name].plane
        p, turn, r = X[:3, 3] - X_WP[:3, 3], X[:3, :3].T, pad.torsion_radius
        A[i] = rotate_vector6(turn, shift_wrench(basis[i].T, -p)).T
        b[i] = rotate_vector6(turn, shift_wrench(loads[i] / scale, -p))
        limits[i, [0, 1, 5]] = np.array((1.0, 1.0, 1.0 / r)) / pad.mu
        limits[m + i, 3:5] = 1.0 / pad.levers
    both = np.r_[:m, :m]
    cones = _Cones(limits[:, :, None] * A[both], limits * b[both], A[both, 2], b[both, 2])
    cost = cones.n[:m].sum(axis=0)
    x, missing = _least(cost, cones)
    if missing >= 0.0:
        raise ArgumentError(
            "friction at the pads holds no such motion: whatever the arms press, a pad lacks"
            f" {scale * missing:.3g} N; press across the payload, or raise mu or radius"
        )
    return Squeeze(scale * basis @ x, scale * (A[:, 2] @ x + b[:, 2]))


def _least(cost: Array, cones: _Cones) -> tuple[Array, float]:
    """Return the x of least cost in cones, and by how much a wider x_0 does not fit; negative if it does.

    A first search moves all cones by y and minimises y until it is negative. The cost is limited, so that
    neither search goes to infinity.
    """
    count, rows, size = cones.S.shape
    limit = _Cones(np.zeros((1, rows, size)), np.zeros((1, rows)), -cost[None], np.array([_LARGEST]))
    limited = _Cones(*map(np.concatenate, zip(cones, limit, strict=True)))
    moved = np.append(np.ones(count), 0.0)[:, None]
    wider = limited._replace(
        S=np.concatenate((limited.S, np.zeros((count + 1, rows, 1))), axis=2), n=np.hstack((limited.n, moved))
    )
    outside = float((np.linalg.norm(cones.s, axis=1) - cones.n_0).max())
    x = np.append(np.zeros(size), 1.0 + max(outside, 0.0))
    x = _descend(np.append(np.zeros(size), 1.0), wider, x, enough=-_GAP)
    return (x, x[-1]) if x[-1] >= 0.0 else (_descend(cost, limited, x[:-1]), x[-1])


def _descend(cost: Array, cones: _Cones, x: Array, *, enough: float = -np.inf) -> Array:
    """Return the x of least cost . x from one inside the cones, by Newton's method on a logarithmic barrier.

    phi_t(x) = t cost . x - sum_i ln((n_i . x + n_0i)^2 - |S_i x + s_i|^2),    t = 1, 30, 900, ...

    The minimiser of phi_t costs at most 2 c / t more than the least (Boyd and Vandenberghe, Convex
    Optimization, 2004, section 11.3). phi_t is self-concordant: damped steps stay inside.

    Args:
        cost: shape (x,).
        cones: cones.
        x: start inside all of them.
        enough: cost at which to end.
    """
    (S, s, n, n_0), t = cones, 1.0
    shape = np.einsum("ci,cj->cij", n, n) - np.einsum("cki,ckj->cij", S, S)
    while 2.0 * len(n) / t > _GAP:
        for _ in range(_NEWTON_STEPS):
            side, axis = S @ x + s, n @ x + n_0
            f = axis**2 - (side**2).sum(axis=1)
            slopes = 2.0 * (axis[:, None] * n - np.einsum("ck,cki->ci", side, S)) / f[:, None]
            gradient = t * cost - slopes.sum(axis=0)
            hessian = slopes.T @ slopes - 2.0 * np.einsum("cij,c->ij", shape, 1.0 / f)
            step = -np.linalg.lstsq(hessian, gradient, rcond=None)[0]
            decrement = -float(gradient @ step)
            if not decrement > _AT_REST:
                break
            x = x + step / (1.0 if decrement < _QUADRATIC else 1.0 + np.sqrt(decrement))
            if cost @ x < enough:
                return x
        t *= _FASTER
    return x
