"""``coop-pin tune`` as it is typed; what it does is in ``tuning``, which takes longer to load."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class Tune:
    """Search fields of a scenario for the smallest value of a metric; the same command goes on where it was stopped.

    Attributes:
        scenario: name of a scenario that comes with coop_pin, or the path of a TOML file.
        minimize: name of the metric.
        vary: fields, each with its lowest and highest value: --vary controller.gains.sign_gain 0 1 controller.gains.pose_gain 1 5.
        subject_to: bounds on metrics: 'settling_time_s<2.5'.
        out: the folder that keeps the runs and their table; out/tune- and the scenario's name when omitted.
        generations: how many, after the first one.
        population: runs in a generation for each field.
        seed: of the search.
        workers: number of processes, 0 for this one; one for each processor when omitted.
        scheduler: address of a dask scheduler to use instead of local processes.
        quiet: no progress bars.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
    minimize: Annotated[str, tyro.conf.arg(metavar="METRIC")]
    vary: Annotated[tuple[tuple[str, float, float], ...], tyro.conf.arg(metavar="FIELD LOW HIGH ...")]
    subject_to: Annotated[tuple[str, ...], tyro.conf.arg(metavar="BOUND ...")] = ()
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    generations: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    population: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    quiet: bool = False

    def execute(self) -> int:
        """Search, print; return the exit code."""
        from coop_pin.cli.tuning import run_tune

        return run_tune(self)
