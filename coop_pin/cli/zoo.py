"""Command ``zoo``: claims of papers against runs."""

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
    chosen = experiments.experiment_names() if all or not names else names
    rows = []
    for one in [experiments.load_experiment(name) for name in chosen]:  # a wrong name is told before any run
        if names or all:
            with Working(f"running {one.name}", quiet=json):
                run = one.run(short=short)
            row, text = run.to_json(), f"{run.summary()}\n\n"
        else:
            row = {"name": one.name} | one.model_dump(mode="json")
            text = f"{one.name:<24} {len(one.claims)} claims  {one.title}"
        rows.append(row)
        if not json:
            print_wrapped(text)
    if json:
        print(json_text.dumps(rows, indent=2, allow_nan=False))
