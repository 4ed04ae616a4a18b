"""Host process of local workers: ``python -m coop_pin.sweeps.worker_host ADDRESS COUNT``, in its own session.

Workers are children of this process and not of the user's, whose script they would import: a script without
``if __name__ == "__main__"`` would start its sweep in every worker. The host ends with its parent, when its
standard input closes.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from typing import Any

from distributed import Nanny

from coop_pin.sweeps.cluster import QuietWorker

_PRELOAD = "coop_pin.sweeps.job"
_GRACE_S = 2.0


async def keep_workers(address: str, count: int, parent_ended: asyncio.Event) -> None:
    """Keep workers of one thread each on the loopback device until the parent ends; replace dead ones.

    A worker that dies during its start ends this process and all workers; the parent starts them again.
    """
    options: dict[str, Any] = {
        "nthreads": 1,
        "host": "127.0.0.1",
        "worker_class": QuietWorker,
        "preload": [_PRELOAD],
        "death_timeout": 60,
    }
    nannies = [Nanny(address, **options) for _ in range(count)]
    try:
        await asyncio.gather(*nannies)
    except RuntimeError:
        os.killpg(0, signal.SIGKILL)
    await parent_ended.wait()
    await asyncio.gather(*(nanny.close(timeout=1) for nanny in nannies), return_exceptions=True)
    os.killpg(0, signal.SIGKILL)


async def main(address: str, count: int) -> None:
    """Keep workers, and end with the parent even if a scheduler that died with it leaves them waiting."""
    loop, parent_ended = asyncio.get_running_loop(), asyncio.Event()

    def watch() -> None:
        sys.stdin.read()
        loop.call_soon_threadsafe(parent_ended.set)
        time.sleep(_GRACE_S)
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=watch, name="parent", daemon=True).start()
    await keep_workers(address, count, parent_ended)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
