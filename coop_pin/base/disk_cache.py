"""Cache on disk of what is slow to make: traced and compiled code, texts; the 256 MB used last are kept."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import time
from pathlib import Path

from coop_pin.base.atomic_write import write_atomically
from coop_pin.base.user_files import open_without_waiting

_DIGEST = 32
"""Bytes of the checksum in front of a file."""
_LARGEST, _ALL = 1 << 26, 1 << 28
"""Largest file, and size of all of them, bytes."""
_ABANDONED_S = 3600.0
"""Age at which the file of an unfinished write is one of a process that was killed, s."""


@functools.cache
def package_digest() -> str:
    """Return the digest of the source of this package, for keys of what depends on it."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _path(key: bytes) -> Path:
    """Return the file of a key, in the folder of the user's caches.

    Raises:
        OSError: there is neither an absolute XDG_CACHE_HOME nor a home.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not folder.is_absolute():  # the XDG specification: to be ignored
        with contextlib.suppress(RuntimeError):  # a user without a home
            folder = Path.home() / ".cache" if os.environ.get("HOME", "~") else folder
    if not folder.is_absolute():
        raise FileNotFoundError("no folder of the user's caches")
    return folder / "coop_pin" / "compiled" / f"{key.hex()}.o"


def kept(key: bytes) -> bytes | None:
    """Return what this user kept; None if there is none, or it is damaged.

    It may be code that is run: a file that others own or may write is not read. The checksum covers the key,
    so that a file under another name is another program.
    """
    try:
        with open(_path(key), "rb", opener=open_without_waiting) as file:
            status = os.fstat(file.fileno())
            is_mine = status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
            if not (is_mine and stat.S_ISREG(status.st_mode) and status.st_size <= _LARGEST):
                return None
            data = file.read()
            os.utime(file.fileno())  # used now
    except OSError:
        return None
    digest, code = data[:_DIGEST], data[_DIGEST:]
    return code if hashlib.sha256(key + code).digest() == digest else None


def keep(key: bytes, code: bytes) -> None:
    """Keep bytes; a folder that cannot be written costs the time to make them again."""

    def write(part: Path) -> None:
        part.write_bytes(hashlib.sha256(key + code).digest() + code)
        part.chmod(stat.S_IRUSR | stat.S_IWUSR)

    with contextlib.suppress(OSError):
        path = _path(key)
        path.parent.mkdir(parents=True, exist_ok=True, mode=stat.S_IRWXU)
        write_atomically(path, write)
        _tidy(path.parent)


class DiskCache:
    """The cache as a mapping."""

    get, __setitem__ = staticmethod(kept), staticmethod(keep)


def _tidy(folder: Path) -> None:
    """Remove what was used least lately, beyond the size of all, and what killed processes left."""
    files = [(entry, entry.lstat()) for entry in folder.iterdir()]
    size, now = 0, time.time()
    for file, status in sorted(files, key=lambda entry: entry[1].st_mtime, reverse=True):
        is_part = file.name.startswith(".")
        size += 0 if is_part else status.st_size
        if stat.S_ISREG(status.st_mode) and (
            now - status.st_mtime > _ABANDONED_S if is_part else size > _ALL
        ):
            file.unlink(missing_ok=True)
