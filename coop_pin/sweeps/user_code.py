"""The user's own code that a run executes: it determines the run as much as its scenario does."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from coop_pin.description.scenario import Scenario
from coop_pin.errors import CodeChangedError
from coop_pin.sweeps.digest import file_digest
from coop_pin.sweeps.run_key import source_files

_FIELDS = ("target", "twist", "acceleration")


class UserCode(NamedTuple):
    """Code of the user's own as it stands in files.

    Attributes:
        name: "module:function".
        digests: of its source files, in order of their paths; empty where there are none.
    """

    name: str
    digests: tuple[str, ...]


def user_code(scenario: Scenario, metrics: tuple[str, ...]) -> tuple[UserCode, ...]:
    """Return the code of the user's own that a run names, each name once."""
    parts = (scenario.controller, scenario.motion, scenario.squeeze)
    named = [getattr(part, field, None) for part in parts if part.kind == "user" for field in _FIELDS]
    return tuple(map(_as_it_stands, dict.fromkeys([*filter(None, named), *metrics])))


def require_loaded(codes: tuple[UserCode, ...]) -> None:
    """Require that this process runs code as it stood when a run's key was made.

    Python loads a module once: a process that goes on after an edit, or a worker that was there before, would compute with the old code
    what is kept as the new code's. What was loaded is taken to be what stood in the files when they were first asked for.

    Raises:
        CodeChangedError: it runs other code.
    """
    for code in codes:
        if tuple(_loaded.setdefault(path, file_digest(path)) for path in source_files(code.name)) != code.digests:
            raise CodeChangedError(code.name)


def _as_it_stands(name: str) -> UserCode:
    return UserCode(name, tuple(file_digest(path) for path in source_files(name)))


_loaded: dict[Path, str] = {}
"""The digests of the files that this process has loaded."""
