"""``coop-pin tune`` as it is typed; what it does is in ``tuning``, which takes longer to load."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclasses.dataclass(frozen=True)
class Tune:
    """Search fields of a scenario for the smallest value of a metric.

    Every try is a run that is kept; the same command goes on where it was stopped. For example, two gains that keep the internal force
    small among those that settle in time:

    coop-pin tune adept-paper --minimize internal_axial_rms_error_N --subject-to 'settling_time_s<2.5'
    --vary controller.gains.sign_gain 0 1 --vary controller.gains.pose_gain 1 5

    Attributes:
        scenario: name of a scenario that comes with coop_pin, or the path of a TOML file.
        minimize: name of a metric, for example position_rms_m or torque_peak_Nm; metrics.json of any run names them all.
        vary: a field with its lowest and highest value; once for each field. coop-pin fields SCENARIO lists fields.
        subject_to: a bound that the best run must keep, METRIC<NUMBER or METRIC>NUMBER in quotes; once for each bound.
        out: the folder that keeps the runs and their table; out/tune- and the scenario's name when omitted.
        method: how to search: evolution is differential evolution; optuna needs pip install 'coop-pin[tune]'.
        generations: how many, after the first one.
        population: runs in a generation for each field, at least 5 together: there are (generations + 1) x population x fields runs in all.
        seed: of the search; another seed tries other values.
        workers: number of processes, 0 for this one; one for each processor when omitted.
        scheduler: address of a dask scheduler to use instead of local processes, for example tcp://127.0.0.1:8786.
        quiet: no progress bar and no summary.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
    minimize: Annotated[str, tyro.conf.arg(metavar="METRIC")]
    vary: Annotated[tuple[tuple[str, float, float], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FIELD LOW HIGH")]
    subject_to: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="BOUND")] = ()
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    method: Literal["evolution", "optuna"] = "evolution"
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
