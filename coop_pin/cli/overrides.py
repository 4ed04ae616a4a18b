"""Overrides: scenario fields and values as typed on the command line, by dotted path."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeAlias

import tyro

from coop_pin.base.errors import CodeRefusedError, FieldError

ScenarioName: TypeAlias = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
"""Name listed by 'coop-pin list', or TOML file, as typed."""
TypedFields: TypeAlias = Annotated[Mapping[str, Sequence[str]], tyro.conf.Suppress]
"""Fields of a scenario as typed on the command line: the words for each."""
NO_FIELDS: Mapping[str, Sequence[str]] = {}
"""Default of commands that take fields."""


@dataclasses.dataclass(frozen=True)
class CodeOptions:
    """Code that scenarios and plans may name, as options of a command.

    Attributes:
        code: run code that a scenario names; --no-code refuses a scenario that names any.
        allow_code: module or installed package whose code a scenario may name, besides files below this
            folder; once for each.
    """

    code: bool = True
    allow_code: tuple[str, ...] = ()

    def admit(self, named: Iterable[tuple[str, str]], *, quiet: bool = False) -> None:
        """Tell in one line the code that is named, before any of it is loaded.

        Args:
            named: path and name of the code, as ``code_named`` yields them.
            quiet: tell it on the standard error.

        Raises:
            CodeRefusedError: there is any and none is wanted, or a module may not be named.
        """
        from coop_pin.base.schema.user_code import ALLOWED, require_allowed  # slow to load

        if self.allow_code:
            os.environ[ALLOWED] = ",".join((os.environ.get(ALLOWED, ""), *self.allow_code))
        places = {name: path for path, name in reversed([*named])}
        for name in places if not self.code else ():
            raise CodeRefusedError(name, f"that {places[name]} names; --no-code refuses all code")
        require_allowed(places)
        if text := ", ".join(f"{path} = {name}" for name, path in reversed(places.items())):
            print(f"runs code: {text}", file=sys.stderr if quiet else sys.stdout, flush=True)


Code: TypeAlias = Annotated[CodeOptions, tyro.conf.OmitArgPrefixes, tyro.conf.UseAppendAction]
"""Fields of CodeOptions as options of a command: --no-code, --allow-code."""
ANY_CODE = CodeOptions()
"""Code of the user's own."""

_FLAGS = {"beyond_bound", "project_start"}


def load_scenario(
    name_or_file: str,
    fields: Mapping[str, Sequence[str]],
    code: CodeOptions | None = None,
    *,
    draft: bool = False,
    quiet: bool = False,
) -> Any:
    """Return a Scenario of the catalogue or of a TOML file with the typed fields.

    Args:
        name_or_file: name or path.
        fields: fields of the scenario, as typed.
        code: code that it may name, which is told; None where none is run.
        draft: whether gains may be missing.
        quiet: whether code is told on the standard error.

    Raises:
        NameNotFoundError, FileReadError, ScenarioError: as Scenario.load and Scenario.override.
        CodeRefusedError: it names code that it may not name.
    """
    from coop_pin.base.schema.user_code import code_named  # slow to load
    from coop_pin.description.scenario import Scenario

    scenario = Scenario.load(name_or_file, draft=draft)
    typed = changes(fields, scenario.cell.arms)
    open_steps = {field: value for field, value in typed.items() if value == "auto"}
    scenario = scenario.override({field: value for field, value in typed.items() if field not in open_steps})
    if code is not None:
        code.admit(code_named(scenario), quiet=quiet)
    if not open_steps:
        return scenario
    from coop_pin.stability.step_size import with_changes  # slow to load

    return with_changes(scenario, open_steps)


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
    forms = {
        "{": f"a table in TOML, {{name = value}}; or write --{path}.NAME VALUE",
        "[": "a list in TOML, [{name = value}]",
    }
    if (form := forms.get(words[0][:1])) and isinstance(literal(words[0]), str):
        raise FieldError(f"is {words[0]!r}; it must be {form}", path)
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
