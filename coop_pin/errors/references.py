"""Desired motions that cannot be followed as given."""

from __future__ import annotations

from coop_pin.errors.root import CoopPinError


class InconsistentReferenceError(CoopPinError, ValueError):
    """A desired twist or acceleration is not the derivative of what it belongs to.

    Attributes:
        quantity: what disagrees, for example "linear part of V_WP_d".
        time: the time at which it disagrees most, s.
        gap: norm of the difference there, SI.
    """

    def __init__(self, quantity: str, time: float, gap: float, allowed: float) -> None:
        self.quantity, self.time, self.gap = quantity, time, gap
        super().__init__(
            f"the {quantity} disagrees with central differences by {gap:.3g} at t = {time:.6g} s (allowed {allowed:.3g});"
            " check its axes (world), its order (linear first) and its signs, or leave it out"
        )


class ReferenceFileError(CoopPinError, ValueError):
    """A file is not readable as a table of poses.

    Attributes:
        path: the file.
        line: number of the bad line, counted from one; zero for the file as a whole.
    """

    def __init__(self, path: str, line: int, detail: str) -> None:
        self.path, self.line = path, line
        super().__init__(f"{path}, line {line}: {detail}" if line else f"{path}: {detail}")
