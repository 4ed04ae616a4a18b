"""``coop-pin sweep`` and ``coop-pin sweep-show`` as they are typed; what they do is in ``sweeping``, which takes longer to load."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run a scenario many times; finished runs are kept, and the same command goes on where it was stopped.

    Attributes:
        plan: a TOML file that says what varies.
        out: the folder that keeps the runs and their table; out/ and the file's name when omitted.
        workers: number of processes, 0 for this one; one for each processor when omitted.
        scheduler: address of a dask scheduler to use instead of local processes, for example tcp://127.0.0.1:8786.
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
        from coop_pin.cli.sweeping import run_sweep

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
        from coop_pin.cli.sweeping import show_sweep

        return show_sweep(self)
