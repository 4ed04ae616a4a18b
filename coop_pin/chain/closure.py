"""A closure: two frames of a tree that are held together in some rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from coop_pin.errors import FieldError

RowMask = tuple[bool, bool, bool, bool, bool, bool]
NamedRows = Literal["full", "point", "planar", "axis"]

_MASKS: dict[str, RowMask] = {
    "full": (True,) * 6,
    "point": (True, True, True, False, False, False),
    "planar": (True, True, False, False, False, True),
    "axis": (True, True, True, True, True, False),
}


@dataclass(frozen=True)
class Closure:
    """Frame a is held to frame b.

    Rows are counted in the axes of frame a: "full" (a weld), "point" (a ball joint), "planar" (x, y and the turn about z),
    "axis" (a hinge about z), or six booleans, linear first.

    Attributes:
        frame_a: name of a frame.
        frame_b: name of the other frame; "universe" is the world.
        rows: which relative motions are held.
    """

    frame_a: str
    frame_b: str
    rows: NamedRows | Sequence[bool] = "full"

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
        if len(self.rows) != 6 or not any(self.rows):
            raise FieldError(f"is {list(self.rows)}; it must be six booleans, at least one of them true", "rows")
        x, y, z, rx, ry, rz = map(bool, self.rows)
        return (x, y, z, rx, ry, rz)

    @property
    def name(self) -> str:
        """A name for messages."""
        return f"{self.frame_a} - {self.frame_b}"
