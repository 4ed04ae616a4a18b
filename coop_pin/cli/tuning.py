"""What ``coop-pin tune`` does."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.cli.overrides import field_path
from coop_pin.cli.tune import Tune
from coop_pin.description.scenario import Scenario
from coop_pin.errors import (
    CodeChangedError,
    FieldError,
    NothingFeasibleError,
    StoreLockedError,
    StoreWriteError,
    SweepInterruptedError,
    WorkersLostError,
)
from coop_pin.sweeps.tuner import TuneResult, tune
from coop_pin.sweeps.tuning.bound import Bound
from coop_pin.sweeps.tuning.effort import Ranges


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
    except (CodeChangedError, NothingFeasibleError, StoreLockedError, StoreWriteError, WorkersLostError) as error:
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
