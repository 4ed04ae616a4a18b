"""The root of the tree: what every error can do."""

from __future__ import annotations

from typing import Any


def rebuild(kind: type[CoopPinError], message: str, fields: dict[str, Any]) -> CoopPinError:
    """Make an error from what it was pickled as."""
    layout: Any = kind
    while layout.__module__ != "builtins":  # an OSError is larger than other exceptions: only its own __new__ may make one
        layout = layout.__base__
    error: CoopPinError = layout.__new__(kind, message)
    error.args = (message,)
    error.__dict__.update(fields)
    return error


class CoopPinError(Exception):
    """Root of every error that coop_pin raises on purpose; picklable, so that workers can send it.

    Attributes:
        result: where a run was under way, its RunResult up to then; otherwise None.
    """

    result: Any = None

    def __str__(self) -> str:
        """Return the message as written (a KeyError would quote it)."""
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by message and fields: constructors take numbers, not messages."""
        return rebuild, (type(self), str(self), self.__dict__)
