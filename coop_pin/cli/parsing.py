"""Parser of the command line: the commands, and which words are fields of the scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any

import tyro

from coop_pin.cli.compare import Compare
from coop_pin.cli.export import ExportC
from coop_pin.cli.inspect import Check, CheckUrdf, Fields, List, New, Show, Suggest
from coop_pin.cli.run import Run
from coop_pin.cli.sweep import Sweep, SweepShow
from coop_pin.cli.tune import Tune
from coop_pin.cli.view import Report, View

Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Fields, tyro.conf.subcommand("fields")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[Suggest, tyro.conf.subcommand("suggest")]
    | Annotated[New, tyro.conf.subcommand("new")]
    | Annotated[CheckUrdf, tyro.conf.subcommand("check-urdf")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[SweepShow, tyro.conf.subcommand("sweep-show")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[ExportC, tyro.conf.subcommand("export-c")]
)
_WITH_FIELDS: dict[str, Any] = {
    "run": Run,
    "view": View,
    "show": Show,
    "check": Check,
    "suggest": Suggest,
    "tune": Tune,
    "export-c": ExportC,
}
"""Commands that take the fields of a scenario as options."""

_DESCRIPTION = "Two or more robot arms that hold one object: simulate scenarios, view runs, compute metrics."


def parse(words: Sequence[str]) -> Command:
    """Return the command for the words after ``coop-pin``.

    Raises:
        SystemExit: help was asked for (0), or the words are no command (2).
    """
    kind = _WITH_FIELDS.get(words[0]) if words else None
    options, fields = split_fields(words, kind) if kind else (list(words), {})
    command: Any = tyro.cli(Command, prog="coop-pin", description=_DESCRIPTION, args=options)
    return dataclasses.replace(command, fields=fields) if fields else command


def _options(field: Any) -> Sequence[Any]:
    """Return the options that a field of a command stands for: those of its default, or itself."""
    return dataclasses.fields(field.default) if dataclasses.is_dataclass(field.default) else [field]


def split_fields(words: Sequence[str], command: Any) -> tuple[list[str], dict[str, list[str]]]:
    """Split the words of a command into its own options and fields of the scenario.

    Fields are written ``--a.b.c VALUE ...`` or ``--a.b.c=VALUE``.

    Args:
        words: the command's name and what follows it.
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
