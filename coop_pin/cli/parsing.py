"""Parser of the command line: the commands, and which words of ``run`` are fields of the scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import tyro

from coop_pin.cli.inspect import Check, CheckUrdf, Fields, List, Show
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
    | Annotated[CheckUrdf, tyro.conf.subcommand("check-urdf")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[SweepShow, tyro.conf.subcommand("sweep-show")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
)
_DESCRIPTION = "Two or more robot arms that hold one object: simulate scenarios, view runs, compute metrics."


def parse(words: Sequence[str]) -> Command:
    """Return the command for the words after ``coop-pin``.

    Raises:
        SystemExit: help was asked for (0), or the words are no command (2).
    """
    own, fields = split_fields(words) if words[:1] == ["run"] else (list(words), {})
    command: Command = tyro.cli(Command, prog="coop-pin", description=_DESCRIPTION, args=own)
    return dataclasses.replace(command, fields=fields) if isinstance(command, Run) else command


def split_fields(words: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """Split the words of ``run`` into its own options and fields of the scenario.

    Fields are written ``--a.b.c VALUE ...`` or ``--a.b.c=VALUE``.

    Returns:
        The options of ``run``, and the values of each field as typed.
    """
    names = [option.name.replace("_", "-") for option in dataclasses.fields(Run)]
    options = {"--help", *(form for name in names for form in (f"--{name}", f"--no-{name}"))}
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
