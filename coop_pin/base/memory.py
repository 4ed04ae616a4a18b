"""Memory that is free for arrays: of the system, of control groups and of the address space."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from coop_pin.base.errors import NotEnoughMemoryError

_SYSTEM = Path("/")
"""Folder of the system's own files."""
_CGROUP_FILES = {
    "": ("memory.max", "memory.current", "inactive_file"),
    "memory": ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
}
"""Files of limit, use and the cache that can be given back: of version 2, which has one tree, and of 1."""


def require_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse arrays that are larger than the free memory, before they are allocated.

    Args:
        what: the arrays, for the error message.
        needed: size of the arrays, bytes.
        remedy: advice that makes them smaller.

    Raises:
        NotEnoughMemoryError: they do not fit.
    """
    free = free_memory()
    if needed > free:
        raise NotEnoughMemoryError(what, needed, free, remedy)


def free_memory() -> int:
    """Return the memory that is available without swapping, bytes; sys.maxsize where it cannot be read.

    It is the least of what the system, the control groups of the process (containers, batch jobs) and its
    limit of the address space leave.
    """
    return max(0, min(_system_memory(), _address_space(), *_cgroup_memory()))


def _system_memory() -> int:
    with contextlib.suppress(OSError, StopIteration):  # Linux; what caches give back is free
        lines = Path("/proc/meminfo").read_text("ascii").splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    for pages in ("SC_AVPHYS_PAGES", "SC_PHYS_PAGES"):
        with contextlib.suppress(AttributeError, OSError, ValueError):  # no such name, or not on this system
            return int(os.sysconf(pages) * os.sysconf("SC_PAGE_SIZE"))
    return sys.maxsize


def _address_space() -> int:
    """Return what the limit of the address space (ulimit -v) leaves, bytes."""
    with contextlib.suppress(ImportError, OSError):
        import resource  # not on Windows

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
            return limit - pages * resource.getpagesize()
    return sys.maxsize


def _cgroup_memory() -> Iterator[int]:
    """Yield what the limits of the process's control groups and of the groups around them leave, bytes."""
    for folder, (limit, used, cache) in _cgroups(_SYSTEM / "proc/self/cgroup", _SYSTEM / "sys/fs/cgroup"):
        with contextlib.suppress(OSError, ValueError):  # no number: the group has no limit
            most = int((folder / limit).read_text("ascii"))
            counts = dict(map(str.split, (folder / "memory.stat").read_text("ascii").splitlines()))
            yield most + int(counts.get(cache, 0)) - int((folder / used).read_text("ascii"))


@functools.cache  # a process stays in its groups
def _cgroups(listed: Path, root: Path) -> list[tuple[Path, tuple[str, str, str]]]:
    """Return the folders of the control groups that may have a limit, and the names of their files."""
    try:
        groups = [line.split(":", 2)[1:] for line in listed.read_text("utf-8").splitlines()]
    except OSError:  # not Linux
        return []
    folders = list[tuple[Path, tuple[str, str, str]]]()
    for name, path in groups:
        if names := _CGROUP_FILES.get(name):
            group = root / name / path.lstrip("/")
            folders += [
                (folder, names) for folder in (group, *group.parents) if (folder / names[0]).is_file()
            ]
    return folders
