"""Text on a terminal: lines as wide as it is, and what goes on while a command takes its time."""

from __future__ import annotations

import shutil
import sys
import textwrap
import threading
import time
from typing import Self

_NARROWEST, _WIDEST = 80, 99
"""Columns of the narrowest terminal that lines are wrapped for, and of the longest line."""
_QUIET_S, _EVERY_S = 1.0, 1.0
"""Time until the first line about what goes on, and between two, s."""


def columns() -> int:
    """Return the width of a line: that of the terminal, within limits; the widest where there is none."""
    return min(max(shutil.get_terminal_size((_WIDEST, 24)).columns, _NARROWEST), _WIDEST)


def print_wrapped(*texts: object, sep: str = " ") -> None:
    """Print texts with long lines wrapped at spaces, further indented; commands to copy stay whole words."""
    print(*_wrapped(sep.join(map(str, texts))), sep="\n")


def print_error(text: str) -> None:
    """Print a text to standard error: wrapped on a terminal, its own lines elsewhere, as in a log."""
    lines = _wrapped(text) if sys.stderr.isatty() else [text]
    print(*lines, sep="\n", file=sys.stderr)


def _wrapped(text: str) -> list[str]:
    width, lines = columns(), list[str]()
    for line in text.splitlines():
        stem = len(line) - len(line.lstrip(" │├└─"))  # of a tree, whose lines go on below
        indent = line[:stem].replace("├─", "│ ").replace("└─", "  ") + " " * 4
        parts = textwrap.wrap(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        lines += parts or [""]
    return lines


class Working:
    """What goes on and for how long, on a terminal's standard error while it takes its time.

    Nothing is written elsewhere, as into a pipe or a log file, and nothing is left when it is over.

    Args:
        text: activity, a few words.
        quiet: write nothing at all.
    """

    def __init__(self, text: str, *, quiet: bool = False) -> None:
        self._text, self._start, self._over = text, time.monotonic(), threading.Event()
        self._stream = sys.stderr
        self._writes = not quiet and self._stream.isatty()

    def tell(self, text: str) -> None:
        """Say that something else goes on."""
        self._text = text

    def _write(self) -> None:
        wait = _QUIET_S
        while not self._over.wait(wait):
            line = f"coop-pin: {self._text}, {time.monotonic() - self._start:.0f} s"
            # The cursor goes back: whatever is printed next takes the line.
            self._stream.write(f"\x1b[K{line[: columns() - 1]}\r")
            self._stream.flush()
            wait = _EVERY_S

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._write, name="coop_pin working", daemon=True)
        if self._writes:
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._over.set()
        if self._writes:
            self._thread.join()
            self._stream.write("\x1b[K")
            self._stream.flush()
