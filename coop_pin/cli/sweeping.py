"""What ``coop-pin sweep`` and ``coop-pin sweep-show`` do."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.cli.sweep import Sweep, SweepShow
from coop_pin.errors import CodeChangedError, StoreLockedError, StoreWriteError, SweepInterruptedError, WorkersLostError
from coop_pin.sweeps.estimates import estimate
from coop_pin.sweeps.one_call import sweep
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.where import Where


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
    options: dict[str, Any] = {"scheduler": command.scheduler, "retry_failed": command.retry_failed, "quiet": command.quiet}
    try:
        result = sweep(plan, out=folder, workers=command.workers, **options)
    except (CodeChangedError, StoreLockedError, StoreWriteError, WorkersLostError) as error:
        print(f"coop-pin: {error}", file=sys.stderr)
        return FAILED
    except SweepInterruptedError as interrupt:
        again = shlex.join(["coop-pin", *sys.argv[1:]])
        print(f"\ncoop-pin: {interrupt.finished} of {interrupt.total} runs are kept in {folder}; go on with: {again}", file=sys.stderr)
        return INTERRUPTED
    if not command.quiet:
        print(result.summary())
        print(f"written to {folder}")
    return OK


def show_sweep(command: SweepShow) -> int:
    """Print what a sweep says and return the exit code.

    Raises:
        SweepStoreError: the folder is not that of a sweep.
        EntryNotFoundError: no run has the metric.
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
            print(f"  run {failure.number}: {_written(failure.parameters)}: {failure.kind}: {failure.message}")
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
