"""A closure: two frames of a tree that are held together in some rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array, frozen
from coop_pin.errors import FieldError, NotAPoseError

RowMask = tuple[bool, bool, bool, bool, bool, bool]
NamedRows = Literal["full", "point", "planar", "axis"]

_MASKS: dict[str, RowMask] = {
    "full": (True,) * 6,
    "point": (True, True, True, False, False, False),
    "planar": (True, True, False, False, False, True),
    "axis": (True, True, True, True, True, False),
}
_POSE_ALLOWED = 1e-6


@dataclass(frozen=True, eq=False)
class Closure:
    """Frame a is held to frame b.

    Each frame is a named frame of the tree (a link or joint of the URDF, or the world), displaced by X_a or X_b where one is
    given: a closure can sit anywhere on a link without a change to the URDF.

    Rows are counted in the axes of frame a: "full" (a weld), "point" (a ball joint), "planar" (x, y and the turn about z),
    "axis" (a hinge about z), or six booleans, linear first: (True, False, False, False, False, False) holds x alone.

    Attributes:
        frame_a: name of a frame; "world" or "universe" is the world.
        frame_b: name of the other frame, likewise.
        rows: which relative motions are held.
        X_a: pose of the closure's frame a in the frame named frame_a, shape (4, 4); the frame itself when omitted.
        X_b: pose of the closure's frame b in the frame named frame_b, shape (4, 4); the frame itself when omitted.
    """

    frame_a: str
    frame_b: str
    rows: NamedRows | Sequence[bool] = "full"
    X_a: ArrayLike | None = None
    X_b: ArrayLike | None = None

    def __post_init__(self) -> None:
        """Check the poses.

        Raises:
            ShapeError, NotFiniteError, NotAPoseError: X_a or X_b is not a pose.
        """
        for name in ("X_a", "X_b"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _pose(name, getattr(self, name)))

    @property
    def mask(self) -> RowMask:
        """Which of the six rows are held.

        Raises:
            FieldError: the rows are neither a known name nor six booleans with one true.
        """
        if isinstance(self.rows, str):
            if self.rows not in _MASKS:
                raise FieldError(f"is {self.rows!r}; it must be one of {list(_MASKS)} or six booleans", "rows")
            return _MASKS[self.rows]
        rows = list(self.rows) if isinstance(self.rows, Sequence | np.ndarray) else []
        if len(rows) != 6 or not all(isinstance(row, bool | int | np.bool_) and row in (0, 1) for row in rows) or not any(rows):
            raise FieldError(f"is {self.rows!r}; it must be six booleans, at least one of them true, or one of {list(_MASKS)}", "rows")
        x, y, z, rx, ry, rz = map(bool, rows)
        return (x, y, z, rx, ry, rz)

    @property
    def name(self) -> str:
        """A name for messages."""
        return f"{self.frame_a} - {self.frame_b}"


def _pose(name: str, value: ArrayLike) -> Array:
    X = as_array(name, value, 4, 4)
    R = X[:3, :3]
    deviation = float(max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(X[3] - np.eye(4)[3]).max(), abs(np.linalg.det(R) - 1.0)))
    if deviation > _POSE_ALLOWED:
        raise NotAPoseError(name, deviation, _POSE_ALLOWED)
    return frozen(X)
