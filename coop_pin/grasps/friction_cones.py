"""Least squeeze within friction cones: internal wrenches with which pads just hold the payload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial import rotate_vector6, shift_wrench
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Pad

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

        sum_j (tau_ij, x_ij x tau_ij) = (t_i, m_i),    |tau_ij| <= mu_i N_i / k_i,    |b_i / l_i| <= N_i

    (t_i, N_i, b_i, m_i) is the wrench of load and f_i on arm i about the middle of its pad in axes of the
    plane: friction, normal force, moment in the plane and about the normal; l_i are the levers of the pad.
    Frictions tau_ij of its k_i points x_ij, evenly pressed, make its ``spatial.limit_surface``; the last cone
    keeps it from tipping. Among equals it is the solution farthest from the cones.

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
    A, b = np.zeros((m, 6, basis.shape[2])), np.zeros((m, 6))
    for i, name in enumerate(cell.arms):
        X = X_WP @ cell.grasps[name].matrix @ cell.pads[name].plane
        p, turn = X[:3, 3] - X_WP[:3, 3], X[:3, :3].T
        A[i] = rotate_vector6(turn, shift_wrench(basis[i].T, -p)).T
        b[i] = rotate_vector6(turn, shift_wrench(loads[i] / scale, -p))
    cones = _cones([cell.pads[name] for name in cell.arms], A, b)
    cost = np.zeros(cones.n.shape[1])
    cost[: A.shape[2]] = A[:, 2].sum(axis=0)
    x, missing = _least(cost, cones)
    if missing >= 0.0:
        raise ArgumentError(
            "friction at the pads holds no such motion: whatever the arms press, a pad lacks"
            f" {scale * missing:.3g} N; press across the payload, or raise mu or radius"
        )
    x = x[: A.shape[2]]
    return Squeeze(scale * basis @ x, scale * (A[:, 2] @ x + b[:, 2]))


def _cones(pads: Sequence[Pad], A: Array, b: Array) -> _Cones:
    """Return the cones of points and pads; x are internal wrenches and frictions without a resultant.

    Args:
        pads: Pad of each arm.
        A: Wrenches on the pads by each internal wrench, shape (m, 6, y).
        b: Wrenches on the pads by the loads, shape (m, 6).
    """
    maps = [_point_frictions(pad) for pad in pads]
    sizes = np.cumsum([A.shape[2], *(free.shape[2] for _, free in maps)])
    cones = list[tuple[Array, Array, Array, float]]()
    for pad, (of_wrench, free), A_i, b_i, end in zip(pads, maps, A, b, sizes[1:], strict=True):
        n = np.zeros(sizes[-1])
        n[: sizes[0]] = A_i[2]
        for of_load, alone in zip(of_wrench, free, strict=True):
            S = np.zeros((2, sizes[-1]))
            S[:, : sizes[0]], S[:, end - free.shape[2] : end] = of_load @ A_i[[0, 1, 5]], alone
            cones.append((S, of_load @ b_i[[0, 1, 5]], n, b_i[2]))
        tilt = np.zeros((2, sizes[-1]))
        tilt[:, : sizes[0]] = A_i[3:5] / pad.levers[:, None]
        cones.append((tilt, b_i[3:5] / pad.levers, n, b_i[2]))
    return _Cones(*(np.array(part) for part in zip(*cones, strict=True)))


def _point_frictions(pad: Pad) -> tuple[Array, Array]:
    """Return frictions of k points in parts of mu / k: of (t, m), (k, 2, 3), and of none, (k, 2, 2 k - 3)."""
    (x, y, _), k = pad.points.T, len(pad.points)
    G = np.zeros((3, k, 2))
    G[0, :, 0] = G[1, :, 1] = 1.0
    G[2, :, 0], G[2, :, 1] = -y, x
    flat = G.reshape(3, -1)
    inverse, free = np.linalg.pinv(flat), np.linalg.svd(flat)[2][3:].T
    return k / pad.mu * np.asarray(inverse, float).reshape(k, 2, 3), free.reshape(k, 2, -1)


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
            step = -scipy.linalg.lstsq(hessian, gradient, lapack_driver="gelsy", check_finite=False)[0]
            decrement = -float(gradient @ step)
            if not decrement > _AT_REST:
                break
            x = x + step / (1.0 if decrement < _QUADRATIC else 1.0 + np.sqrt(decrement))
            if cost @ x < enough:
                return x
        t *= _FASTER
    return x
