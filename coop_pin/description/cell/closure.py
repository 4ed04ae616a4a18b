"""Loop closure: two frames of a tree that are held together in some rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import as_pose, frozen, require_type
from coop_pin.base.errors import FieldError

RowMask = tuple[bool, bool, bool, bool, bool, bool]
NamedRows = Literal["full", "point", "planar", "axis", "cylinder"]

_MASKS: dict[str, RowMask] = {
    "full": (True,) * 6,
    "point": (True, True, True, False, False, False),
    "planar": (True, True, False, False, False, True),
    "axis": (True, True, True, True, True, False),
    "cylinder": (True, True, False, True, True, False),
}


def row_mask(rows: NamedRows) -> RowMask:
    """Return which of the six rows a name holds."""
    return _MASKS[rows]


@dataclass(frozen=True, eq=False)
class Closure:
    """Loop closure: a frame C on a frame A of a tree is held to the same frame C on a frame B.

    A and B are named frames (links or joints of the URDF, or the world); X_AC and X_BC place C anywhere on
    them, without a change to the URDF. "Frame a" of the closure is C as attached to A, "frame b" is C as
    attached to B. When the closure is closed, X_WA X_AC = X_WB X_BC in the held rows.

    The rows refer to the axes of frame a: "full" (a weld), "point" (a ball joint), "planar" (x, y and the
    rotation about z), "axis" (a hinge about z), "cylinder" (turns about z and slides along it), or six
    booleans, linear first: (True, False, False, False, False, False) holds x alone.

    Attributes:
        frame_a: name of frame A; "world" or "universe" is the world.
        frame_b: name of frame B, likewise.
        rows: relative motions that are held.
        X_AC: pose of C in A, shape (4, 4); identity when omitted.
        X_BC: pose of C in B, shape (4, 4); identity when omitted.
        name: name in messages; "A - B" with the names of the frames when omitted.
    """

    frame_a: str
    frame_b: str
    rows: NamedRows | Sequence[bool] = "full"
    X_AC: ArrayLike | None = None
    X_BC: ArrayLike | None = None
    name: str = ""

    def __post_init__(self) -> None:
        """Validate the poses and set the default name.

        Raises:
            WrongTypeError: name is not text.
            ShapeError, OutOfRangeError: X_AC or X_BC is not a pose.
        """
        for name, pose in (("X_AC", self.X_AC), ("X_BC", self.X_BC)):
            if pose is not None:
                object.__setattr__(self, name, frozen(as_pose(name, pose)))
        require_type("name", self.name, str)
        object.__setattr__(self, "name", self.name or f"{self.frame_a} - {self.frame_b}")

    @property
    def mask(self) -> RowMask:
        """Which of the six rows are held.

        Raises:
            FieldError: the rows are neither a known name nor six booleans with one true.
        """
        if isinstance(self.rows, str):
            if self.rows not in _MASKS:
                raise FieldError(
                    f"is {self.rows!r}; it must be one of {list(_MASKS)} or six booleans", "rows"
                )
            return _MASKS[self.rows]
        rows = list(self.rows) if isinstance(self.rows, Sequence | np.ndarray) else []
        if (
            len(rows) != 6
            or not all(isinstance(row, bool | int | np.bool_) and row in (0, 1) for row in rows)
            or not any(rows)
        ):
            raise FieldError(
                f"is {self.rows!r}; it must be six booleans, at least one of them true,"
                f" or one of {list(_MASKS)}",
                "rows",
            )
        x, y, z, rx, ry, rz = map(bool, rows)
        return (x, y, z, rx, ry, rz)
