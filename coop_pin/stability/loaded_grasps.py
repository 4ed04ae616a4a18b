"""Grasps that give and bear a load: where they are then, and how their wrenches turn with what they hold."""

from __future__ import annotations

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import TaskRows
from coop_pin.description.cell.cell import Cell


def give_way(cell: Cell, K: Array, borne: Array) -> tuple[Array, Array, Array]:
    """Return by how much tips are off P under wrenches, and points and stiffnesses of the grasps there.

    A spring acts at the tip, and moves with it; a palm moves along its normal only, as it starts without
    shear. All in payload axes.

    Args:
        cell: Cell.
        K: Stiffnesses about P, 0 of rigid grasps, shape (m, k_0, k_0).
        borne: Wrenches on the arms about P, 0 of rigid grasps, N and N m, shape (m, k_0).

    Returns:
        off: pose of the tip's P from the payload's, m and rad, shape (m, k_0).
        r: points of the grasps from P, m, shape (m, 3).
        K: stiffnesses about P of springs at these points, shape (m, k_0, k_0).
    """
    rows, points, stiffnesses = cell.task_rows, list[Array](), list[Array]()
    off = np.zeros((len(K), 6))
    for i, (arm, grasp) in enumerate(cell.grasps.items()):
        r = np.array(grasp.xyz)
        if K[i].any():
            off[i] = -rows.expand(np.linalg.solve(K[i], borne[i]))
        moved = off[i, :3] + np.cross(off[i, 3:], r)
        if arm in cell.patches:
            out = cell.way_out(arm)
            moved = out * (out @ moved)
            off[i] = np.append(moved, np.zeros(3))
        A = rows.twist_shift(moved)
        points.append(r + moved)
        stiffnesses.append(A.T @ K[i] @ A)
    return rows.select(off.T).T, np.array(points), np.array(stiffnesses)


def changes_under_load(rows: TaskRows, W: Array, r: Array) -> tuple[Array, Array, Array]:
    """Return T, L, S, by which wrenches on arms and on the payload change with the poses, (m, k_0, k_0) each.

    A grasp that gives holds W = (f, n) about P in payload axes, at a point r from P that is of the arm. With
    theta of the payload, and d and phi of the arm from it, besides the spring on the arm and on the payload::

        dW = T theta + L phi,  -dW - S d,    T theta = (theta x f, theta x n),  L phi = (0, (phi x r) x f),
                                             S d = (0, d x f)

    Two palms that press against each other give way sidewards by these if springs and law are too soft.

    Args:
        rows: Task rows.
        W: Wrenches on the arms about P in world axes, N and N m, shape (m, k_0).
        r: Points of the grasps from P in world axes, m, shape (m, 3).
    """
    W = rows.expand(W)
    f, n = _cross(W[:, :3]), _cross(W[:, 3:])
    T, L, S = np.zeros((3, len(W), 6, 6))
    T[:, :3, 3:], T[:, 3:, 3:] = -f, -n
    L[:, 3:, 3:], S[:, 3:, :3] = f @ _cross(r), -f
    controlled = np.ix_(range(len(W)), rows.indices, rows.indices)
    return T[controlled], L[controlled], S[controlled]


def _cross(vectors: Array) -> Array:
    """Return the matrices [v] with [v] u = v x u, shape (m, 3, 3)."""
    return np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2)
