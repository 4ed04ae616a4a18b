"""The scenarios that a plan starts from, as written and as read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError


def _scenarios(given: Any) -> Any:
    """Return scenarios by name from a scenario, the name or path of one, several of these, or a table of them."""
    if isinstance(given, str | Path | Scenario):
        given = [given]
    if isinstance(given, Mapping):
        return {str(name): _scenario(entry) for name, entry in given.items()}
    if not isinstance(given, Sequence) or not given:
        raise FieldError(f"is {given!r}; it must be a scenario, its name or path, or several of them")
    scenarios = [_scenario(entry) for entry in given]
    twice = [name for name, count in Counter(entry.name for entry in scenarios).items() if count > 1]
    if twice:
        raise FieldError(f"has several scenarios named {twice[0]!r}; give them names of their own: {{first = ..., second = ...}}")
    return {scenario.name: scenario for scenario in scenarios}


def _scenario(given: Any) -> Scenario:
    if isinstance(given, Scenario):
        return given
    return Scenario.from_dict(dict(given)) if isinstance(given, Mapping) else Scenario.load(given)


Bases = Annotated[dict[str, Scenario], BeforeValidator(_scenarios), Field(min_length=1)]
"""Scenarios by name."""


def anchored(base: Any, folder: Path) -> Any:
    """Return scenarios as written in a file, with paths of files that exist beside it made whole."""
    if isinstance(base, str):
        return str((folder / base).resolve()) if (folder / base).is_file() else base
    if isinstance(base, Mapping):
        return {name: anchored(entry, folder) if isinstance(entry, str) else entry for name, entry in base.items()}
    return [anchored(entry, folder) for entry in base] if isinstance(base, list) else base
