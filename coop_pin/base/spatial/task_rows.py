"""Task rows: the rows of twists, wrenches and pose errors that a cell controls."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal

import numpy as np

from coop_pin.base.arrays import Array, Mask, require_type
from coop_pin.base.errors import NameNotFoundError
from coop_pin.base.spatial.generic_numbers import Traceable, atan2
from coop_pin.base.spatial.pose import pose_error

RowsName = Literal["planar", "positional", "full"]

_ANGULAR_ROWS = np.eye(6)[3:].tolist()
_JOINTS = {5: "hinge", 4: "cylinder", 3: "ball"}
"""Grasps that hold fewer than six rows, by their number."""


class TaskRows(Traceable, ABC):
    """Task rows: the k_0 rows of six-vectors that a cell controls.

    Attributes:
        name: name in scenario files.
        indices: the rows, a subset of 0..5 (linear first).
        axes: a label for each row.
    """

    name: RowsName
    indices: tuple[int, ...]
    axes: tuple[str, ...]

    @property
    def size(self) -> int:
        """The number of rows, k_0."""
        return len(self.indices)

    @property
    def are_linear(self) -> Mask:
        """Which of them are translations, shape (k_0,)."""
        return np.array(self.indices) < 3

    @property
    def has_moments(self) -> bool:
        """Whether a rotation, and so a moment, is among the rows."""
        return max(self.indices) > 2

    @abstractmethod
    def select(self, vector6: Array) -> Array:
        """Return the rows of a six-vector, shape (k_0,), or of a (6, n) matrix, shape (k_0, n)."""

    @abstractmethod
    def pose_error(self, X_WP: Array, X_WP_d: Array) -> Array:
        """Return the rows of the pose error, actual minus desired, in world axes, shape (k_0,)."""

    @abstractmethod
    def turn(self, X_WP: Array, rows_P: Array) -> Array:
        """Return the rows of a twist or wrench in world axes, from those in payload axes, shape (k_0,)."""

    @abstractmethod
    def twist_shift(self, displacement: Array) -> Array:
        """Return A with V_Q = A V_P for a point Q of the same body, shape (k_0, k_0).

        A wrench about P is A^-T F about Q, and A^-1 is the matrix of the opposite displacement.

        Args:
            displacement: displacement from P to Q in world axes, m, shape (3,).
        """

    def expand(self, rows: Array) -> Array:
        """Return a six-vector with the rows in place and zeros elsewhere, shape (..., 6)."""
        vector6 = np.zeros((*rows.shape[:-1], 6))
        vector6[..., self.indices] = rows
        return vector6


class FullRows(TaskRows):
    """All six rows."""

    name: RowsName = "full"
    indices = (0, 1, 2, 3, 4, 5)
    axes = ("x", "y", "z", "rx", "ry", "rz")

    def select(self, vector6: Array) -> Array:
        """Return the six-vector itself."""
        return vector6

    def pose_error(self, X_WP: Array, X_WP_d: Array) -> Array:
        """Return ``[p - p_d, log(R R_d^T)]``, shape (6,)."""
        return pose_error(X_WP, X_WP_d)

    def turn(self, X_WP: Array, rows_P: Array) -> Array:
        """Return ``[R f, R n]``, shape (6,)."""
        return rows_P.reshape(2, 3).dot(X_WP[:3, :3].T).reshape(6)

    def twist_shift(self, displacement: Array) -> Array:
        """Return the matrix of ``[v + w x r, w]``, shape (6, 6)."""
        x, y, z = displacement.tolist()
        linear = ((1.0, 0.0, 0.0, 0.0, z, -y), (0.0, 1.0, 0.0, -z, 0.0, x), (0.0, 0.0, 1.0, y, -x, 0.0))
        return np.array((*linear, *_ANGULAR_ROWS))


class PlanarRows(TaskRows):
    """x, y and the rotation about z: motion in the horizontal plane of the world."""

    name: RowsName = "planar"
    indices = (0, 1, 5)
    axes = ("x", "y", "rz")
    _take = np.array(indices)

    def select(self, vector6: Array) -> Array:
        """Return rows x, y, rz."""
        return vector6.take(self._take, axis=0)

    def pose_error(self, X_WP: Array, X_WP_d: Array) -> Array:
        """Return ``[x - x_d, y - y_d, psi - psi_d]`` with the angle in (-pi, pi], shape (3,).

        For planar poses this is the log of the rotation error, at a tenth of its cost.
        """
        cosine, sine = X_WP.item(0), X_WP.item(4)
        cosine_d, sine_d = X_WP_d.item(0), X_WP_d.item(4)
        angle = atan2(sine * cosine_d - cosine * sine_d, cosine * cosine_d + sine * sine_d)
        return np.array((X_WP.item(3) - X_WP_d.item(3), X_WP.item(7) - X_WP_d.item(7), angle), like=X_WP)

    def turn(self, X_WP: Array, rows_P: Array) -> Array:
        """Return ``[c f_x - s f_y, s f_x + c f_y, n_z]``, shape (3,)."""
        cosine, sine = X_WP.item(0), X_WP.item(4)
        x, y, moment = rows_P.tolist()
        return np.array((cosine * x - sine * y, sine * x + cosine * y, moment), like=X_WP)

    def twist_shift(self, displacement: Array) -> Array:
        """Return the matrix of ``[v_x - w r_y, v_y + w r_x, w]``, shape (3, 3)."""
        x, y, _ = displacement.tolist()
        return np.array(((1.0, 0.0, -y), (0.0, 1.0, x), (0.0, 0.0, 1.0)))


class PositionalRows(TaskRows):
    """x, y and z: the orientation of the payload is not controlled."""

    name: RowsName = "positional"
    indices = (0, 1, 2)
    axes = ("x", "y", "z")

    def select(self, vector6: Array) -> Array:
        """Return the linear rows."""
        return vector6[:3]

    def pose_error(self, X_WP: Array, X_WP_d: Array) -> Array:
        """Return ``p - p_d``, shape (3,)."""
        return X_WP[:3, 3] - X_WP_d[:3, 3]

    def turn(self, X_WP: Array, rows_P: Array) -> Array:
        """Return ``R f``, shape (3,)."""
        return X_WP[:3, :3] @ rows_P

    def twist_shift(self, displacement: Array) -> Array:
        """Return the identity: these rows see no rotation, so that the moment of it is not known."""
        return np.eye(3)


_ROWS: dict[str, TaskRows] = {rows.name: rows for rows in (FullRows(), PlanarRows(), PositionalRows())}


def task_rows(name: RowsName) -> TaskRows:
    """Return the task rows of a name.

    Raises:
        NameNotFoundError: there are none of that name.
    """
    require_type("name", name, str)
    if name not in _ROWS:
        raise NameNotFoundError("kind of task rows", name, _ROWS, "cp.spatial")
    return _ROWS[name]


def joint_shortage(joints: int, rows: int) -> str:
    """Return the joint and row counts of an arm with fewer joints than task rows, and what to do."""
    remedies = [f"choose an arm with at least {rows} moving joints"]
    if joints >= len(PlanarRows.indices):
        remedies.insert(0, "set cell.rows to 'positional' or 'planar' (3 rows)")
    if rows == len(FullRows.indices) and joints in _JOINTS:
        remedies.insert(0, f"make its grasp a joint of kind {_JOINTS[joints]!r} ({joints} rows)")
    return f"{joints} joints, {rows} task rows: {', or '.join(remedies)}"
