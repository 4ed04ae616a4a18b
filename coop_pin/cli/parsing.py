"""From words to a command; fields of a scenario are told apart from options here."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated, Protocol

import tyro

from coop_pin.cli.inspect import Check, CheckUrdf, Fields, List, Show
from coop_pin.cli.run import Run
from coop_pin.cli.sweep import Sweep, SweepShow
from coop_pin.cli.tune import Tune
from coop_pin.cli.view import Report, View


class Executable(Protocol):
    """What every command can do."""

    def execute(self) -> int:
        """Do it, and return the exit code."""


Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Fields, tyro.conf.subcommand("fields")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Show, tyro.conf.subcommand("show")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[CheckUrdf, tyro.conf.subcommand("check-urdf")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[SweepShow, tyro.conf.subcommand("sweep-show")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
)
_DESCRIPTION = "Two or more robot arms that hold one object: run scenarios, look at them, read their numbers."


def parse(words: Sequence[str]) -> Executable:
    """Return the command that the words after ``coop-pin`` name.

    Raises:
        SystemExit: help was asked for (0), or the words make no command (2).
    """
    own, fields = split_fields(words) if words[:1] == ["run"] else (list(words), {})
    command: Executable = tyro.cli(Command, prog="coop-pin", description=_DESCRIPTION, args=own)
    return dataclasses.replace(command, fields=fields) if isinstance(command, Run) else command


def split_fields(words: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """Split the words of ``run`` into its own ones and the fields of the scenario, ``--a.b.c VALUE ...`` or ``--a.b.c=VALUE``.

    Returns:
        The own words, and the values of each field as written.
    """
    options = {
        "--help",
        *(form for option in dataclasses.fields(Run) for form in (f"--{option.name}", f"--no-{option.name}")),
    }
    own: list[str] = []
    fields: dict[str, list[str]] = {}
    open_field: list[str] | None = None
    for word in words:
        option, equals, value = word.partition("=")
        if word == "-h" or option in options:
            open_field = None
            own.append(word)
        elif option.startswith("--"):
            fields[option[2:]] = [value] if equals else []
            open_field = None if equals else fields[option[2:]]
        else:
            (own if open_field is None else open_field).append(word)
    return own, fields
