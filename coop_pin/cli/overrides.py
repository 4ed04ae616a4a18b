"""Overrides: scenario fields and values as typed on the command line, by dotted path."""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, TypeAlias

import tyro

from coop_pin.base.errors import FieldError

ScenarioName: TypeAlias = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
"""Name listed by 'coop-pin list', or TOML file, as typed."""
TypedFields: TypeAlias = Annotated[Mapping[str, Sequence[str]], tyro.conf.Suppress]
"""Fields of a scenario as typed on the command line: the words for each."""
NO_FIELDS: Mapping[str, Sequence[str]] = {}
"""Default of commands that take fields."""

_FLAGS = {"beyond_bound", "project_start"}


def load_scenario(name_or_file: str, fields: Mapping[str, Sequence[str]], *, draft: bool = False) -> Any:
    """Return a Scenario of the catalogue or of a TOML file with the typed fields; a draft may lack gains.

    Raises:
        NameNotFoundError, FileReadError, ScenarioError: as Scenario.load and Scenario.override.
    """
    from coop_pin.description.scenario import Scenario  # slow to load

    scenario = Scenario.load(name_or_file, draft=draft)
    typed = changes(fields, scenario.cell.arms)
    if "auto" not in typed.values():
        return scenario.override(typed)
    from coop_pin.stability.step_size import with_changes  # slow to load

    return with_changes(scenario, typed)


def refuse_fields(fields: Mapping[str, Sequence[str]], what: str) -> None:
    """Refuse fields of a scenario for something else, such as a run.

    Raises:
        FieldError: there are any.
    """
    for field in fields:
        raise FieldError(f"is an option for scenarios only; {what} is not a scenario", f"--{field}")


def changes(fields: Mapping[str, Sequence[str]], arms: Collection[str]) -> dict[str, Any]:
    """Return typed fields as changes by dotted path, ready for Scenario.override.

    Several values make a list; a flag needs none.

    Args:
        fields: the words given for each field.
        arms: names of the scenario's arms.

    Raises:
        FieldError: a field has no value.
    """
    paths = {field_path(field, arms): words for field, words in fields.items()}
    return {path: _value(path, words) for path, words in paths.items()}


def field_path(field: str, arms: Collection[str]) -> str:
    """Return the dotted path of a typed field: dashes become underscores, except in the names of arms."""
    return ".".join(part if part in arms else part.replace("-", "_") for part in field.split("."))


def _value(path: str, words: Sequence[str]) -> Any:
    if not words and path in _FLAGS:
        return True
    if not words:
        raise FieldError("has no value; write it after the field", path)
    if words[0].startswith("{") and isinstance(literal(words[0]), str):
        expected = f"a table in TOML, {{name = value}}; or write --{path}.NAME VALUE"
        raise FieldError(f"is {words[0]!r}; it must be {expected}", path)
    return literal(words[0]) if len(words) == 1 else [literal(word) for word in words]


def literal(word: str) -> Any:
    """Return a word as a TOML value (0.5, true, [1, 2], {kind = "tanh"}), a number (.5) or plain text."""
    try:
        table = tomllib.loads(f"value = {word}")
    except (ValueError, RecursionError):  # no TOML, or beyond the limits of Python
        with contextlib.suppress(ValueError):
            return float(word)
        return word
    value = table.get("value")
    return value if len(table) == 1 and isinstance(value, bool | int | float | str | list | dict) else word
