"""``coop-pin run`` as it is typed; what it does is in ``running``, which takes longer to load."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

import tyro
from tqdm import tqdm

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.cli.overrides import changes
from coop_pin.controller_factory import build_controller
from coop_pin.description import Scenario
from coop_pin.errors import CoopPinError, RunInterruptedError
from coop_pin.report import save_report
from coop_pin.results import RunResult
from coop_pin.run_folder import RunFolder, Stopwatch, Timing
from coop_pin.simulation import simulate


class ProgressBar:
    """Shows how far a run is; a context manager that leaves the terminal clean."""

    def __init__(self, title: str, quiet: bool) -> None:
        # disable=None: tqdm shows itself on terminals only
        self._bar = tqdm(desc=title, unit=" ticks", leave=False, disable=True if quiet else None)

    def show(self, done: int, total: int) -> None:
        """Show that so many ticks of all are done."""
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()


@dataclasses.dataclass(frozen=True)
class Run:
    """Run a scenario and write its results into a folder.

    Every field of the scenario can be changed: --controller.gains.sign-gain 0.5 --cell.arms.left.posture 1 2
    3 --controller.switching.kind tanh --events []. 'coop-pin fields NAME_OR_FILE' lists them.

    Attributes:
        scenario: a name that 'coop-pin list' shows, or a TOML file.
        out: the folder; out/ and the scenario's name when omitted.
        quiet: no progress bar and no table.
        replay: whether to write replay.html, the motion in 3-D.
        figures: whether to write the figures.
        report: whether to write report.html, one page that tells the whole run.
        fields: fields of the scenario, as typed.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    quiet: bool = False
    replay: bool = True
    figures: bool = True
    report: bool = False
    fields: Annotated[Mapping[str, Sequence[str]], tyro.conf.Suppress] = dataclasses.field(
        default_factory=dict
    )

    def execute(self) -> int:
        """Run, write, print; return the exit code."""
        from coop_pin.cli.run import run_into_folder

        return run_into_folder(self)


def run_into_folder(command: Run) -> int:
    """Run a scenario, write its folder, print a table, and return the exit code.

    A run that breaks off is written as far as it came.

    Raises:
        CoopPinError: the run could not start.
    """
    sys.path.append(str(Path.cwd()))  # users' own controllers are found as python -m finds them
    scenario = Scenario.load(command.scenario)
    scenario = scenario.override(changes(command.fields, scenario.cell.arms))
    folder = RunFolder(command.out or Path("out") / scenario.name)
    folder.path.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made must not cost a run
    watch = Stopwatch()
    try:
        with ProgressBar(scenario.name, command.quiet) as bar:
            result = simulate(scenario, build_controller(scenario), bar.show)
    except (CoopPinError, RunInterruptedError) as error:
        if error.result is None:
            raise
        folder.write_unfinished(error.result, watch.timing(error.result))
        print(f"coop-pin: {error} in {folder.path / folder.RESULT}", file=sys.stderr)
        return INTERRUPTED if isinstance(error, RunInterruptedError) else FAILED
    timing = watch.timing(result)
    folder.write(result, timing, replay=command.replay, figures=command.figures)
    if command.report:
        save_report(result, folder.path / folder.REPORT)
    if not command.quiet:
        print(table(result, timing))
        print(f"written to {folder.path}")
    return OK


def _said(value: float) -> str:
    """Return a metric in words where it is no number."""
    if math.isnan(value):
        return "does not apply"
    return "never" if math.isinf(value) else f"{value:.4g}"


def table(result: RunResult, timing: Timing) -> str:
    """Return the metrics of a run as lines of text, and the limits that it went beyond."""
    scenario = result.scenario
    lines = [
        f"{scenario.name}: {result.end:g} s at {scenario.clock.rate_hz:g} Hz, {timing.real_time_factor:.1f} times real time"
    ]
    for name, value in result.metrics().items():
        lines.append(f"  {name:<30} {_said(value)}")
    start, end = result.steady_window
    if start >= end:
        lines.append(f"  no rms values: the run ends, or an event comes, before {start:g} s")
    elif math.isinf(result.settling_time()):
        lines.append("  it never settled: 'coop-pin check' tells whether the control rate can bear the gains")
    for beyond in result.limit_violations():
        where = f"{beyond.kind} of {beyond.arm} {beyond.joint}"
        lines.append(
            f"  beyond its limit: {where}, {beyond.worst:.4g} (limit {beyond.limit:.4g}), first at t = {beyond.first_time:.4g} s"
        )
    return "\n".join(lines)
