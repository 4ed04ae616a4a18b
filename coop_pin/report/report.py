"""The page of a run: one file that needs no network, on screen and on paper."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from string import Template
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from coop_pin import __version__
from coop_pin.figures import error_figure, torque_figure, tracking_figure
from coop_pin.figures.motion_figure import motion_figure
from coop_pin.figures.run_figures import internal_force_figure, singularity_figure
from coop_pin.results import RunResult
from coop_pin.results.atomic_write import write_atomically
from coop_pin.viz.replay import replay_html


class Wording(NamedTuple):
    """How a metric is told.

    Attributes:
        text: what it is.
        unit: as shown.
        scale: from the SI value to the unit as shown.
        tight: whether it says how exact the computation was, not how good the control.
    """

    text: str
    unit: str
    scale: float = 1.0
    tight: bool = False


class Judgement(NamedTuple):
    """One line of the table.

    Attributes:
        name: of the metric.
        text: what it is.
        value: with its unit, or why there is none.
        tight: as for ``Wording``.
    """

    name: str
    text: str
    value: str
    tight: bool


_WORDINGS = {
    "settling_time_s": Wording("settles to 5 mm and 5 mrad after the start", "s"),
    "resettling_time_s": Wording("settles again after the first event", "s"),
    "event_peak_position_error_m": Wording("largest position error from the first event on", "mm", 1e3),
    "position_rms_m": Wording("position error, rms", "mm", 1e3),
    "orientation_rms_rad": Wording("orientation error, rms", "mrad", 1e3),
    "internal_axial_mean_N": Wording("internal force along the line between the tips, mean", "N"),
    "internal_axial_rms_error_N": Wording("internal force along the line, rms of its error", "N"),
    "internal_shear_rms_N": Wording("internal force across the line, rms of its error", "N"),
    "internal_moment_rms_error_Nm": Wording("internal moment about P, rms of its error", "N m"),
    "torque_peak_Nm": Wording("largest drive torque", "N m"),
    "closure_error_max_m": Wording("closure error, largest distance", "m", tight=True),
    "closure_error_max_rad": Wording("closure error, largest angle", "rad", tight=True),
    "energy_balance_max_J": Wording("energy minus work, largest", "J", tight=True),
}
_WINDOW = "window_s"


def judgements(result: RunResult) -> list[Judgement]:
    """Return every judgement of a run: control first, then the exactness of the computation.

    A metric without words of its own is shown by its name.
    """
    found = []
    for name, value in result.metrics().items():
        if name == _WINDOW:
            continue
        wording = _WORDINGS.get(name, Wording(name.replace("_", " "), ""))
        numbers = value if isinstance(value, list) else [value]
        text = ", ".join(_number(number, wording) for number in numbers)
        found.append(Judgement(name, wording.text, text, wording.tight))
    return sorted(found, key=lambda judgement: judgement.tight)


def _number(value: float, wording: Wording) -> str:
    if math.isnan(value):
        return "does not apply"
    if math.isinf(value):
        return "never"
    return f"{value * wording.scale:.3g} {wording.unit}".strip()


def scenario_facts(result: RunResult) -> list[tuple[str, str]]:
    """Return labels and texts: arms, payload, controller, clock, motion, events, plant."""
    scenario = result.scenario
    cell, clock, plant = scenario.cell, scenario.clock, scenario.plant
    facts = [(f"arm {name}", _arm(result, index)) for index, name in enumerate(cell.arms)]
    facts += [
        ("payload", f"{cell.payload.mass:g} kg"),
        ("task", f"{cell.rows} ({cell.task_rows.size} rows), gravity ({_row(cell.gravity)}) m/s²"),
        ("controller", _controller(result)),
        ("motion", scenario.motion.kind),
        ("clock", f"{clock.rate_hz:g} Hz, {clock.steps_per_tick} plant steps in a tick, {result.end:g} s"),
        ("plant", f"payload {plant.payload}, {plant.integrator}"),
    ]
    facts += [("event", _value(event.model_dump())) for event in scenario.events]
    return facts


def _arm(result: RunResult, index: int) -> str:
    cell = result.scenario.cell
    arm = list(cell.arms.values())[index]
    squeeze = result.scenario.squeeze_wrenches[index]
    return (
        f"{arm.urdf}, tip {arm.tip}, base at ({_row(arm.base.xyz)}) m, carries {cell.shares[index]:.3g} of the load; "
        f"desired internal wrench ({_row(squeeze)}) N, N m about P in payload axes"
    )


def _controller(result: RunResult) -> str:
    fields = result.scenario.controller.model_dump(exclude_none=True)
    kind, gains = fields.pop("kind"), fields.pop("gains", {})
    return f"{kind}: {_fields(gains | fields)}"


def _fields(table: dict[str, object]) -> str:
    """Return a table as words; empty entries say nothing."""
    return ", ".join(
        f"{name.replace('_', ' ')} {_value(value)}"
        for name, value in table.items()
        if value not in ({}, (), None)
    )


def _value(value: object) -> str:
    if isinstance(value, dict):
        kind = value.get("kind")
        rest = {name: entry for name, entry in value.items() if name != "kind"}
        return " ".join(
            part for part in (str(kind) if kind else "", f"({_fields(rest)})" if rest else "") if part
        )
    if isinstance(value, list | tuple):
        return f"({', '.join(_value(entry) for entry in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _row(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.4g}" for value in values)


_NO_LIMIT_EXCEEDED = "<p>No joint and no drive went beyond its limits.</p>"


def report_html(result: RunResult) -> str:
    """Return one self-contained page: scenario, judgements, figures, limits, and the 3-D replay.

    It loads nothing from outside, plays offline, and prints; on paper a drawing of the motion stands in for
    the replay. The same result gives the same bytes.

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
        tracking=_image(
            tracking_figure(result), "payload pose against the desired one, and the axial internal force"
        ),
        internal=_image(
            internal_force_figure(result),
            "axial force, shear force and moment of the internal wrench on each arm",
        ),
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
    rows = (
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in scenario_facts(result)
    )
    return "\n".join(rows)


def _judgements(lines: list[Judgement]) -> str:
    return "\n".join(
        f'<tr{" class=tight" if line.tight else ""}><td>{html.escape(line.text)}</td><td class="number">{html.escape(line.value)}</td>'
        f'<td class="name"><code>{html.escape(line.name)}</code></td></tr>'
        for line in lines
    )


def _window(result: RunResult) -> str:
    window = result.steady_window
    return (
        f"{window.start:g} s to {window.end:g} s"
        if window.end > window.start
        else "a window this run did not reach"
    )


def _limits(result: RunResult) -> str:
    rows = [
        f"<tr><td>{html.escape(beyond.arm)}</td><td>{html.escape(beyond.joint)}</td><td>{beyond.kind}</td>"
        f'<td class="number">{beyond.worst:.4g}</td><td class="number">{beyond.limit:.4g}</td>'
        f'<td class="number">{beyond.first_time:.4g}</td></tr>'
        for beyond in result.limit_violations()
    ]
    if not rows:
        return _NO_LIMIT_EXCEEDED
    head = (
        "<tr><th>arm</th><th>joint</th><th>limit of</th><th>worst</th><th>limit</th><th>first at, s</th></tr>"
    )
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
