"""One writer for one folder."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from coop_pin.errors import StoreLockedError


class FolderLock:
    """Holds a folder while the ``with`` block runs.

    The lock is the kernel's (flock): it ends with its process however that ends. The text in the file names the owner; text in a file
    that nobody locks was left by an owner that died.

    Attributes:
        left_by: the owner that died without leaving, or empty.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "lock"
        self._file: IO[str] | None = None
        self.left_by = ""

    def __enter__(self) -> Self:
        """Take the lock.

        Raises:
            StoreLockedError: somebody else holds it.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file = self._path.open("a+", encoding="utf-8")
        file.seek(0)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = file.read().strip() or "another process"
            file.close()
            raise StoreLockedError(str(self._path.parent), owner) from None
        self.left_by = file.read().strip()
        self._file = file
        self._write(f"process {os.getpid()} on {socket.gethostname()}")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._write("")
            self._file.close()  # which unlocks it; the file stays, since removing it would let two owners lock two files
            self._file = None

    def _write(self, text: str) -> None:
        """Name the owner. On a full disk the lock holds all the same, without a name."""
        assert self._file is not None
        with contextlib.suppress(OSError):
            os.ftruncate(self._file.fileno(), 0)
            os.pwrite(self._file.fileno(), text.encode(), 0)
