"""Commands ``conform`` and ``zoo``: closed forms beside several engines, claims of papers beside runs."""

from __future__ import annotations

import json as json_text
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin import zoo as experiments
from coop_pin.base.errors import FieldError
from coop_pin.cli.terminal import Working, print_wrapped


def conform(
    engine: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = (),
    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD")] = (),
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Compare the internal force of several engines with closed forms, in digits of force and moment.

    Twelve cases in a plane and in space. An engine that is not installed is a column of "-". It needs a
    checkout: pip install -e '.[bench]'.

    Args:
        engine: names of benchmarks/conform/engines, files or folders of your own, or module:Class; all of
            that folder when omitted.
        case: words that the names of cases must have; all cases when omitted.
        page: page in which the text between its comments "conform" is replaced by the table.

    Raises:
        FieldError: coop_pin is installed without its checkout.
    """
    folder = conform_folder(Path(__file__).parents[2])
    options = {"--engine": engine, "--case": case, "--page": () if page is None else (str(page),)}
    words = [word for option, values in options.items() if values for word in (option, *values)]
    return subprocess.run([sys.executable, str(folder), *words], check=False).returncode


def conform_folder(checkout: Path) -> Path:
    """Return the folder of cases and engines: other engines are no part of what one run needs.

    Args:
        checkout: Folder of the repository, if coop_pin runs from one.

    Raises:
        FieldError: it is none.
    """
    folder = checkout / "benchmarks" / "conform"
    if not folder.is_dir():
        remedy = "git clone the repository, and in it: pip install -e '.[bench]'"
        raise FieldError(f"is a benchmark, which only a checkout has; {remedy}", "conform")
    return folder


def zoo(
    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME...")] = (),
    all: bool = False,
    short: bool = False,
    json: bool = False,
) -> None:
    """List published experiments that are rebuilt here, or run some: numbers, limits, a verdict a claim.

    Args:
        names: experiments to run; when omitted they are listed.
        all: run all of them.
        short: run short forms, of seconds.
        json: print the list, or the numbers and verdicts, as JSON.
    """
    known = experiments.experiment_names()
    chosen = [experiments.load_experiment(name) for name in (known if all or not names else names)]
    if not (names or all):
        if json:
            print(json_text.dumps([one.model_dump() for one in chosen], indent=2))
            return
        for one in chosen:
            print_wrapped(f"{one.name:<24} {len(one.claims)} claims  {one.title}")
        return
    told = []
    for one in chosen:
        with Working(f"running {one.name}", quiet=json):
            told.append(one.run(short=short))
        if not json:
            print(f"{told[-1].summary()}\n")
    if json:
        print(json_text.dumps([one.to_json() for one in told], indent=2, allow_nan=False))
