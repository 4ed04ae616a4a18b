"""Comparison of controllers: runs through the sweep store, medians with bootstrap intervals, one table."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from coop_pin.base.arrays import as_count, require_known, require_path, require_type, typed
from coop_pin.base.errors import CoopPinError, FieldError, FileReadError, ScenarioError
from coop_pin.base.schema.user_code import code_of
from coop_pin.base.source_code import code_digests
from coop_pin.comparison.controllers import GAINS, Controllers, controllers_for, gains_used
from coop_pin.comparison.measures import DROPPED, measures
from coop_pin.comparison.table import CELL, COLUMNS, Comparison, bootstrap_interval
from coop_pin.comparison.trials import Trial, benchmark_scenario, changes_of, standard_trials
from coop_pin.compiled.engine_choice import EngineChoice, choose_engines
from coop_pin.compiled.engines import Engine
from coop_pin.description.scenario import Scenario
from coop_pin.results.metrics import SIMULATION_SOUND, TASK_KEPT
from coop_pin.stability.step_size import with_changes
from coop_pin.sweeps.engine import sweep_plan
from coop_pin.sweeps.feasibility import require_feasible_groups, require_reach
from coop_pin.sweeps.plan import SweepPlan
from coop_pin.sweeps.result import SweepResult
from coop_pin.sweeps.run_key import require_unchanged
from coop_pin.sweeps.workers.execution import HERE, Execution


class _Part(NamedTuple):
    """Runs of a scenario that are one sweep.

    Attributes:
        folder: folder of the sweep, within that of the comparison.
        scenario: name of the scenario.
        cells: controller and trial of each case.
        labels: class of information and origin of the gains of each controller.
        plan: plan of the sweep.
    """

    folder: Path
    scenario: str
    cells: list[tuple[str, str]]
    labels: Mapping[str, dict[str, str]]
    plan: SweepPlan


_Points = Mapping[tuple[str, str, str], Scenario | ScenarioError]
"""Scenario of the first run of each cell, by the cell's names."""


@typed
def compare(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    controllers: Controllers,
    trials: Sequence[str] | Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    changes: Mapping[str, Any] | None = None,
    seeds: int = 10,
    duration: float | None = None,
    tuned: bool = True,
    gains: str | Path = GAINS,
    execution: Execution = HERE,
    retry_failed: bool = False,
) -> Comparison:
    """Return the comparison of controllers in scenarios under trials; finished runs are never repeated.

    Every scenario is run as ``benchmark_scenario`` makes it. The table is written to ``comparison.csv``
    and, to be explored in a browser, to ``comparison.html``.

    Args:
        scenarios: scenarios, or their names or paths; ``BENCHMARK`` has those of the benchmark.
        controllers: names of ``controller_names``, or descriptions by name: "module:Class", a Controller, or
            a table of its fields.
        trials: names of ``standard_trials``, or changes by dotted path, or a Trial, by name; all standard
            trials when None.
        out: folder of the runs and the table.
        changes: fields changed in every run, by dotted path, as in a SweepPlan.
        seeds: number of seeds of random trials, 0, 1, 2, ...
        duration: duration of every run, s; the scenarios' own when None.
        tuned: whether stored gains are used.
        gains: table of stored gains, as ``tune_controllers`` writes it.
        execution: workers, folders of other comparisons to merge, engine: "auto" simulates together by
            compiled code what can be and is worth compiling, and the rest on Pinocchio; what a folder has of
            these runs, it keeps.
        retry_failed: whether runs that failed for lack of time, of memory or of a worker are repeated.

    Raises:
        NameNotFoundError: there is no such scenario, controller or trial.
        FieldError: the engine is "compiled" and only Pinocchio has a cell or an event, two scenarios have one
            name, there is nothing to run, or a controller or a trial leads to failed runs only (a law that
            the cell cannot have, for example); its cause is the first run's error.
        InfeasibleMotionError: the path of a scenario is out of reach.
        CodeChangedError: the user's code was edited after this process loaded it.
        FileReadError: the table of gains cannot be read, or a folder to merge has nothing of these scenarios.
        CoopPinError: whatever ``sweep`` raises.
    """
    require_path("out", out)
    seeds, folder = as_count("seeds", seeds, 1), Path(out)
    parts, cells = list[_Part](), list[tuple[str, str, str]]()
    for scenario in (with_changes(entry, changes or {}) for entry in different(scenarios)):
        base = benchmark_scenario(scenario, duration)
        require_reach(base)  # gains of the cell are those along its path
        laws = controllers_for(scenario, controllers, tuned=tuned, gains=gains)
        used = gains_used(scenario, controllers, tuned=tuned, gains=gains)
        labels = {
            name: {"information": _information(base, law), "gains": used[name]} for name, law in laws.items()
        }
        tried = _trials(base, trials)
        cells += [(base.name, name, label) for name in laws for label in tried]
        parts += _parts(base, laws, tried, seeds, labels)
    if not cells:
        raise FieldError("leave nothing to run: no controllers, or trials that no scenario has", "trials")
    points = _points(parts)
    for name in {name for each in points.values() if isinstance(each, Scenario) for name in code_of(each)}:
        require_unchanged(((name, code_digests(name)),))  # laws are asked here, too, and not by workers alone
    _require_feasible(points)
    parts = _by_engine(parts, points, execution, folder)
    merged, frames = _merged(parts, list(map(Path, execution.merge))), []
    for part in parts:
        chosen = dataclasses.replace(execution, engine=None, merge=merged[part.folder])
        runs = sweep_plan(part.plan, folder / part.folder, chosen, retry_failed=retry_failed)
        frames.append(_cells(part, runs))
    comparison = Comparison.of_cells(pd.concat(frames).loc[cells], folder)
    comparison.write_csv(folder / "comparison.csv")
    comparison.write_html(folder / "comparison.html")
    return comparison


def different(scenarios: str | Path | Scenario | Sequence[str | Path | Scenario]) -> list[Scenario]:
    """Return scenarios whose names differ."""
    entries = [scenarios] if isinstance(scenarios, str | Path | Scenario) else list(scenarios)
    loaded = [entry if isinstance(entry, Scenario) else Scenario.load(entry) for entry in entries]
    names = [scenario.name for scenario in loaded]
    if not names or len(set(names)) < len(names):
        raise FieldError(f"have the names {names}; give at least one, and no name twice", "scenarios")
    return loaded


def _parts(
    scenario: Scenario,
    laws: Mapping[str, dict[str, Any]],
    trials: Mapping[str, Trial],
    seeds: int,
    labels: Mapping[str, dict[str, str]],
) -> Iterator[_Part]:
    """Yield the sweeps of a scenario: its cases by whether they are random."""
    for is_random, name in ((False, "fixed"), (True, "random")):
        cases = {
            (law, label): changes_of(scenario, trial, laws[law])
            for law in laws
            for label, trial in trials.items()
            if trial.random == is_random
        }
        if cases:
            plan = SweepPlan(
                base=scenario,
                cases={"run": {" | ".join(cell): changes for cell, changes in cases.items()}},
                metrics=(measures,),
                repeats=seeds if is_random else 1,
            )
            yield _Part(Path(scenario.name, name), scenario.name, list(cases), labels, plan)


_INFORMATION: Mapping[str, set[str]] = {
    "internal wrench": {"internal wrench", "wrenches of all arms"},
    "own wrench": {"own wrench"},
    "exchanged poses": {"poses of all arms"},
    "agreed start": {"holding torque", "start pose"},
}
"""Classes of what laws measure, the largest first, and the needs that make a law one of them."""


def _information(scenario: Scenario, law: dict[str, Any]) -> str:
    """Return what a law has besides its own arm's joints: "model" with the first of _INFORMATION, or "blind".

    It is "" where the scenario refuses the law, and its runs fail.
    """
    try:
        needs = {*scenario.override({"controller": law}).controller.needs}
    except CoopPinError:
        return ""
    model = ["model"] if needs & {"model", "regressor"} else []
    measured = [name for name, of in _INFORMATION.items() if needs & of][:1]
    return ", ".join(model + measured) or "blind"


def _points(parts: Sequence[_Part]) -> _Points:
    """Return the scenario of the first run of each cell, or the mistakes in it."""
    sizes = [(part, len(part.plan) // len(part.cells)) for part in parts]
    return {
        (part.scenario, *cell): part.plan.resolved(part.plan[n * runs])
        for part, runs in sizes
        for n, cell in enumerate(part.cells)
    }


def _require_feasible(points: _Points) -> None:
    """Refuse a controller or a trial that leads to failed runs only, in one of the scenarios."""
    groups = defaultdict[str, list[Scenario | ScenarioError]](list)
    for (scenario, controller, trial), point in points.items():
        groups[f"{scenario}: controllers.{controller}"].append(point)
        groups[f"{scenario}: trials.{trial}"].append(point)
    require_feasible_groups(groups)


def _by_engine(parts: Sequence[_Part], points: _Points, execution: Execution, out: Path) -> list[_Part]:
    """Return sweeps that are computed in one way each: the cases of each way apart from the others."""
    divided = list[_Part]()
    for part in parts:
        repeats = len(part.plan) // len(part.cells)
        folders = {way: part.folder.with_name(f"{part.folder.name}-{way}") for way in ("lanes", "plant")}
        began_singly = (out / part.folder).is_dir() and not (out / folders["lanes"]).is_dir()
        engine: Engine = execution.engine or ("pinocchio" if began_singly else "auto")
        cases = [points[part.scenario, *cell] for cell in part.cells]
        choices = choose_engines(cases, engine, [repeats] * len(cases))
        way_of = {cell: each.require(engine).way for cell, each in zip(part.cells, choices, strict=True)}
        for way in sorted(set(way_of.values())):
            cells = [cell for cell in part.cells if way_of[cell] == way]
            plan = part.plan.part(list(map(" | ".join, cells)), EngineChoice(way).engine)
            divided.append(part._replace(folder=folders.get(way, part.folder), cells=cells, plan=plan))
    return divided


def _merged(parts: Sequence[_Part], folders: Sequence[Path]) -> dict[Path, tuple[Path, ...]]:
    """Return the folders of other comparisons that have runs of a part, by its folder."""
    merged = {
        part.folder: tuple(f / part.folder for f in folders if (f / part.folder / "runs").is_dir())
        for part in parts
    }
    for folder in folders:
        if not any(folder / part in merged[part] for part in merged):
            names = ", ".join(map(str, merged))
            raise FileReadError(f"has no runs to merge; there is none of {names} in it", str(folder))
    return merged


def _trials(scenario: Scenario, trials: Sequence[str] | Mapping[str, Any] | None) -> dict[str, Trial]:
    """Return the trials of a scenario by name; a standard one that does not apply to it is left out."""
    standard = standard_trials(scenario)
    if trials is None:
        return standard
    if isinstance(trials, Mapping):
        for name, trial in trials.items():
            require_type("name of a trial", name, str)
            require_type(f"trials[{name!r}]", trial, Trial, Mapping)
        return {
            name: trial if isinstance(trial, Trial) else Trial(dict(trial)) for name, trial in trials.items()
        }
    require_type("trials", trials, list, tuple)
    known = [*standard, "friction x0", "friction x3", "held by palms"]
    for name in trials:
        require_known("trial", name, known, "the standard trials")
    return {name: standard[name] for name in trials if name in standard}


def _cells(part: _Part, result: SweepResult) -> pd.DataFrame:
    """Return the cells of a sweep, one row for each: medians, intervals and counts."""
    shape, table = (len(part.cells), -1), result.table
    finished = (table["status"] == "ok").to_numpy().reshape(shape)
    none = pd.Series(np.nan, table.index)  # where every run failed
    sound, kept = (
        finished & (table.get(name, none).to_numpy(dtype=float).reshape(shape) == 1.0)
        for name in (SIMULATION_SOUND, TASK_KEPT)
    )
    values: dict[str, Any] = {
        **pd.DataFrame([part.labels[controller] for controller, _ in part.cells]).to_dict("list"),
        "engine": part.plan.engine,
        "runs": finished.shape[1],
        "finished": finished.sum(axis=1),
        "sound": sound.sum(axis=1),
        "kept": kept.sum(axis=1),
        DROPPED: (table.get(DROPPED, none).to_numpy(dtype=float).reshape(shape) == 1.0).sum(axis=1),
        "merged": (table["merged"].to_numpy() == 1.0).reshape(shape).sum(axis=1),
    }
    for name in COLUMNS:
        column = table.get(name, none).to_numpy(dtype=float).reshape(shape)
        runs = np.where(finished & np.isfinite(column), column, np.inf)
        low, high = bootstrap_interval(runs.T, np.median, 0)
        values |= {name: np.median(runs, axis=1), f"{name}_low": low, f"{name}_high": high}
    reasons = table["failure"].str.cat(table["message"], ": ").where(table["status"] == "failed", "")
    values["failure"] = [next(filter(None, row), "") for row in reasons.to_numpy().reshape(shape)]
    index = pd.MultiIndex.from_tuples([(part.scenario, *cell) for cell in part.cells], names=CELL)
    return pd.DataFrame(values, index)
