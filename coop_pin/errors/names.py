"""Names that are not known, and packages that are not installed."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

from coop_pin.errors.root import CoopPinError


class NameNotFoundError(CoopPinError, KeyError):
    """A name is not known.

    Attributes:
        kind: what was looked for, for example "frame".
        name: the name asked for.
        known: the names there are.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str) -> None:
        self.kind, self.name, self.known = kind, name, tuple(known)
        super().__init__(f"no {kind} {name!r} in {where}" + (f"; {suggestion(name, self.known)}" if self.known else ""))


class FrameNotFoundError(NameNotFoundError):
    """A frame name is not in the model."""


class JointNotFoundError(NameNotFoundError):
    """A joint name is not in the model."""


class ArmNotFoundError(NameNotFoundError):
    """An arm name is not in the cell."""


class EntryNotFoundError(NameNotFoundError):
    """A name is not in a catalogue."""


def suggestion(name: str, known: Sequence[str]) -> str:
    """Say which known names come closest to a wrong one, or list them where they are few.

    Args:
        name: the wrong one.
        known: the names there are.
    """
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    if close:
        return "did you mean " + " or ".join(map(repr, close)) + "?"
    shown = ", ".join(map(repr, known[:12]))
    return f"known: {shown}" + (f" and {len(known) - 12} more" if len(known) > 12 else "")


class MissingExtraError(CoopPinError, ImportError):
    """An optional package is not installed.

    Attributes:
        package: the package.
        extra: the extra of coop-pin that brings it.
    """

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(f"{package} is not installed; {purpose}, run: pip install 'coop-pin[{extra}]'")


class MissingPinocchioError(CoopPinError, ImportError):
    """Pinocchio cannot be used: it is not there, does not load, is of another version, or another package has its name.

    Attributes:
        found: what was found in its place.
    """

    def __init__(self, found: str) -> None:
        self.found = found
        super().__init__(
            f"{found}. On Linux (glibc 2.28 or later, not musl) and macOS: pip install 'pin>=4.1,<5'. With conda, and on Windows, where "
            "PyPI has no wheel of pin: conda install -c conda-forge 'pinocchio>=4.1,<5'. Only conda-forge calls it pinocchio; on PyPI it "
            "is pin"
        )
