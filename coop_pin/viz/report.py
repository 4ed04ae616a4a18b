"""Report of a run: one self-contained HTML page with its scenario, metrics, figures and 3-D replay."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Iterable
from pathlib import Path
from string import Template
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from coop_pin import __version__
from coop_pin.base.arrays import typed
from coop_pin.base.schema.changes import stated, table_text, value_text
from coop_pin.base.schema.user_code import code_named
from coop_pin.figures.motion_views import motion_figure
from coop_pin.figures.run_figures import (
    error_figure,
    friction_figure,
    internal_force_figure,
    singularity_figure,
    torque_figure,
    tracking_figure,
)
from coop_pin.results.metrics import METRIC_TEXTS, metric_text
from coop_pin.results.run_result import RunResult
from coop_pin.viz.highlights import events_text, read_number, telling_instant, verdict_lines
from coop_pin.viz.page import inside_page, save_page, web_file
from coop_pin.viz.replay import replay_html


class MetricRow(NamedTuple):
    """Row of the table of metrics.

    Attributes:
        name: name of the metric.
        text: description.
        value: number with its unit, or why there is none.
        window: times over which it is taken.
    """

    name: str
    text: str
    value: str
    window: str


_LINE_PT = 0.3
"""Distance by which a drawn curve may be off its values, points."""
_NUMERICAL = ("closure_error_max_m", "closure_error_max_rad", "energy_balance_max_J")
"""Metrics of the accuracy of the computation, not of the control."""


@typed
def metrics_table(result: RunResult) -> list[MetricRow]:
    """Return the metrics of a result as rows of a table: of the control first, then of the computation.

    The verdicts and metrics that do not apply to the run are not among them.
    """
    values = {name: value for name, value in result.metrics().items() if not math.isnan(value)}
    return [
        MetricRow(
            name,
            text,
            f"{values[name] * scale:.3g} {unit}"
            if math.isfinite(values[name])
            else metric_text(values[name]),
            ", ".join(map(str, result.windows_of(name))),
        )
        for name, (text, unit, scale) in METRIC_TEXTS.items()
        if name in values
    ]


def scenario_facts(result: RunResult) -> list[tuple[str, str]]:
    """Return labels and texts: arms, payload, controller, clock, motion, events, plant."""
    scenario = result.scenario
    cell, clock, plant = scenario.cell, scenario.clock, scenario.plant
    law = scenario.controller.model_dump(exclude_none=True)
    kind, gains = law.pop("kind"), law.pop("gains", {})
    facts = [(f"arm {name}", _arm(result, index)) for index, name in enumerate(cell.arms)]
    facts += [
        ("payload", f"{cell.payload.mass:g} kg"),
        ("task", f"{cell.rows} ({cell.task_rows.size} rows), gravity ({_row(cell.gravity)}) m/s²"),
        ("controller", f"{kind}: {table_text(gains | law)}"),
        ("motion", scenario.motion.kind),
        ("clock", f"{clock.rate_hz:g} Hz, {clock.steps_per_tick} plant steps in a tick, {result.end:g} s"),
        ("plant", f"payload {plant.payload}, {plant.integrator}"),
    ]
    facts += [
        (f"{part} of {name}", text)
        for name, arm in cell.arms.items()
        for part, value in (("sensors", scenario.sensors_of(name)), ("calibration", arm.calibration_error))
        if (text := table_text(stated(value)))
    ]
    facts += [("event", value_text(event)) for event in scenario.events]
    if result.engine != RunResult.USUAL_ENGINE:
        remarks = result.data.attrs.get(RunResult.REMARKS, "").splitlines()
        facts.append(("engine", "; ".join((result.engine, *remarks))))
    return facts


def _arm(result: RunResult, index: int) -> str:
    cell = result.scenario.cell
    arm = list(cell.arms.values())[index]
    named = [name for _, name in code_named(result.scenario.squeeze)]  # which a page does not call
    squeeze = named[0] if named else _row(result.scenario.squeeze_wrenches[index])
    return (
        f"{arm.urdf}, tip {arm.tip}, base at ({_row(arm.base.xyz)}) m, "
        f"carries {cell.shares[index]:.3g} of the load; "
        f"desired internal wrench ({squeeze}) N, N m about P in payload axes"
    )


def _row(values: Iterable[float]) -> str:
    return ", ".join(f"{round(value, 9) + 0.0:.4g}" for value in values)


@typed
def report_html(result: RunResult) -> str:
    """Return one self-contained page: scenario, metrics, figures, limits, and the 3-D replay.

    It loads nothing from the network and can be printed; on paper a figure of the motion replaces the replay.
    The same result gives the same bytes.

    Args:
        result: the run, finished or not.
    """
    scenario, end = result.scenario, result.end
    broken_off = f'<p class="warning">This run broke off at t = {end:g} s of {scenario.duration:g} s.</p>'
    metrics, friction = result.metrics(), ""
    absent = "; ".join(
        text for name, (text, *_) in METRIC_TEXTS.items() if math.isnan(metrics.get(name, 0.0))
    )
    if scenario.cell.padded:
        friction = figure_image(
            friction_figure(result), "friction used, and normal force beyond what it needs"
        )
    return Template(web_file("report.html")).substitute(
        title=html.escape(scenario.name),
        summary=html.escape(scenario.caption),
        style=web_file("report.css"),
        version=html.escape(__version__),
        broken_off=broken_off * (end < scenario.duration - 1e-9),
        verdict=_verdict(result),
        sentence=html.escape(f"{events_text(result)} {telling_instant(result).text}".strip()),
        tiles=_tiles(result),
        facts="\n".join(
            f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
            for name, text in scenario_facts(result)
        ),
        metrics="\n".join(
            f"<tr{' class=numerical' if row.name in _NUMERICAL else ''}><td>{html.escape(row.text)}</td>"
            f'<td class="number">{_unbroken(row.value)}</td>'
            f'<td class="number window">{_unbroken(row.window)}</td>'
            f'<td class="name"><code>{html.escape(row.name)}</code></td></tr>'
            for row in metrics_table(result)
        ),
        left_out=f"Left out, because it does not apply to this run: {html.escape(absent)}." if absent else "",
        replay=inside_page(replay_html(result)),
        motion=figure_image(motion_figure(result), "paths of payload and tips"),
        tracking=figure_image(
            tracking_figure(result), "payload pose against the desired one, and the axial internal force"
        ),
        internal=figure_image(
            internal_force_figure(result),
            "axial force, shear force and moment of the internal wrench on each arm",
        ),
        friction=f"<figure>{friction}</figure>" if friction else "",
        torque=figure_image(torque_figure(result), "drive torques of every joint"),
        errors=figure_image(error_figure(result), "pose errors, closure drift and energy balance"),
        singularity=figure_image(singularity_figure(result), "condition number of each payload Jacobian"),
        limits=_limits(result),
        toml=html.escape(scenario.to_toml()),
    )


@typed
def save_report(result: RunResult, path: str | Path) -> None:
    """Write the report of a run; if writing fails, an older file at that path stays.

    Args:
        result: the run.
        path: the file, for example "report.html".
    """
    save_page(report_html(result), path)


def _unbroken(text: str) -> str:
    """Return numbers with units as HTML whose lines break behind commas only."""
    return html.escape(text).replace(" ", "&nbsp;").replace(",&nbsp;", ", ")


def _verdict(result: RunResult) -> str:
    lines = "".join(
        f'<p class="{"verdict" if line.is_good else "warning"}"><b>{html.escape(line.text)}</b>'
        f"{html.escape(f': {line.numbers}' if line.numbers else '')}</p>"
        for line in verdict_lines(result)
    )
    breaches = (*result.breaches(), *result.task.deviations)
    reasons = "".join(f"<li>{html.escape(str(breach))}</li>" for breach in breaches)
    known = "".join(
        f'<p class="warning">known before the run, {finding.severity}: {html.escape(str(finding))}</p>'
        for finding in result.findings
    )
    return lines + (f'<ol class="breaches">{reasons}</ol>' if reasons else "") + known


def _tiles(result: RunResult) -> str:
    """Return the internal wrench and the tracking error at the telling instant, of the worst arm."""
    now = result.data.sel(time=telling_instant(result).time)
    parts = (("", "axial", "N"), ("across", "shear", "N"), ("moment", "moment", "N m"))
    tiles = []
    for name, part, unit in parts:
        arm = int(np.nan_to_num(np.abs(now[f"internal_{part}"].values)).argmax())
        value, desired = (float(now[f"{prefix}internal_{part}"].values[arm]) for prefix in ("", "desired_"))
        if part == "axial":
            name = "pull apart" if value > 0.0 else "squeeze"
        tiles.append((name, value, unit, f"wanted {round(desired, 3) + 0.0:g} {unit}"))
    distance, angle = (
        1e3 * np.linalg.norm(now["pose_error"].values[rows]) for rows in (slice(3), slice(3, 6))
    )
    tiles.append(("off path", float(distance), "mm", f"{angle:.2g} mrad turned"))
    return "".join(
        f"<div>{name}<b>{read_number(value)} <small>{unit}</small></b>{note}</div>"
        for name, value, unit, note in tiles
        if not math.isnan(value)
    )


def _limits(result: RunResult) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(exceeded.arm)}</td><td>{html.escape(exceeded.joint)}</td>"
        f'<td>{exceeded.kind}</td><td class="number">{exceeded.worst:.4g}</td>'
        f'<td class="number">{exceeded.limit:.4g}</td><td class="number">{exceeded.first_time:.4g}</td></tr>'
        for exceeded in result.limit_violations()
    )
    if not rows:
        return "<p>No joint and no drive exceeded its limits.</p>"
    names = ("arm", "joint", "limit of", "worst", "limit", "first at, s")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    return f'<div class="scroll"><table class="list"><thead>{head}</thead><tbody>{rows}</tbody></table></div>'


def figure_image(figure: Figure, text: str) -> str:
    """Return a figure as an image element; inline SVGs would share their ids."""
    figure.suptitle("")  # the page has its own headings
    figure.supxlabel("")
    file = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "coop_pin", "path.simplify_threshold": _LINE_PT}):
        figure.savefig(file, format="svg", metadata={"Date": None})  # the same bytes for the same figure
    paths = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), file.getvalue())
    content = base64.b64encode(paths.encode()).decode("ascii")
    columns = figure.axes[0].get_subplotspec().get_gridspec().ncols  # type: ignore[union-attr]
    width, height = figure.get_size_inches()
    shape = f' data-columns="{columns}" style="--shape: {width / height / columns:.3f}"' * (columns > 1)
    return f'<img alt="{html.escape(text)}"{shape} src="data:image/svg+xml;base64,{content}">'
