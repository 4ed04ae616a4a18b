"""Parser of the command line: the commands, and which words are fields of the scenario."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import tyro

from coop_pin.base.errors import FieldError
from coop_pin.cli.blame import blame
from coop_pin.cli.check import check, root_locus
from coop_pin.cli.compare import compare
from coop_pin.cli.conform import conform
from coop_pin.cli.export import export
from coop_pin.cli.inspect import check_urdf, fields_of, list_all, new, show, suggest
from coop_pin.cli.run import run
from coop_pin.cli.sweep import sweep, sweep_show, tune
from coop_pin.cli.view import report, view
from coop_pin.cli.zoo import zoo
from coop_pin.compiled.engines import FORMER, engine_named

COMMANDS: dict[str, Callable[..., int | None]] = {
    "run": run,
    "list": list_all,
    "fields": fields_of,
    "view": view,
    "report": report,
    "show": show,
    "check": check,
    "blame": blame,
    "suggest": suggest,
    "root-locus": root_locus,
    "new": new,
    "check-urdf": check_urdf,
    "sweep": sweep,
    "sweep-show": sweep_show,
    "tune": tune,
    "compare": compare,
    "conform": conform,
    "export": export,
    "zoo": zoo,
}
"""Commands by name; those with an argument ``fields`` take the fields of a scenario as options."""

_DESCRIPTION = "Two or more robot arms that hold one object: simulate scenarios, view runs, compute metrics."

Command: TypeAlias = Callable[[], int | None]
"""Command with its options; it returns an exit code of ``coop_pin.cli.exit_codes``, None for OK."""


def parse(words: Sequence[str]) -> Command:
    """Return the command for the words after ``coop-pin``.

    Raises:
        SystemExit: help was asked for (0), or the words are no command (2).
        FieldError: the words have a former name.
    """
    if words and words[0] == "export-c":
        raise FieldError("is the command 'coop-pin export SCENARIO --to c --arm NAME'", words[0])
    if not words or words[0] not in COMMANDS:  # tells what commands there are
        every = tyro.extras.subcommand_cli_from_dict
        return every(COMMANDS, prog="coop-pin", description=_DESCRIPTION, args=list(words))
    name, command, fields = words[0], COMMANDS[words[0]], dict[str, list[str]]()
    command.__doc__ = re.sub(r"\n {12}", " ", command.__doc__ or "")  # else help keeps these line ends
    options = list(words[1:])
    for engine in re.findall(rf"--engine[= ]({'|'.join(FORMER)})\b", " ".join(options)):
        engine_named(engine, "--engine")  # tells the present name
    if "fields" in inspect.signature(command).parameters:
        options, fields = split_fields(options, command)

    @functools.wraps(command)
    def with_options(**values: Any) -> Command:
        return functools.partial(command, **values | ({"fields": fields} if fields else {}))

    return tyro.cli(with_options, prog=f"coop-pin {name}", args=options)


def _options(argument: inspect.Parameter) -> Sequence[str]:
    """Return the options that an argument of a command stands for: the fields of its default, or itself."""
    if dataclasses.is_dataclass(argument.default):
        return [field.name for field in dataclasses.fields(argument.default)]
    return [argument.name]


def split_fields(words: Sequence[str], command: Callable[..., Any]) -> tuple[list[str], dict[str, list[str]]]:
    """Split the words of a command into its own options and fields of the scenario.

    Fields are written ``--a.b.c VALUE ...`` or ``--a.b.c=VALUE``.

    Args:
        words: the words after the command's name.
        command: the command.

    Returns:
        The command's own words, and the values of each field as typed.
    """
    arguments = inspect.signature(command).parameters.values()
    names = [name for argument in arguments for name in _options(argument)]
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
