"""What ``coop-pin tune`` does."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, OK
from coop_pin.cli.tune import Tune
from coop_pin.errors import StoreLockedError, StoreWriteError, SweepInterruptedError, WorkersLostError
from coop_pin.sweeps.tune import tune


def run_tune(command: Tune) -> int:
    """Search, print the best run, and return the exit code.

    Raises:
        CoopPinError: the search cannot begin, or nothing is within the bounds.
    """
    sys.path.append(str(Path.cwd()))  # users' own controllers are found as python -m finds them
    folder = command.out or Path("out") / f"tune-{Path(command.scenario).stem}"
    try:
        found = tune(
            command.scenario,
            {field: (low, high) for field, low, high in command.vary},
            minimize=command.minimize,
            subject_to=command.subject_to,
            out=folder,
            generations=command.generations,
            population=command.population,
            seed=command.seed,
            workers=command.workers,
            scheduler=command.scheduler,
            quiet=command.quiet,
        )
    except (StoreLockedError, StoreWriteError, WorkersLostError) as error:
        print(f"coop-pin: {error}", file=sys.stderr)
        return FAILED
    except SweepInterruptedError:
        again = shlex.join(["coop-pin", *sys.argv[1:]])
        print(f"\ncoop-pin: finished runs are kept in {folder}; go on with: {again}", file=sys.stderr)
        return INTERRUPTED
    print(f"{command.minimize} = {found.best.metrics[command.minimize]:.6g} in run {found.best.number} of {len(found.history.plan)}")
    for field, value in found.best.parameters.items():
        print(f"  {field} = {value:.6g}")
    print(f"written to {folder}")
    return OK
