"""``coop-pin tune`` as it is typed; what it does is in ``tuning``, which takes longer to load."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.cli.overrides import field_path
from coop_pin.description.scenario import Scenario
from coop_pin.errors import (
    CodeChangedError,
    FieldError,
    FileWriteError,
    NothingFeasibleError,
    StoreLockedError,
    SweepInterruptedError,
    WorkersLostError,
)
from coop_pin.sweeps.search import Ranges
from coop_pin.sweeps.tuner import Bound, TuneResult, tune


@dataclasses.dataclass(frozen=True)
class Tune:
    """Search fields of a scenario for the smallest value of a metric.

    Every try is a run that is kept; the same command goes on where it was stopped. For example, two gains
    that keep the internal force small among those that settle in time:

    coop-pin tune adept-paper --minimize internal_axial_rms_error_N --subject-to 'settling_time_s<2.5'
    --vary controller.gains.sign_gain 0 1 --vary controller.gains.pose_gain 1 5

    Attributes:
        scenario: name of a scenario that comes with coop_pin, or the path of a TOML file.
        minimize: name of a metric, for example position_rms_m or torque_peak_Nm; metrics.json of any run
            names them all.
        vary: a field with its lowest and highest value; once for each field. coop-pin fields SCENARIO lists
            fields.
        subject_to: a bound that the best run must keep, METRIC<NUMBER or METRIC>NUMBER in quotes; once for
            each bound.
        out: the folder that keeps the runs and their table; out/tune- and the scenario's name when omitted.
        method: how to search: evolution is differential evolution; optuna needs pip install 'coop-pin[tune]'.
        generations: how many, after the first one.
        population: runs in a generation for each field, at least 5 together: there are (generations + 1) x
            population x fields runs in all.
        seed: of the search; another seed tries other values.
        workers: number of processes, 0 for this one; one for each processor when omitted.
        scheduler: address of a dask scheduler to use instead of local processes, for example
            tcp://127.0.0.1:8786.
        quiet: no progress bar and no summary.
    """

    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
    minimize: Annotated[str, tyro.conf.arg(metavar="METRIC")]
    vary: Annotated[
        tuple[tuple[str, float, float], ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="FIELD LOW HIGH"),
    ]
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
        from coop_pin.cli.tune import run_tune

        return run_tune(self)


def run_tune(command: Tune) -> int:
    """Search, print the best run, and return the exit code.

    Raises:
        CoopPinError: the search cannot begin.
    """
    sys.path.append(str(Path.cwd()))  # users' own controllers are found as python -m finds them
    folder = command.out or Path("out") / f"tune-{Path(command.scenario).stem}"
    scenario = Scenario.load(command.scenario)
    try:
        found = tune(
            scenario,
            _ranges(command, scenario),
            minimize=command.minimize,
            subject_to=command.subject_to,
            out=folder,
            method=command.method,
            generations=command.generations,
            population=command.population,
            seed=command.seed,
            workers=command.workers,
            scheduler=command.scheduler,
            quiet=command.quiet,
        )
    except (
        CodeChangedError,
        NothingFeasibleError,
        StoreLockedError,
        FileWriteError,
        WorkersLostError,
    ) as error:
        print(f"coop-pin: {error}", file=sys.stderr)
        return FAILED
    except SweepInterruptedError as interrupt:
        again = shlex.join(["coop-pin", *sys.argv[1:]])
        kept = f"{interrupt.finished} of {interrupt.total} runs are kept in {folder}"
        print(f"\ncoop-pin: {kept}; go on with: {again}", file=sys.stderr)
        return INTERRUPTED
    if not command.quiet:
        print(_summary(command, found))
        print("all tries: " + shlex.join(["coop-pin", "sweep-show", str(folder)]))
        print(f"written to {folder}")
    return OK


def _ranges(command: Tune, scenario: Scenario) -> Ranges:
    """Return the range of each field; dashes stand for underscores.

    Raises:
        FieldError: a field is given twice.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for field, low, high in command.vary:
        path = field_path(field, scenario.cell.arms)
        if path in ranges:
            raise FieldError("has two ranges; give it one", path)
        ranges[path] = (low, high)
    return ranges


def _summary(command: Tune, found: TuneResult) -> str:
    """Return the best run in words that can be typed again."""
    best, counts = found.best, found.history.counts()
    lines = [f"best of {len(found.history.plan)} runs ({counts['failed']} failed): run {best.number}"]
    lines += [f"  {metric} = {best.metrics[metric]:.6g}" for metric in _shown(command)]
    lines += [f"  {field} = {value:.6g}" for field, value in best.parameters.items()]
    words = [word for field, value in best.parameters.items() for word in (f"--{field}", repr(value))]
    return "\n".join([*lines, "run it: " + shlex.join(["coop-pin", "run", command.scenario, *words])])


def _shown(command: Tune) -> list[str]:
    """Return the metrics that the command names, each once."""
    return list(dict.fromkeys([command.minimize, *(Bound.parse(text).metric for text in command.subject_to)]))
