"""Command ``zoo``: claims of papers beside runs."""

from __future__ import annotations

import json as json_text
from typing import Annotated

import tyro

from coop_pin import zoo as experiments
from coop_pin.cli.terminal import Working, print_wrapped


def zoo(
    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FOLDER...")] = (),
    all: bool = False,
    short: bool = False,
    json: bool = False,
) -> None:
    """List published experiments that are rebuilt here, or run some: numbers, limits, a verdict a claim.

    Args:
        names: experiments to run, names of the list or folders of your own; when omitted they are listed.
        all: run all of the list.
        short: run short forms, of seconds.
        json: print the list, or the numbers and verdicts, as JSON.
    """
    listed = experiments.experiment_names()
    chosen = [experiments.load_experiment(name) for name in (listed if all or not names else names)]
    if not (names or all):
        if json:
            rows = [{"name": one.name} | one.model_dump(mode="json") for one in chosen]
            print(json_text.dumps(rows, indent=2))
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
