"""User files: bounded reading of regular files and of TOML, and texts of others made fit to print."""

from __future__ import annotations

import io
import os
import re
import stat
import tomllib
import zipfile
from pathlib import Path
from typing import Any

from coop_pin.base.errors import FileReadError

_MAX_TOML_BYTES = 2_000_000
_MAX_NESTING = 50
_HEAD_BYTES = 2000
_PACKED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"\x28\xb5\x2f\xfd")
"""First bytes of gzip, bzip2, xz and zstd."""
_LONG_KEY = re.compile(rf"(?:[\w\"'-]{{1,99}}[ \t]{{0,9}}\.[ \t]{{0,9}}){{{_MAX_NESTING}}}")
"""A dotted key of many parts, on which tomllib takes time with their square."""
_INTEGERS = range(-(2**63), 2**63)
"""Those of TOML."""
_TEXT_CHARACTERS = 10_000
_PLAIN = re.compile(r"[\t\n -~]*")
"""Texts that are printed as they are; others are looked at by character."""


def printable(text: str) -> str:
    """Return a text that a terminal or a page can show as it is, of at most 10 000 characters.

    Control characters but tab and line feed, marks of direction and lone surrogates are written as escapes.
    """
    if not text:  # as most of a record
        return text
    if (more := len(text) - _TEXT_CHARACTERS) > 0:
        text = f"{text[:_TEXT_CHARACTERS]} ... ({more} more characters)"
    if _PLAIN.fullmatch(text):
        return text
    return "".join(c if c.isprintable() or c in "\t\n" else c.encode("unicode_escape").decode() for c in text)


def read_user_file(path: str | Path, *, limit: int, kind: str) -> bytes:
    """Return the content of a regular file; pipes, devices and folders are refused without waiting for them.

    Args:
        path: the file.
        limit: largest size, bytes, also of what an archive unpacks to.
        kind: kind of file that it should be, for messages: "a mesh".

    Raises:
        FileReadError: it is missing, no regular file, too large, unreadable, or packed other than by ZIP.
    """
    content, _ = _read(path, limit, limit, kind)
    if (size := _unzipped_size(content)) > limit:
        raise FileReadError(f"unpacks to {size} bytes; {kind} has at most {limit}", str(path))
    return content


def head_of_user_file(path: str | Path, *, limit: int, kind: str) -> tuple[bytes, int]:
    """Return the first 2000 bytes of a regular file and its size, bytes; as read_user_file otherwise."""
    return _read(path, _HEAD_BYTES, limit, kind)


def _read(path: str | Path, count: int, limit: int, kind: str) -> tuple[bytes, int]:
    """Return the first bytes of a regular file, at most ``count``, and its size."""
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise FileReadError(f"is no regular file; give the path of {kind}", str(path))
            if status.st_size > limit:
                raise FileReadError(f"has {status.st_size} bytes; {kind} has at most {limit}", str(path))
            # Not up to the limit: read() allocates as much as it is asked for.
            content = file.read(min(count, status.st_size)) or b""
    except OSError as error:
        raise FileReadError(f"cannot be read as {kind}: {error.strerror or error}", str(path)) from error
    except MemoryError:
        raise FileReadError(f"has {status.st_size} bytes, more than the free memory", str(path)) from None
    except FileReadError:
        raise
    except ValueError as error:  # NUL in the name, or a lone surrogate
        raise FileReadError(f"cannot be read as {kind}: {error}", ascii(str(path))) from None
    if content.startswith(_PACKED):
        raise FileReadError(f"is a packed file; unpack it to get {kind}", str(path))
    return content, status.st_size


def _unzipped_size(content: bytes) -> int:
    if not zipfile.is_zipfile(io.BytesIO(content)):
        return 0
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return sum(entry.file_size for entry in archive.infolist())
    except zipfile.BadZipFile:  # whoever reads it will say so
        return 0


def open_without_waiting(path: str, flags: int) -> int:
    """Open a file for reading, as an opener of ``open``: a pipe in its place is not waited for."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_toml(path: str | Path, *, kind: str) -> dict[str, Any]:
    """Return the table of a TOML file; raises as read_user_file and parse_toml."""
    return parse_toml(read_user_file(path, limit=_MAX_TOML_BYTES, kind=kind), str(path), kind=kind)


def parse_toml(data: bytes, source: str, *, kind: str) -> dict[str, Any]:
    """Return the table of a TOML text.

    Args:
        data: the text, UTF-8.
        source: name of the text, for messages.
        kind: kind of file that it should be: "a scenario".

    Raises:
        FileReadError: it is no TOML, is nested more than 50 deep, or has an integer beyond 64 bits.
    """
    try:
        text = data.decode("utf-8")
        if _LONG_KEY.search(text):
            raise FileReadError(f"{source} is not {kind}: a key in it has more than {_MAX_NESTING} parts")
        table = tomllib.loads(text)
    except FileReadError:
        raise
    except RecursionError:
        raise FileReadError(f"{source} is not {kind} in TOML: it is nested too deep") from None
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, or an integer of thousands of digits
        raise FileReadError(f"{source} is not {kind} in TOML: {error}") from None
    level: list[Any] = [table]
    for _ in range(_MAX_NESTING):
        for number in (entry for entry in level if isinstance(entry, int) and entry not in _INTEGERS):
            raise FileReadError(
                f"{source} has an integer of {number.bit_length()} bits; TOML has 64 at most, write 1e30"
            )
        level = [
            entry
            for node in level
            if isinstance(node, dict | list)
            for entry in (node.values() if isinstance(node, dict) else node)
        ]
    if level:
        raise FileReadError(f"{source} is not {kind}: its tables and lists are more than {_MAX_NESTING} deep")
    return table
