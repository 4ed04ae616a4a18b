"""Command ``blame``: who pulls the object apart, from a log of the arms or a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.cli.exit_codes import FAILED, OK
from coop_pin.cli.terminal import Working, print_wrapped


def blame(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    cell: str | None = None,
    link: float | None = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Say who pulls the object apart: which parameter, by how many newtons, from a log or a run.

    Tips, bases, joint offsets and clocks are fitted to the views that the arms have of the object, the
    payload and the zeros of the wrists to the sum of the wrenches, friction to the torques. Causes are ranked
    by the internal force that they make under the law of the cell, with 95 % intervals; what the log cannot
    tell apart is one cause.

    Args:
        log: CSV or MCAP file with the topics that the table log of the cell names, or the folder or result
            of a run.
        cell: cell as its user believes it, a TOML file or a name listed by 'coop-pin list'. Omit it for a
            run, whose own cell has its errors.
        link: relative error of the lengths of links that is possible, 2e-4 when omitted.
        out: folder for the page blame.html and for with_errors.toml, the cell that has the errors of the log;
            none of them when omitted.

    Raises:
        FileReadError: the file is missing or damaged, or has no such topic.
        ArgumentError: a log without a cell.
        ScenarioError: the cell has mistakes.
        MissingExtraError: an MCAP file without the extra 'logs'.
    """
    from coop_pin.base.errors import ArgumentError
    from coop_pin.identification.blame import blame as answer_of
    from coop_pin.identification.estimate import Priors

    if cell is None and log.suffix in (".csv", ".mcap"):
        raise ArgumentError("a log needs its cell: add --cell FILE, with the table [log]")
    with Working("reading the log and fitting the arms"):
        answer = answer_of(log, cell, priors=Priors() if link is None else Priors(link=link))
    print_wrapped(answer.summary())
    if not answer.findings.ok:
        return FAILED
    if out is not None:
        from coop_pin.viz.blame_page import save_blame  # slow to load

        with Working("drawing the page"):
            save_blame(answer, out / "blame.html")
        answer.with_errors().save(out / "with_errors.toml", commented=True)
        print(f"{out / 'blame.html'} and {out / 'with_errors.toml'} written")
    return OK
