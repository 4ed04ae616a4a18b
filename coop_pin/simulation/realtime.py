"""Real-time pacing of a simulation."""

from __future__ import annotations

import math
import time

from coop_pin.base.arrays import require_type
from coop_pin.base.errors import OutOfRangeError

_LOST_S = 0.1
"""A longer delay counts as lost, s."""


_SLOWEST = 1e-6
"""Smallest rate: a second takes eleven days."""


class RealtimePacer:
    """Real-time pacing: sleeps so that simulated time passes at a constant rate.

    Time lost on a slow computer is not made up for by running faster afterwards.

    Attributes:
        rate: simulated seconds in one second of wall time; inf never waits.
    """

    def __init__(self, rate: float) -> None:
        """Set the rate; time starts to count at the first wait.

        Raises:
            OutOfRangeError: the rate is not greater than zero.
        """
        require_type("realtime_rate", rate, int, float)
        if not rate >= _SLOWEST:
            raise OutOfRangeError("realtime_rate", rate, f"at least {_SLOWEST:g}")
        self.rate = rate
        self._origin: float | None = None

    def wait_until(self, simulated: float) -> None:
        """Sleep until wall time has reached a simulated time, s."""
        if math.isinf(self.rate):
            return
        now, due = time.monotonic(), simulated / self.rate
        if self._origin is None or now - self._origin - due > _LOST_S:
            self._origin = now - due
        if self._origin + due > now:
            time.sleep(self._origin + due - now)
