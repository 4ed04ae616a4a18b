"""Page of a blame: ranked causes, the arms' views, every estimate, and the cell with the errors."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from string import Template

import numpy as np

from coop_pin.base.arrays import typed
from coop_pin.figures.blame_figures import blame_figure, views_figure
from coop_pin.identification.answer import Blame
from coop_pin.identification.effects import friction_parameters
from coop_pin.identification.estimate import Fit
from coop_pin.viz.log_replay import logged_run
from coop_pin.viz.page import inside_page, save_page, web_file
from coop_pin.viz.replay import replay_html
from coop_pin.viz.report import figure_image

_NO_DESIRED = (
    " The log has no desired pose: what is seen stands for it, and errors of the path are not known."
)


@typed
def blame_html(answer: Blame) -> str:
    """Return one self-contained page of an answer.

    Args:
        answer: answer with estimates.
    """
    causes = ""
    if any(cause.counts for cause in answer.causes):
        causes = figure_image(blame_figure(answer), "causes of internal force with intervals")
    fits = [fit for fit in (answer.kinematics, answer.payload) if fit is not None]
    return Template(web_file("blame.html")).substitute(
        title=html.escape(answer.scenario.name),
        summary=html.escape(answer.scenario.caption),
        style=web_file("report.css"),
        causes=causes,
        text=html.escape(answer.summary()),
        views=figure_image(views_figure(answer), "views of the arms over time"),
        replay=_replay(answer),
        desired="" if len(answer.record.desired_time) else _NO_DESIRED,
        motion="" if answer.excitation is None else html.escape(answer.excitation.to_toml()),
        estimates="\n".join([*map(_rows, fits), _other_rows(answer)]),
        errors=html.escape(answer.with_errors().to_toml(commented=True)),
    )


def _replay(answer: Blame) -> str:
    """Return the replay of a log as elements; of arms on shared joints none."""
    if answer.scenario.cell.shared_joints:
        return "<p>No replay shows arms on shared joints, whose positions no log has.</p>"
    return inside_page(replay_html(logged_run(answer)))


@typed
def save_blame(answer: Blame, path: str | Path) -> None:
    """Write the page of an answer; if writing fails, an older file at that path stays.

    Args:
        answer: answer with estimates.
        path: the file, for example "blame.html".
    """
    save_page(blame_html(answer), path)


def _rows(fit: Fit) -> str:
    """Return the estimates of a fit as rows of a table."""
    columns = (fit.x, 1.96 * fit.sd, fit.prior, np.clip(fit.seen, 0.0, 1.0))
    return "\n".join(
        _row(str(one), one.written, (x, interval), (f"{one.written[0] * prior:.2g}", f"{seen:.2f}"))
        for one, x, interval, prior, seen in zip(fit.parameters, *columns, strict=True)
    )


def _other_rows(answer: Blame) -> str:
    """Return friction and the load shares of the law as rows: they have no prior."""
    seen = [one for one in answer.friction if one.is_seen]
    rows = [
        _row(str(drive), (1.0, "N m"), (one.coulomb, 1.96 * one.sd[1]))
        for drive, one in zip(friction_parameters(seen), seen, strict=True)
    ]
    if answer.share is not None:  # its force is proportional to them
        share = answer.share
        off = np.abs(np.array(share.sizes) - answer.scenario.cell.shares)
        intervals = off * (share.high / max(share.newtons, 1e-12) - 1.0)
        columns = zip(share.members, share.sizes, intervals, strict=True)
        rows += [_row(str(one), one.written, numbers) for one, *numbers in columns]
    return "\n".join(rows)


def _row(
    name: str, written: tuple[float, str], numbers: Sequence[float], beside: Sequence[str] = ("", "")
) -> str:
    """Return an estimate as a row, to two digits of its interval."""
    factor, unit = written
    value, interval = (factor * number for number in numbers)
    digits = max(1 - int(np.floor(np.log10(max(interval, 1e-6)))), 0)
    cells = (f"{value:{'+' * bool(unit)}z.{digits}f}", f"{interval:.{digits}f}", *beside)
    columns = "".join(f'<td class="number">{cell}</td>' for cell in cells)
    return f"<tr><td>{html.escape(', '.join(filter(None, (name, unit))))}</td>{columns}</tr>"
