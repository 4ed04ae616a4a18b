"""Simulated time against the time on the wall."""

from __future__ import annotations

import math
import time

from coop_pin.errors import OutOfRangeError

_LOST_S = 0.1


class RealtimePacer:
    """Waits so that simulated time goes by evenly.

    Where the computer cannot keep up, the time that it lost is not made up for by running faster afterwards.

    Attributes:
        rate: simulated seconds in one second of wall time; inf never waits.
    """

    def __init__(self, rate: float) -> None:
        """Start when the first time is waited for.

        Raises:
            OutOfRangeError: the rate is not greater than zero.
        """
        if not rate > 0.0:
            raise OutOfRangeError("realtime_rate", rate)
        self.rate = rate
        self._origin: float | None = None

    def wait_until(self, simulated: float) -> None:
        """Sleep until it is time for a simulated time, s."""
        if math.isinf(self.rate):
            return
        now, due = time.monotonic(), simulated / self.rate
        if self._origin is None or now - self._origin - due > _LOST_S:
            self._origin = now - due
        if self._origin + due > now:
            time.sleep(self._origin + due - now)
