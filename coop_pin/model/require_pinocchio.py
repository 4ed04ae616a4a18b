"""Importing this module imports Pinocchio, or says what stands in its place and what to do; the rooms that use it import this first."""

from __future__ import annotations

import importlib
import re
from types import ModuleType

from coop_pin.errors import MissingPinocchioError

OLDEST, TOO_NEW = (4, 1), (5,)
"""Versions that coop_pin is written for: from the first up to, but not, the second."""


def import_pinocchio() -> ModuleType:
    """Return Pinocchio.

    Raises:
        MissingPinocchioError: it is not there, it does not load, it is of a version that coop_pin cannot use,
            or another package has its name.
    """
    try:
        found = importlib.import_module("pinocchio")
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == "pinocchio"
        raise MissingPinocchioError(
            "Pinocchio is not installed" if missing else f"Pinocchio does not load: {error}"
        ) from error
    if not hasattr(found, "buildModelFromXML"):
        raise MissingPinocchioError(
            f"{found!r} is not Pinocchio; rename or remove it (on PyPI a plugin for nose has that name: pip uninstall pinocchio)"
        )
    if not OLDEST <= _numbers(found.__version__) < TOO_NEW:
        raise MissingPinocchioError(
            f"Pinocchio {found.__version__} is installed; coop_pin needs 4.1 or later, before 5"
        )
    return found


def _numbers(version: str) -> tuple[int, int]:
    """Return the first two numbers of a version, "4.1.0", "4.1rc1" or "4"."""
    major, minor, *_ = [*map(int, re.findall(r"\d+", version)), 0, 0]
    return major, minor


import_pinocchio()
