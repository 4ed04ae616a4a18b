"""One call from what varies to a table of runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coop_pin.description.scenario import Scenario
from coop_pin.sweeps.engine import run_plan
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.where import Where

Base = str | Path | Scenario | Sequence[str | Path | Scenario] | Mapping[str, str | Path | Scenario]


def sweep(
    base: SweepPlan | Base,
    axes: Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    quiet: bool = False,
    **plan: Any,
) -> SweepResult:
    """Run a scenario many times and return a table of the results; finished runs are kept in a folder and never run again.

    ``sweep("adept-paper", {"controller.gains.sign_gain": [0.0, 0.1, 0.2]}, out="out/sign-gain")``. Runs are keyed by what determines
    them: the same call resumes, a changed one computes what is new.

    Args:
        base: a SweepPlan, or the plan's ``base``: a scenario, its name or path, or several.
        axes: the values of each varied field.
        out: the folder that keeps the runs.
        workers: number of processes; one for each processor when omitted, 0 for this process (debugging).
        scheduler: address of a dask scheduler to use instead of local processes.
        retry_failed: run again what failed for want of time or of a worker.
        quiet: no progress bar.
        plan: further fields of the SweepPlan: changes, cases, zipped, sample, repeats, metrics, time_limit_s, keep.

    Raises:
        ScenarioError: the plan has mistakes.
        FieldError: it names code of the user's own that stands in no file or that workers cannot import, or the scheduler's
            address is none.
        CodeChangedError: code of the user's own was edited after it was loaded.
        StoreLockedError: another process works on the folder.
        StoreWriteError: the disk is full; every run written before is kept.
        WorkersLostError: the scheduler is gone; every finished run is kept.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
    """
    chosen = _plan(base, axes, plan)
    run_plan(chosen, out, Where.of(workers, scheduler), retry_failed=retry_failed, quiet=quiet)
    result = SweepResult(chosen, SweepStore(out))
    result.write_tables()
    return result


def _plan(base: SweepPlan | Base, axes: Mapping[str, Any] | None, fields: Mapping[str, Any]) -> SweepPlan:
    if axes is not None:
        fields = {**fields, "axes": axes}
    if isinstance(base, SweepPlan):
        return base.replace(**fields)
    return SweepPlan(base=base, **fields)
