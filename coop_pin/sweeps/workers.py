"""Local workers: a process that keeps them, started again if it dies."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from types import TracebackType
from typing import Self

from coop_pin.errors import WorkersLostError

_TRIES, _SHORT_LIFE_S, _GRACE_S = 3, 10.0, 3.0


class LocalWorkers:
    """Workers on this machine while the ``with`` block runs.

    Attributes:
        error: why there are no workers any more, once it is hopeless.
    """

    def __init__(self, address: str, count: int) -> None:
        self._command = [sys.executable, "-m", "coop_pin.sweeps.worker_host", address, str(count)]
        self._closing = threading.Event()
        self._process = self._start()
        self._keeper = threading.Thread(target=self._keep, name="coop-pin-workers", daemon=True)
        self.error: WorkersLostError | None = None

    def __enter__(self) -> Self:
        self._keeper.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._closing.set()
        self._end(self._process)
        self._keeper.join(timeout=10.0)
        self._end(self._process)  # the keeper may have started another one meanwhile

    @staticmethod
    def _end(process: subprocess.Popen[bytes]) -> None:
        """Ask the process to end, and after a moment end it and its workers together."""
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=_GRACE_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        """Start the process, in a session of its own: Ctrl-C on a terminal is for us to handle."""
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path),  # noqa: PTH109 the user's own modules are found
            "DASK_LOGGING__DISTRIBUTED": "critical",  # workers that die are reported in records
            "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",  # workers need not watch themselves
            "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
        }
        return subprocess.Popen(self._command, stdin=subprocess.PIPE, start_new_session=True, env=environment)

    def _keep(self) -> None:
        """Start the process again when it dies, unless it keeps dying at once."""
        short_lives = 0
        while True:
            started = time.monotonic()
            code = self._process.wait()
            if self._closing.is_set():
                return
            self._end(self._process)  # its workers may live on
            short_lives = short_lives + 1 if time.monotonic() - started < _SHORT_LIFE_S else 0
            if short_lives >= _TRIES:
                ended = f"local workers ended {_TRIES} times at once, the last time with exit code {code}"
                self.error = WorkersLostError(f"{ended}; run with workers = 0 to see why")
                return
            self._process = self._start()
