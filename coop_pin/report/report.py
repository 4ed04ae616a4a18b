"""The page of a run: one file that needs no network, on screen and on paper."""

from __future__ import annotations

import base64
import html
import io
from importlib import resources
from pathlib import Path
from string import Template

import matplotlib as mpl
from matplotlib.figure import Figure

from coop_pin import __version__
from coop_pin.figures import error_figure, torque_figure, tracking_figure
from coop_pin.figures.motion_figure import motion_figure
from coop_pin.report.internal_force import internal_force_figure
from coop_pin.report.judgements_table import Judgement, judgements
from coop_pin.report.scenario_table import scenario_facts
from coop_pin.report.singularity import singularity_figure
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.replay import replay_html

_NO_LIMIT_EXCEEDED = "<p>No joint and no drive went beyond its limits.</p>"


def report_html(result: RunResult) -> str:
    """Return one self-contained page: scenario, judgements, figures, limits, and the 3-D replay.

    It loads nothing from outside, plays offline, and prints; on paper a drawing of the motion stands in for the replay. The
    same result gives the same bytes.

    Args:
        result: the run, finished or not.
    """
    scenario = result.scenario
    return Template(_page_file("report.html")).substitute(
        title=html.escape(scenario.name),
        summary=html.escape(scenario.summary),
        style=_page_file("report.css"),
        version=html.escape(__version__),
        broken_off=_broken_off(result),
        facts=_facts(result),
        judgements=_judgements(judgements(result)),
        window=_window(result),
        replay=html.escape(replay_html(result)),
        motion=_image(motion_figure(result), "paths of payload and tips"),
        tracking=_image(tracking_figure(result), "payload pose against the desired one, and the axial internal force"),
        internal=_image(internal_force_figure(result), "axial force, shear force and moment of the internal wrench on each arm"),
        torque=_image(torque_figure(result), "drive torques of every joint"),
        errors=_image(error_figure(result), "pose errors, closure drift and energy balance"),
        singularity=_image(singularity_figure(result), "condition number of each payload Jacobian"),
        limits=_limits(result),
        toml=html.escape(scenario.to_toml()),
    )


def save_report(result: RunResult, path: str | Path) -> None:
    """Write the report of a run; a good file at that path is never destroyed half-way.

    Args:
        result: the run.
        path: the file, for example "report.html".
    """
    page = report_html(result)
    write_atomically(Path(path), lambda part: part.write_text(page, encoding="utf-8"))


def _broken_off(result: RunResult) -> str:
    if result.end >= result.scenario.duration - 1e-9:
        return ""
    return f'<p class="warning">This run broke off at t = {result.end:g} s of {result.scenario.duration:g} s.</p>'


def _facts(result: RunResult) -> str:
    rows = (f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in scenario_facts(result))
    return "\n".join(rows)


def _judgements(lines: list[Judgement]) -> str:
    return "\n".join(
        f'<tr{" class=tight" if line.tight else ""}><td>{html.escape(line.text)}</td><td class="number">{html.escape(line.value)}</td>'
        f'<td class="name"><code>{html.escape(line.name)}</code></td></tr>'
        for line in lines
    )


def _window(result: RunResult) -> str:
    window = result.steady_window
    return f"{window.start:g} s to {window.end:g} s" if window.end > window.start else "a window this run did not reach"


def _limits(result: RunResult) -> str:
    rows = [
        f"<tr><td>{html.escape(beyond.arm)}</td><td>{html.escape(beyond.joint)}</td><td>{beyond.kind}</td>"
        f'<td class="number">{beyond.worst:.4g}</td><td class="number">{beyond.limit:.4g}</td>'
        f'<td class="number">{beyond.first_time:.4g}</td></tr>'
        for beyond in result.limit_violations()
    ]
    if not rows:
        return _NO_LIMIT_EXCEEDED
    head = "<tr><th>arm</th><th>joint</th><th>limit of</th><th>worst</th><th>limit</th><th>first at, s</th></tr>"
    return f'<div class="scroll"><table class="list"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table></div>'


def _image(figure: Figure, text: str) -> str:
    """Return a figure as an image inside the page; as an image, because names inside two SVGs would clash."""
    figure.suptitle("")  # the page has headings of its own
    figure.supxlabel("")
    file = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "coop_pin"}):  # the same bytes for the same figure
        figure.savefig(file, format="svg", metadata={"Date": None})
    content = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img alt="{html.escape(text)}" src="data:image/svg+xml;base64,{content}">'


def _page_file(name: str) -> str:
    return resources.files("coop_pin.report").joinpath("page", name).read_text(encoding="utf-8")
