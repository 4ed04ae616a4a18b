"""Rows of one arm's grasp: the wrenches that it transmits, and the split of a load within those of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.spatial.pose import log3, rotate_vector6, shift_wrench
from coop_pin.base.spatial.task_rows import FullRows, TaskRows

_ALONG = 1e-6
"""Sine of an angle that counts as zero."""
_RANK = 1e-6
"""Ratio below which singular values and parts of wrenches are zero; stated angles are rounded."""


@dataclass(frozen=True, eq=False)
class GraspRows(TaskRows):
    """Rows of twists, wrenches and errors that a grasp holds, about its frame C in axes of C as desired.

    A hinge about z holds all but the turn about z, a ball the three positions. In a planar cell only those
    in the plane count.

    Attributes:
        task: task rows of the cell.
        X_PC: pose of C in the payload frame, shape (4, 4).
        indices: rows in axes of C, a subset of 0..5.
    """

    task: TaskRows
    X_PC: Array
    indices: tuple[int, ...]

    name: Any = "grasp"

    @classmethod
    def of(cls, task: TaskRows, X_PC: Array, held: Sequence[bool]) -> GraspRows | None:
        """Return the rows of a grasp in the task rows of a cell; None if one is neither in them nor across.

        Args:
            task: task rows of the cell.
            X_PC: pose of C in the payload frame, shape (4, 4).
            held: mask of the six rows in axes of C that are held.
        """
        turned = np.zeros((6, 6))
        turned[:3, :3] = turned[3:, 3:] = X_PC[:3, :3]
        inside = np.linalg.norm(turned[list(task.indices)], axis=0)
        if np.any((inside > _ALONG) & (inside < 1.0 - _ALONG) & np.array(held)):
            return None
        return cls(task, X_PC, tuple(np.flatnonzero((inside > 0.5) & np.array(held)).tolist()))

    @property
    def axes(self) -> tuple[str, ...]:  # type: ignore[override]
        """A label for each row."""
        return tuple(FullRows.axes[index] for index in self.indices)

    @property
    def wrenches(self) -> Array:
        """B: wrench about P in payload axes on the task rows of a unit of each row, shape (k_0, k)."""
        in_payload = rotate_vector6(self.X_PC[:3, :3], np.eye(6)[list(self.indices)])
        B: Array = shift_wrench(in_payload, np.tile(self.X_PC[:3, 3], (self.size, 1))).T
        return B[list(self.task.indices)]

    def select(self, vector6: Array) -> Array:
        """Return the rows of a six-vector in axes of C, shape (k,), or of a (6, n) matrix, shape (k, n)."""
        return vector6.take(np.array(self.indices), axis=0)

    def pose_error(self, X_WC: Array, X_WC_d: Array) -> Array:
        """Return R_d^T [p - p_d, turn], shape (k,); of two held turns the tilt of the third axis."""
        R_d = X_WC_d[:3, :3]
        R = R_d.T @ X_WC[:3, :3]
        turn = log3(R) if {3, 4, 5} <= {*self.indices} else np.array((-R[1, 2], R[0, 2], 0.0))
        return self.select(np.concatenate((R_d.T @ (X_WC[:3, 3] - X_WC_d[:3, 3]), turn)))

    def turn(self, X_WC: Array, rows: Array) -> Array:
        """Return the rows themselves, which are in axes of C."""
        return rows

    def twist_shift(self, displacement: Array) -> Array:
        """Return A of the rows, for a displacement in axes of C, shape (k, k)."""
        return FullRows().twist_shift(displacement)[np.ix_(self.indices, self.indices)]


def unheld_motion(wrenches: Sequence[Array]) -> Array | None:
    """Return a twist of the payload that no grasp holds, G^T V = 0, shape (k_0,); None if there is none."""
    V, sizes, _ = np.linalg.svd(np.hstack(list(wrenches)))
    rank = int((sizes > _RANK * sizes[0]).sum())
    return V[:, rank] if rank < len(V) else None


def transmitted_loads(wrenches: Sequence[Array], shares: Array, task: TaskRows, length: float) -> Array:
    """Return L_i with the load L_i sum_j F_j of each arm within what its grasp transmits, shape (m, 6, 6).

    It is the load part of least sum_i F_i^T Q F_i / c_i with Q = diag(1, 1, 1, 1/l^2, 1/l^2, 1/l^2)::

        W_i = c_i B_i (B_i^T Q B_i)^-1 B_i^T,    L_i = W_i (sum_j W_j)^+

    Of rigid grasps alone W_i = c_i Q^-1, and L_i = c_i: the split by load shares. A force as large as a
    moment over l costs the same. Rows outside the task rows are split by the shares.

    Args:
        wrenches: B_i of all arms, shape (k_0, k_i) each; zero columns bear nothing.
        shares: c_i, shape (m,).
        task: task rows of the cell.
        length: l, m.
    """
    Q = np.diag(np.where(task.are_linear, 1.0, length**-2))
    W = np.array(
        [c * B @ np.linalg.inv(B.T @ Q @ B) @ B.T for c, B in zip(shares.tolist(), wrenches, strict=True)]
    )
    L: Array = np.einsum("i,jk->ijk", shares, np.eye(6))
    L[np.ix_(range(len(L)), task.indices, task.indices)] = W @ np.linalg.pinv(W.sum(axis=0), _RANK)
    return L


def transmits(B: Array, F: Array) -> bool:
    """Return whether a grasp transmits wrenches on its arm, up to rounding.

    Args:
        B: wrenches of ``GraspRows`` in the axes of F, shape (k_0, k).
        F: wrenches about P on the task rows, shape (k_0,) or (k_0, n).
    """
    left = F - B @ np.linalg.lstsq(B, F, rcond=None)[0]
    return bool(np.linalg.norm(left) <= _RANK * (1.0 + np.linalg.norm(F)))
