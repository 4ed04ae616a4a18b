"""``coop-pin sweep`` and ``coop-pin sweep-show`` as they are typed; what they do is in ``sweeping``, which takes longer to load."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.errors import (
    CodeChangedError,
    FileWriteError,
    StoreLockedError,
    SweepInterruptedError,
    WorkersLostError,
)
from coop_pin.sweeps.backend import Where
from coop_pin.sweeps.engine import sweep
from coop_pin.sweeps.estimates import estimate
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run a scenario many times; finished runs are kept, and the same command goes on where it was stopped.

    Attributes:
        plan: a TOML file that says what varies.
        out: the folder that keeps the runs and their table; out/ and the file's name when omitted.
        workers: number of processes, 0 for this one; one for each processor when omitted.
        scheduler: address of a dask scheduler to use instead of local processes, for example
            tcp://127.0.0.1:8786.
        retry_failed: run again what failed for want of time or of a worker.
        estimate: only print the plan and how long it will take.
        quiet: no progress bar and no summary.
    """

    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP.toml")]
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    retry_failed: bool = False
    estimate: bool = False
    quiet: bool = False

    def execute(self) -> int:
        """Run, write, print; return the exit code."""
        from coop_pin.cli.sweep import run_sweep

        return run_sweep(self)


@dataclasses.dataclass(frozen=True)
class SweepShow:
    """Print what a sweep says, finished or not.

    Attributes:
        folder: the folder of a sweep.
        best: name of a metric; the runs with its smallest values are listed.
        count: how many.
        failures: list the runs that failed, and why.
        figure: draw the metric over what varies; written as PNG and as SVG.
        metric: what the figure shows.
        over: a field to draw lines along, where a map or the longest field is not wanted.
        against: a second metric: draw all runs by the two, with the front of the best.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    best: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None
    count: Annotated[int, tyro.conf.arg(metavar="N")] = 5
    failures: bool = False
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    metric: Annotated[str, tyro.conf.arg(metavar="METRIC")] = "internal_axial_rms_error_N"
    over: Annotated[str | None, tyro.conf.arg(metavar="FIELD")] = None
    against: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None

    def execute(self) -> int:
        """Print; return the exit code."""
        from coop_pin.cli.sweep import show_sweep

        return show_sweep(self)


def run_sweep(command: Sweep) -> int:
    """Run a sweep, print its summary, and return the exit code; failed runs are part of a sweep and no failure of it.

    Raises:
        CoopPinError: the plan has mistakes.
    """
    sys.path.append(str(Path.cwd()))  # users' own controllers and metrics are found as python -m finds them
    plan = SweepPlan.load(command.plan)
    if command.estimate:
        print(plan, estimate(plan, Where.of(command.workers, None).workers), sep="\n")
        return OK
    folder = command.out or Path("out") / command.plan.stem
    options: dict[str, Any] = {
        "scheduler": command.scheduler,
        "retry_failed": command.retry_failed,
        "quiet": command.quiet,
    }
    try:
        result = sweep(plan, out=folder, workers=command.workers, **options)
    except (CodeChangedError, StoreLockedError, FileWriteError, WorkersLostError) as error:
        print(f"coop-pin: {error}", file=sys.stderr)
        return FAILED
    except SweepInterruptedError as interrupt:
        again = shlex.join(["coop-pin", *sys.argv[1:]])
        print(
            f"\ncoop-pin: {interrupt.finished} of {interrupt.total} runs are kept in {folder}; go on with: {again}",
            file=sys.stderr,
        )
        return INTERRUPTED
    if not command.quiet:
        print(result.summary())
        print(f"written to {folder}")
    return OK


def show_sweep(command: SweepShow) -> int:
    """Print what a sweep says and return the exit code.

    Raises:
        FileReadError: the folder is not that of a sweep.
        NameNotFoundError: no run has the metric.
    """
    result = SweepResult.load(command.folder)
    print(result.summary())
    if command.best is not None:
        print(f"smallest {command.best}:")
        for place in result.best(command.best, command.count):
            print(f"  {place.metrics[command.best]:<12.5g} run {place.number}: {_written(place.parameters)}")
    if command.failures:
        print("failed:")
        for failure in result.failures:
            print(
                f"  run {failure.number}: {_written(failure.parameters)}: {failure.kind}: {failure.message}"
            )
    if command.figure is not None:
        _draw(result, command, command.figure)
    return OK


def _draw(result: SweepResult, command: SweepShow, file: Path) -> None:
    from coop_pin.figures import pareto_figure, save_figure, sweep_figure  # matplotlib is slow to load

    if command.against is not None:
        figure = pareto_figure(result, command.against, command.metric)
    else:
        figure = sweep_figure(result, command.metric, command.over)
    stem = file.with_suffix("") if file.suffix in (".png", ".svg") else file
    print("written to " + " and ".join(map(str, save_figure(figure, stem))))


def _written(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in parameters.items())
