"""Tuned gains: every controller by the same search, seed and budget, in one table."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from coop_pin.base.arrays import typed
from coop_pin.base.errors import NameNotFoundError, NothingFeasibleError
from coop_pin.comparison.benchmark import different
from coop_pin.comparison.controllers import controllers_for, tuned_ranges
from coop_pin.comparison.measures import tuning_cost
from coop_pin.comparison.trials import benchmark_scenario, standard_trials
from coop_pin.description.scenario import Scenario
from coop_pin.feasibility import loads_without_an_arm, reachability
from coop_pin.stability.loop_stability import LEAST_DAMPING
from coop_pin.sweeps.dimensions import Span
from coop_pin.sweeps.feasibility import require_feasible_groups, require_reach
from coop_pin.sweeps.optimisation import TuneResult, tune
from coop_pin.sweeps.workers.execution import HERE, Execution

TUNED_SEED = 1000
"""Seed of the search and of its noise; trials are judged with the seeds 0, 1, 2, ..."""
TUNED_TRIALS = ("noise", "bias 1 mm", "mass x0.5")
"""Trials of the search: without a bias an anchor has no use, without an unknown load an integral has none."""
_LOSSES = ("torque of an arm lost", "commands of an arm lost")
"""One more trial: the first of these that the other arms can hold; what falls with any gains rates none."""
_COLUMNS = ("scenario", "controller", "field", "value", "low", "high", "runs", "duration_s", "seed", "cost")
_LOG = logging.getLogger("coop_pin.comparison")


class _Search(NamedTuple):
    """Search for the gains of a controller in a scenario.

    Attributes:
        name: name of the controller.
        base: the scenario with the controller.
        ranges: lowest and highest value of each gain, by dotted path.
        trials: changes of each trial.
        folder: folder of the runs, within that of all searches.
    """

    name: str
    base: Scenario
    ranges: dict[str, tuple[float, float]]
    trials: dict[str, dict[str, Any]]
    folder: Path


@typed
def tune_controllers(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    controllers: Sequence[str],
    *,
    out: str | Path,
    generations: int = 4,
    size: int = 6,
    duration: float | None = None,
    trials: Sequence[str] = (),
    least_damping: float = LEAST_DAMPING,
    execution: Execution = HERE,
) -> list[dict[str, Any]]:
    """Return the best gains of controllers for scenarios, in rows as ``gains.csv`` has them.

    Every controller has the same search, seed and budget, (generations + 1) x size points whatever the number
    of its gains, logarithmic in each, run with noise (of a seed that the comparison does not use), with a
    bias of 1 mm, with half of the mass, and with an arm that is lost, if the others can hold the payload.
    Gains whose T lambda exceeds 1 along the motion, or whose damping ratio is too small, are not taken. A
    controller of which no run finishes within these bounds has no rows.

    Args:
        scenarios: scenarios, or their names or paths.
        controllers: names of controllers; those without ranges are passed over.
        out: folder of the runs; ``gains.csv`` is written there.
        generations: number of generations after the first one.
        size: points in a generation, at least 6.
        duration: duration of every run, s; the scenarios' own when None.
        trials: names of standard trials to search in; those above when empty.
        least_damping: smallest damping ratio of the payload's modes along the motion, as ``payload_damping``
            has it; -1 bounds nothing.
        execution: workers, engine, folders to merge, as for compare.

    Raises:
        NameNotFoundError: there is no such trial.
        FieldError: no run of a controller can succeed; nothing has run then.
        InfeasibleMotionError: the path of a scenario is out of reach; nothing has run then.
        CoopPinError: whatever ``tune`` raises.
    """
    searches = [
        search
        for scenario in different(scenarios)
        for search in _searches(scenario, controllers, duration, trials)
    ]
    groups = {f"{search.folder.parent}: controllers.{search.name}": [search.base] for search in searches}
    require_feasible_groups(groups)
    rows = list[dict[str, Any]]()
    for search in searches:
        folder, ranges = search.folder, search.ranges
        merge = tuple(Path(other, folder) for other in execution.merge if Path(other, folder).is_dir())
        try:
            result = tune(
                search.base,
                {path: Span(low=low, high=high, scale="log") for path, (low, high) in ranges.items()},
                minimize="cost",
                subject_to=("t_lambda<1", f"damping>{least_damping}"),
                metrics=[tuning_cost],
                cases=search.trials,
                out=Path(out) / folder,
                generations=generations,
                population=max(1, size // len(ranges)),
                seed=TUNED_SEED,
                execution=dataclasses.replace(execution, merge=merge),
            )
        except NothingFeasibleError as error:
            _LOG.warning("%s has no tuned gains in %s: %s", search.name, search.base.name, error)
        else:
            rows += _rows(result, search)
    Path(out).mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows, columns=_COLUMNS).to_csv(Path(out) / "gains.csv", index=False, lineterminator="\n")
    return rows


def _searches(
    scenario: Scenario, controllers: Sequence[str], duration: float | None, names: Sequence[str]
) -> Iterator[_Search]:
    """Yield the search of each controller that has ranges."""
    base = benchmark_scenario(scenario, duration)
    require_reach(base)
    standard = standard_trials(base)
    for name in names:
        if name not in standard:
            raise NameNotFoundError("trial", name, standard, "the standard trials")
    trials = {name: standard[name].changes | {"seed": TUNED_SEED} for name in names or tuned_trials(base)}
    for name, law in controllers_for(scenario, controllers, tuned=False).items():
        if ranges := {f"controller.{path}": span for path, span in tuned_ranges(name).items()}:
            folder = Path(scenario.name, name)
            yield _Search(name, base.override({"controller": law}), ranges, trials, folder)


def tuned_trials(base: Scenario) -> list[str]:
    """Return the names of the trials of the search in a benchmark scenario."""
    loads = loads_without_an_arm(base, reachability(base, poses=9))
    parts = loads[list(base.cell.arms)[-1]] if loads else ()
    held = [name for name, part in zip(_LOSSES, parts, strict=False) if part <= 1.0]
    return [*TUNED_TRIALS, *held[:1]]


def _rows(result: TuneResult, search: _Search) -> list[dict[str, Any]]:
    """Return the rows of a controller: its best gains, with ranges, budget and cost."""
    scenario, runs = search.base, len(result.history.plan)
    budget = {"runs": runs, "duration_s": scenario.duration, "seed": TUNED_SEED}
    rows: list[dict[str, Any]] = []
    for path, value in result.tuned.items():
        low, high = search.ranges[path]
        field = path.removeprefix("controller.")
        row: dict[str, Any] = {"scenario": scenario.name, "controller": search.name, "field": field}
        row |= {"value": f"{value:.6g}", "low": low, "high": high} | budget
        rows.append(row | {"cost": f"{result.value:.6g}"})
    return rows
