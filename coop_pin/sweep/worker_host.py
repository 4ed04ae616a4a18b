"""The process that keeps local workers: ``python -m coop_pin.sweep.worker_host ADDRESS COUNT``, in a session of its own.

Workers are started from here and not from the user's process: they would import the user's script once more, and a script without an
``if __name__ == "__main__"`` would start its sweep in every worker. It ends with its parent: when its standard input closes.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from typing import Any

from distributed import Nanny

from coop_pin.sweep.quiet import QuietWorker

_PRELOAD = "coop_pin.sweep.job"
_GRACE_S = 2.0


async def keep_workers(address: str, count: int) -> None:
    """Keep workers of one thread each on the loopback device until the parent ends. A worker that dies is replaced."""
    options: dict[str, Any] = {"nthreads": 1, "host": "127.0.0.1", "worker_class": QuietWorker, "preload": [_PRELOAD], "death_timeout": 60}
    nannies = [Nanny(address, **options) for _ in range(count)]
    await asyncio.gather(*nannies)
    await asyncio.to_thread(sys.stdin.read)
    with contextlib.suppress(TimeoutError):  # a parent that was killed has taken the scheduler with it: nobody answers
        await asyncio.wait_for(asyncio.gather(*(nanny.close(timeout=1) for nanny in nannies), return_exceptions=True), _GRACE_S)
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    asyncio.run(keep_workers(sys.argv[1], int(sys.argv[2])))
