"""Parser of the command line: the commands, and which words are fields of the scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, Protocol, Union, cast

import tyro

from coop_pin.cli.check import Check
from coop_pin.cli.compare import Compare
from coop_pin.cli.export import ExportC
from coop_pin.cli.inspect import CheckUrdf, Fields, List, New, Show, Suggest
from coop_pin.cli.root_locus import Locus
from coop_pin.cli.run import Run
from coop_pin.cli.sweep import Sweep, SweepShow
from coop_pin.cli.tune import Tune
from coop_pin.cli.view import Report, View

COMMANDS: dict[str, type[Any]] = {
    "run": Run,
    "list": List,
    "fields": Fields,
    "view": View,
    "report": Report,
    "show": Show,
    "check": Check,
    "suggest": Suggest,
    "root-locus": Locus,
    "new": New,
    "check-urdf": CheckUrdf,
    "sweep": Sweep,
    "sweep-show": SweepShow,
    "tune": Tune,
    "compare": Compare,
    "export-c": ExportC,
}
"""Commands by name; those with an attribute ``fields`` take the fields of a scenario as options."""

_DESCRIPTION = "Two or more robot arms that hold one object: simulate scenarios, view runs, compute metrics."


class Command(Protocol):
    """Command with its options."""

    def execute(self) -> int:
        """Do what it says, and return an exit code of ``coop_pin.cli.exit_codes``."""


def parse(words: Sequence[str]) -> Command:
    """Return the command for the words after ``coop-pin``.

    Raises:
        SystemExit: help was asked for (0), or the words are no command (2).
    """
    if not words or words[0] not in COMMANDS:  # tells what commands there are
        kinds = [Annotated[kind, tyro.conf.subcommand(name)] for name, kind in COMMANDS.items()]
        every: Any = Union[tuple(kinds)]  # noqa: UP007
        return cast(Command, tyro.cli(every, prog="coop-pin", description=_DESCRIPTION, args=list(words)))
    name, kind = words[0], COMMANDS[words[0]]
    has_fields = any(field.name == "fields" for field in dataclasses.fields(kind))
    options, fields = split_fields(words[1:], kind) if has_fields else (list(words[1:]), {})
    command: Any = tyro.cli(kind, prog=f"coop-pin {name}", args=options)
    return cast(Command, dataclasses.replace(command, fields=fields) if fields else command)


def _options(field: Any) -> Sequence[Any]:
    """Return the options that a field of a command stands for: those of its default, or itself."""
    return dataclasses.fields(field.default) if dataclasses.is_dataclass(field.default) else [field]


def split_fields(words: Sequence[str], command: Any) -> tuple[list[str], dict[str, list[str]]]:
    """Split the words of a command into its own options and fields of the scenario.

    Fields are written ``--a.b.c VALUE ...`` or ``--a.b.c=VALUE``.

    Args:
        words: the words after the command's name.
        command: class of the command.

    Returns:
        The command's own words, and the values of each field as typed.
    """
    names = [option.name for field in dataclasses.fields(command) for option in _options(field)]
    forms = {form for name in names for form in (name, name.replace("_", "-"))}
    flags = {"--help", *(f"--{no}{form}" for form in forms for no in ("", "no-"))}
    options: list[str] = []
    fields: dict[str, list[str]] = {}
    open_field: list[str] | None = None
    for word in words:
        option, equals, value = word.partition("=")
        if word == "-h" or option in flags:
            open_field = None
            options.append(word)
        elif option.startswith("--"):
            fields[option[2:]] = [value] if equals else []
            open_field = None if equals else fields[option[2:]]
        else:
            (options if open_field is None else open_field).append(word)
    return options, fields
