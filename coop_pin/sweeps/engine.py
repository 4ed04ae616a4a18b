"""Sweep: its engine, plant steps and estimated duration before the first run, and the call that runs it."""

from __future__ import annotations

import contextlib
import datetime
import logging
import random
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coop_pin.base.arrays import require_path, require_type, typed
from coop_pin.base.errors import CoopPinError, FieldError, FileReadError, OutOfRangeError, RunTimeoutError
from coop_pin.compiled.engine_choice import EngineChoice, choose_engines, plant_of
from coop_pin.description.scenario import Scenario
from coop_pin.running.run_scenario import run
from coop_pin.stability.step_size import STEPS_FIELD, fewest_steps
from coop_pin.sweeps.feasibility import require_feasible
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.session import open_session
from coop_pin.sweeps.store import SweepStore
from coop_pin.sweeps.workers.execution import HERE, Execution
from coop_pin.sweeps.workers.job import Job, deadline

_LOG = logging.getLogger("coop_pin.sweeps")
_SAMPLE = 8
"""Random points of a plan at which the error of plant steps is measured besides the extreme ones."""


def with_engine(plan: SweepPlan, store: SweepStore, runs: int | None = None) -> SweepPlan:
    """Return a plan with its engine decided: as the folder has it, otherwise by its first run.

    Args:
        plan: plan.
        store: folder of the plan.
        runs: number of runs of its kind in all; the plan's own when omitted.

    Raises:
        FieldError: the plan names "compiled", and only Pinocchio has the plant or an event of its first run.
    """
    if plan.engine == "pinocchio":
        return plan
    if plan.engine == "auto":
        with contextlib.suppress(FileReadError):
            return plan.model_copy(update={"engine": store.read_plan().engine})
    # A user's code runs in workers only; if it cannot be traced, they tell why.
    count = len(plan) if runs is None else runs
    (choice,) = choose_engines([plan.resolved(plan[0])], plan.engine, [count], traces_user_code=False)
    choice.require(plan.engine)
    if choice.obstacle not in (None, "few runs"):
        _LOG.warning("runs are simulated one by one: %s", choice.reason)
    return plan.model_copy(update={"engine": choice.engine}) if plan.engine == "auto" else plan


def with_steps(plan: SweepPlan, store: SweepStore) -> SweepPlan:
    """Return a plan whose ``steps_per_tick = "auto"`` is decided: as the folder has it, or by measured error.

    Points that were added to the plan of the folder are measured; its number stays if it suffices.

    Args:
        plan: plan with its engine decided.
        store: folder of the plan.

    Raises:
        OutOfRangeError: no number of steps keeps the error at one of the points.
    """
    if not plan.has_open_steps:
        return plan
    least = 1
    with contextlib.suppress(FileReadError):
        stored = store.read_plan()
        if stored.steps_error_m == plan.steps_error_m and stored.changes.get(STEPS_FIELD):
            least = int(stored.changes[STEPS_FIELD])
            decided = _decided(plan, least)
            if decided == stored.model_copy(update={"engine": plan.engine}):
                return decided
    plant = plant_of(plan.engine)
    steps = [least]
    for number in extreme_points(plan):
        scenario = plan.resolved(plan[number])
        if isinstance(scenario, Scenario):
            try:
                steps.append(fewest_steps(scenario, error=plan.steps_error_m, plant=plant).steps)
            except OutOfRangeError as error:
                if error.name == "error":
                    raise
            except CoopPinError:  # its run fails, too, and records why
                pass
    chosen = max(steps)
    _LOG.info("steps_per_tick %d keep %g m at %d runs", chosen, plan.steps_error_m, len(steps) - 1)
    return _decided(plan, chosen)


def _decided(plan: SweepPlan, steps: int) -> SweepPlan:
    """Return a plan with a number of steps."""
    return plan.replace(changes=plan.changes | {STEPS_FIELD: steps})


def extreme_points(plan: SweepPlan) -> list[int]:
    """Return the points of a plan with the least and largest values of each field, every case, and a sample.

    Where one dimension is at such a place, the others are in their middles, all at their least, or all at
    their largest values.
    """
    shape, generator = plan.shape, random.Random(0)
    extremes = [dimension.ends() for dimension in plan.dimensions]
    middle = [size // 2 for size in shape]
    positions = [middle, [ends[0] for ends in extremes], [ends[-1] for ends in extremes]]
    for axis, ends in enumerate(extremes):
        positions += [[*middle[:axis], end, *middle[axis + 1 :]] for end in ends]
    numbers = {int(np.ravel_multi_index(position, shape)) if shape else 0 for position in positions}
    return sorted(numbers | set(generator.sample(range(len(plan)), min(_SAMPLE, len(plan)))))


Base = str | Path | Scenario | Sequence[str | Path | Scenario] | Mapping[str, str | Path | Scenario]


def sweep(
    base: SweepPlan | Base,
    axes: Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    execution: Execution = HERE,
    retry_failed: bool = False,
    **plan: Any,
) -> SweepResult:
    """Return the results of many runs of a scenario; finished runs are stored in a folder and never repeated.

    ``sweep("adept-paper", {"controller.gains.sign_gain": [0.0, 0.1, 0.2]}, out="out/sign-gain")``. Runs are
    found by a key of what determines them: the same call resumes an interrupted sweep, a changed one computes
    what is new.

    Args:
        base: SweepPlan, or the plan's ``base``: a scenario, its name or path, or several.
        axes: values of each varied field.
        out: folder of the sweep.
        execution: workers, engine, folders to merge: ``Execution(workers=0)`` computes in this process.
        retry_failed: whether runs that failed for lack of time, of memory or of a worker are repeated.
        plan: further fields of the SweepPlan: changes, cases, zipped, sample, metrics, time_limit_s,
            memory_limit_gb, keep, engine, repeats.

    Raises:
        ScenarioError: the plan has mistakes, or the scenario of every run has.
        InfeasibleMotionError: the path of every run is out of reach.
        FieldError: no run's law fits its cell, the plan names code that has no file or that workers cannot
            import, or the scheduler's address is malformed.
        MissingExtraError: dask is not installed.
        CodeChangedError: the user's code was edited after it was loaded.
        StoreLockedError: another process works on the folder.
        FileReadError: a folder of ``merge`` is not that of a sweep.
        FileWriteError: the disk is full; every run written before is kept.
        WorkersLostError: the scheduler is gone; every finished run is kept.
        SweepInterruptedError: Ctrl-C; every finished run is kept.
    """
    require_path("out", out)
    require_type("retry_failed", retry_failed, bool)
    require_type("execution", execution, Execution)
    for field in {"workers", "scheduler", "merge", "recompute", "quiet"} & {*plan}:
        raise FieldError(f"is a field of execution; write execution=coop_pin.Execution({field}=...)", field)
    fields = plan if axes is None else {**plan, "axes": axes}
    if execution.engine is not None:
        fields = {**fields, "engine": execution.engine}
    chosen = base.replace(**fields) if isinstance(base, SweepPlan) else SweepPlan(base=base, **fields)
    require_feasible(map(chosen.resolved, chosen.points()))
    return sweep_plan(chosen, out, execution, retry_failed=retry_failed)


def sweep_plan(
    plan: SweepPlan, out: str | Path, execution: Execution, *, retry_failed: bool = False
) -> SweepResult:
    """Return the results of a plan, as ``sweep`` does, also if every run must fail."""
    with open_session(out, execution, len(plan)) as session:
        plan = with_steps(with_engine(plan, session.store), session.store)
        session.store.write_plan(plan)
        session.compute(plan, retry_failed=retry_failed)
        result = session.result(plan)
        result.write_tables()
    return result


_SAMPLE_S = 1.0
"""Time for which the ticks of a run are timed, s."""
_SAMPLE_RUNS = 16
"""Runs of a batch that is timed."""


class Estimate(NamedTuple):
    """Estimated duration of a sweep.

    Attributes:
        runs: number of runs.
        run_s: duration of one run, s.
        workers: number of runs computed at a time.
        engine: engine of the runs, and why it is this one.
    """

    runs: int
    run_s: float
    workers: int
    engine: EngineChoice

    @property
    def total_s(self) -> float:
        """Duration of the sweep, s."""
        return self.runs * self.run_s / self.workers

    def summary(self) -> str:
        """Return the estimate on one line."""
        total = datetime.timedelta(seconds=round(self.total_s))
        how = self.engine.summary()
        return f"about {total} h for {self.runs} runs of {self.run_s:.2g} s on {self.workers} workers; {how}"


@typed
def estimate(plan: SweepPlan, *, workers: int | None = None) -> Estimate:
    """Return the estimated duration of a sweep, from its first point: a second of it, or a small batch.

    Args:
        plan: the points.
        workers: number of processes, 0 for this process; one for each processor when omitted.

    Raises:
        FieldError: the number of workers is negative.
        CoopPinError: the first point cannot be run.
    """
    count, scenario = max(Execution(workers=workers).processes, 1), plan.scenario(0)
    (choice,) = choose_engines([scenario], plan.engine, [len(plan)])
    timed = _batch_run_s if choice.way == "lanes" else _single_run_s
    timed(scenario)  # the first run of a process also loads modules and compiles
    return Estimate(len(plan), timed(scenario), count, choice)


def _batch_run_s(scenario: Scenario) -> float:
    """Return the duration of a run of a batch, s, without tracing and compiling."""
    from coop_pin.sweeps.workers.batch_job import run_batch  # slow to load

    jobs = [Job("", scenario.replace(seed=seed), way="lanes") for seed in range(_SAMPLE_RUNS)]
    start = time.perf_counter()
    run_batch(jobs)
    return (time.perf_counter() - start) / _SAMPLE_RUNS


def _single_run_s(scenario: Scenario) -> float:
    """Return the duration of a run, s, from those ticks that end within a second."""
    ticks, start, stop = list[int](), time.perf_counter(), deadline(_SAMPLE_S)

    def note(tick: int, total: int) -> None:
        ticks.append(total)
        stop(tick, total)

    with contextlib.suppress(RunTimeoutError):
        run(scenario, progress=note, warn=False)
    return (time.perf_counter() - start) * ticks[0] / len(ticks)
