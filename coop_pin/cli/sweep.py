"""Commands ``coop-pin sweep`` and ``coop-pin sweep-show``: run a plan of many runs, and show its results."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin import figures, sweeps, viz
from coop_pin.cli.execution import HERE, ExecutionOptions, kept_result
from coop_pin.cli.exit_codes import OK


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run a scenario many times. Finished runs are kept: the same command resumes an interrupted sweep.

    Attributes:
        plan: a TOML file with the scenario and the fields that vary.
        out: output folder for the runs and their table; out/ and the file's name when omitted.
        execution: workers, engine and folders to merge.
        retry_failed: repeat runs that failed for lack of time or of a worker.
        estimate: print only the plan and an estimate of its duration.
    """

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP.toml")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    execution: ExecutionOptions = HERE
    retry_failed: bool = False
    estimate: bool = False

    def execute(self) -> int:
        """Run the sweep, print its summary and return the exit code; failed runs do not fail the command."""
        plan = sweeps.SweepPlan.load(self.plan)
        if self.estimate:
            print(plan.summary(), sweeps.estimate(plan, workers=self.execution.workers).summary(), sep="\n")
            return OK
        folder = self.out or Path("out") / self.plan.stem.lstrip(".")
        result = sweeps.sweep(plan, out=folder, execution=self.execution, retry_failed=self.retry_failed)
        if not self.execution.quiet:
            print(result.summary())
            print(f"written to {folder}")
        return OK


@dataclasses.dataclass(frozen=True)
class SweepShow:
    """Print the results of a sweep, finished or not, and draw them.

    Attributes:
        folder: the folder of a sweep.
        best: a metric; the runs with its smallest values are listed.
        count: number of these runs.
        failures: list the runs that failed, with their errors.
        figure: draw the metric over the fields that vary; written as PNG and as SVG.
        metric: the metric that the figure shows.
        over: draw lines along this field instead of a map or lines along the longest dimension.
        against: a second metric: draw all runs by the two metrics, with the Pareto front.
        table: write these runs as CSV: varied fields, status, error, metrics, durations.
        page: write a heat map of these runs, an HTML page that is explored; it shows the metric first.
        replay: number of a run: simulate it again and write its 3-D replay, which the page links.
        at: show, list, draw and write only runs in which a varied field has this value, FIELD=VALUE; once for
            each field.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    best: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None
    count: Annotated[int, tyro.conf.arg(metavar="N")] = 5
    failures: bool = False
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    metric: Annotated[str, tyro.conf.arg(metavar="METRIC")] = "internal_axial_rms_error_N"
    over: Annotated[str | None, tyro.conf.arg(metavar="FIELD")] = None
    against: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    replay: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    at: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FIELD=VALUE")] = ()

    def execute(self) -> int:
        """Print the results and return the exit code.

        Raises:
            FileReadError: the folder is not that of a sweep.
            NameNotFoundError: no run has the metric, or no field of ``at`` varies.
            FieldError: no run has a value of ``at``.
        """
        fields = {field: value for field, _, value in (text.partition("=") for text in self.at)}
        result = sweeps.SweepResult.load(self.folder).at(fields)
        print(result.summary())
        if self.best is not None:
            print(f"smallest {self.best}:")
            for run in result.best(self.best, self.count):
                print(f"  {run.metrics[self.best]:<12.5g} run {run.number}: {_text(run.parameters)}")
        if self.failures:
            print("failed:")
            for failure in result.failures:
                reason = f"{failure.kind}: {failure.message}"
                print(f"  run {failure.number}: {_text(failure.parameters)}: {reason}")
        if self.figure is not None:
            if self.against is not None:
                figure = figures.pareto_figure(result, self.against, self.metric)
            else:
                figure = figures.sweep_figure(result, self.metric, self.over)
            stem = self.figure.with_suffix("") if self.figure.suffix in (".png", ".svg") else self.figure
            print("written to " + " and ".join(map(str, figures.save_figure(figure, stem))))
        if self.table is not None:
            result.store.write_with(self.table, result.table.to_csv)
            print(f"written to {self.table}")
        if self.replay is not None:
            from coop_pin.heat_map import REPLAYS

            replay = (self.page or self.folder / "map.html").parent / REPLAYS / f"run-{self.replay}.html"
            viz.save_replay(kept_result(lambda: result.open(self.replay)), replay)
            print(f"written to {replay}")
        if self.page is not None:
            result.write_html(self.page, self.metric)
            print(f"written to {self.page}")
        return OK


def _text(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in parameters.items())
