"""Digests of files, read again only when a file's time or size says that it changed."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path


def file_digest(path: Path) -> str:
    """Return the digest of a file, 64 hexadecimal digits.

    Raises:
        OSError: it cannot be read.
    """
    about = path.stat()
    return _digest_of(path, about.st_mtime_ns, about.st_size)


@functools.lru_cache(maxsize=1024)
def _digest_of(path: Path, changed: int, size: int) -> str:  # noqa: ARG001 they are in the cache's key
    return hashlib.sha256(path.read_bytes()).hexdigest()
