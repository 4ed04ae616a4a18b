"""Least squeeze within friction cones: internal wrenches with which pads just hold the payload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import ArgumentError
from coop_pin.base.spatial.limit_surface import motion_maps
from coop_pin.description.cell.cell import Cell
from coop_pin.description.cell.contact import Pad

_LARGEST = 1e5
"""Largest sum of normal forces that is considered, in parts of the largest load over mu."""
_ACCURACY, _ACCEPTED = 1e-10, 1e-7
"""Of costs and cones, in the same parts: of a solution that is complete, and of one that rounding ended."""


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
    keeps it from tipping. Among equals it is a solution within the cones, near the one farthest from them:
    Clarabel, an interior-point method, finds it.

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
    A, b, turn = np.zeros((m, 6, basis.shape[2])), np.zeros((m, 6)), np.eye(4)
    turn[:3, :3] = X_WP[:3, :3]
    for i, name in enumerate(cell.arms):
        X_PG = turn @ cell.grasps[name].matrix
        A[i] = cell.pads[name].in_plane(basis[i].T, X_PG).T
        b[i] = cell.pads[name].in_plane(loads[i] / scale, X_PG)
    cones = _cones([cell.pads[name] for name in cell.arms], A, b)
    cost = np.zeros(cones.n.shape[1])
    cost[: A.shape[2]] = A[:, 2].sum(axis=0)
    x = _least(cost, cones)
    if x is None:
        raise ArgumentError(
            "friction at the pads holds no such motion: whatever the arms press, a pad lacks"
            f" {scale * _missing(cost, cones):.3g} N; press across the payload, or raise mu or radius"
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
    k, flat = len(pad.points), motion_maps(pad.points).reshape(-1, 3).T
    inverse, free = np.linalg.pinv(flat), np.linalg.svd(flat)[2][3:].T
    return k / pad.mu * np.asarray(inverse, float).reshape(k, 2, 3), free.reshape(k, 2, -1)


def _least(cost: Array, cones: _Cones) -> Array | None:
    """Return the x of least cost . x in cones, shape (x,); None without one of an allowed cost."""
    import clarabel  # slow to load
    from scipy.sparse import csc_matrix

    settings, size = clarabel.DefaultSettings(), len(cost)
    settings.verbose, settings.equilibrate_enable = False, False
    for kind in ("gap_abs", "gap_rel", "feas"):
        setattr(settings, f"tol_{kind}", _ACCURACY)
        setattr(settings, f"reduced_tol_{kind}", _ACCEPTED)
    A = np.concatenate((cones.n[:, None], cones.S), axis=1)
    b = np.concatenate((cones.n_0[:, None], cones.s), axis=1)
    kinds = [clarabel.SecondOrderConeT(A.shape[1])] * len(A)
    program = csc_matrix((size, size)), cost, csc_matrix(-A.reshape(-1, size)), b.ravel(), kinds
    solution = clarabel.DefaultSolver(*program, settings).solve()
    is_solved = solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    return np.array(solution.x) if is_solved and solution.obj_val <= _LARGEST else None


def _missing(cost: Array, cones: _Cones) -> float:
    """Return the least y by which all cones must move until there is an x of an allowed cost in them."""
    count, y = len(cones.n), np.append(np.zeros(len(cost)), 1.0)
    n = np.vstack((np.hstack((cones.n, np.ones((count, 1)))), np.append(-cost, 0.0), y))
    wider = _Cones(
        S=np.pad(cones.S, ((0, 2), (0, 0), (0, 1))),
        s=np.pad(cones.s, ((0, 2), (0, 0))),
        n=n,
        n_0=np.append(cones.n_0, (_LARGEST, 0.0)),
    )
    x = _least(y, wider)
    return np.nan if x is None else float(x[-1])
