"""What a view of a run under way is, whatever draws it."""

from __future__ import annotations

import time
from typing import Protocol

from coop_pin.errors import NotPositiveError
from coop_pin.results import Viewing

FRAMES_PER_SECOND = 30.0


class Viewer(Viewing, Protocol):
    """Shows a run while it is under way; an Observer. None of its methods waits for anything or raises because nobody looks.

    What there is to see comes from ``LiveScene``: its scene is drawn once, and every moment becomes a frame that says where the nodes of
    the scene are and which colours its bodies have. A viewer adds neither physics nor geometry.
    """

    @property
    def url(self) -> str:
        """The address to look at, on this machine; "" where it cannot be served."""

    @property
    def is_alive(self) -> bool:
        """Whether frames still go anywhere."""

    def close(self) -> None:
        """End the view and give its port back."""


class FrameRate:
    """Says which moments of a run are worth showing: so many in a second of wall time, and no more."""

    def __init__(self, frames_per_second: float) -> None:
        """Start with a frame that is due.

        Raises:
            NotPositiveError: the rate is not greater than zero.
        """
        if not frames_per_second > 0.0:
            raise NotPositiveError("frames_per_second", frames_per_second)
        self._period, self._due = 1.0 / frames_per_second, -1.0

    def is_due(self) -> bool:
        """Say whether it is time for a frame; if so, the next is due a period later."""
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = max(self._due, now - self._period) + self._period
        return True
