"""Atomic file writes: a file has its old content or the new one, never a part of it."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from pathlib import Path

from coop_pin.base.errors import FileWriteError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a temporary name in its folder, sync it, and rename it.

    When writing fails (a full disk, an interrupt), the old file stays as it was and the temporary one is
    removed.

    Args:
        path: the file.
        write: writes the content to the path it is given.

    Raises:
        FileWriteError: the path is a folder, or no file can be made there.
    """
    if path.is_dir():
        raise FileWriteError(str(path), "it is a folder")
    # tempfile would make the file readable by its owner alone, and the result would stay so.
    part = path.with_name(f".{path.stem}.{uuid.uuid4().hex}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
    except (OSError, ValueError) as error:  # a name that no file can have, a folder that is none
        raise FileWriteError(str(path), getattr(error, "strerror", None) or str(error)) from None
    try:
        write(part)
        with part.open("rb") as written:
            os.fsync(written.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
