"""Comparison of controllers: runs through the sweep store, medians with bootstrap intervals, one table."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from coop_pin.arrays import as_count, require_path, require_type
from coop_pin.batch import require_compiler, support
from coop_pin.comparison.controllers import GAINS, Controllers, controllers_for, gains_used
from coop_pin.comparison.measures import measures
from coop_pin.comparison.table import CELL, COLUMNS, Comparison, bootstrap_interval
from coop_pin.comparison.trials import Trial, benchmark_scenario, changes_of, standard_trials
from coop_pin.description.scenario import Scenario
from coop_pin.errors import FieldError, FileReadError, MissingExtraError, NameNotFoundError
from coop_pin.sweeps import SweepPlan, SweepResult, sweep
from coop_pin.sweeps.plan import Engine

_LOG = logging.getLogger("coop_pin.comparison")


class _Part(NamedTuple):
    """Runs of a scenario that are one sweep.

    Attributes:
        folder: of the sweep, within that of the comparison.
        scenario: name.
        cells: controller and trial of each case.
        gains: which of them each controller has.
        plan: of the sweep.
    """

    folder: Path
    scenario: str
    cells: list[tuple[str, str]]
    gains: Mapping[str, str]
    plan: SweepPlan


def compare(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    controllers: Controllers,
    trials: Sequence[str] | Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    seeds: int = 10,
    duration: float | None = None,
    tuned: bool = True,
    gains: str | Path = GAINS,
    engine: Literal["single", "auto"] = "single",
    merge: Sequence[str | Path] = (),
    workers: int | None = None,
    scheduler: str | None = None,
    quiet: bool = False,
) -> Comparison:
    """Return the comparison of controllers in scenarios under trials; finished runs are never repeated.

    Every scenario is run as ``benchmark_scenario`` makes it. The table is written to ``comparison.csv``
    and, to be sorted in a browser, to ``comparison.html``.

    Args:
        scenarios: scenarios, or their names or paths; ``BENCHMARK`` has those of the benchmark.
        controllers: names of ``controller_names``, or descriptions by name: "module:Class", a Controller, or
            a table of its fields.
        trials: names of ``standard_trials``, or changes by dotted path, or a Trial, by name; all standard
            trials when None.
        out: folder of the runs and the table.
        seeds: of random trials, 0, 1, 2, ...
        duration: of every run, s; the scenarios' own when None.
        tuned: whether stored gains are used.
        gains: table of stored gains, as ``tune_controllers`` writes it.
        engine: "auto" simulates together by compiled code what can be, and the rest singly.
        merge: folders of other comparisons, whose runs are taken over where they are the same.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bar.

    Raises:
        NameNotFoundError: there is no such scenario, controller or trial.
        FieldError: the engine is another, two scenarios have one name, or there is nothing to run.
        FileReadError: the table of gains cannot be read, or a folder to merge has nothing of these scenarios.
        CoopPinError: whatever ``sweep`` raises.
    """
    require_path("out", out)
    require_type("merge", merge, list, tuple)
    for other in merge:
        require_path("merge", other)
    seeds, folder = as_count("seeds", seeds, 1), Path(out)
    together, parts, cells = with_batches(engine), list[_Part](), list[tuple[str, str, str]]()
    for scenario in different(scenarios):
        chosen = controllers_for(scenario, controllers, tuned=tuned, gains=gains)
        used = gains_used(scenario, controllers, tuned=tuned, gains=gains)
        own = benchmark_scenario(scenario, duration)
        tried = _trials(own, trials)
        cells += [(own.name, name, label) for name in chosen for label in tried]
        for part in _parts(own, chosen, tried, seeds, together=together):
            parts.append(part._replace(gains=used))
    if not cells:
        raise FieldError("leave nothing to run: no controllers, or trials that no scenario has", "trials")
    taken = _merged(parts, list(map(Path, merge)))
    frames = []
    for part in parts:
        place, same = folder / part.folder, taken[part.folder]
        result = sweep(part.plan, out=place, merge=same, workers=workers, scheduler=scheduler, quiet=quiet)
        frames.append(_cells(part, result))
    comparison = Comparison.of_cells(pd.concat(frames).loc[cells])
    comparison.write_csv(folder / "comparison.csv")
    comparison.write_html(folder / "comparison.html")
    return comparison


def different(scenarios: str | Path | Scenario | Sequence[str | Path | Scenario]) -> list[Scenario]:
    """Return scenarios whose names differ."""
    given = [scenarios] if isinstance(scenarios, str | Path | Scenario) else list(scenarios)
    found = [entry if isinstance(entry, Scenario) else Scenario.load(entry) for entry in given]
    names = [scenario.name for scenario in found]
    if not names or len(set(names)) < len(names):
        raise FieldError(f"have the names {names}; give at least one, and no name twice", "scenarios")
    return found


def with_batches(engine: str) -> bool:
    """Return whether an engine simulates together those runs that can be.

    Raises:
        FieldError: it is neither "single" nor "auto".
    """
    if engine not in ("single", "auto"):
        raise FieldError(f"is {engine!r}; it must be 'single' or 'auto'", "engine")
    if engine == "auto":
        try:
            require_compiler()
        except MissingExtraError as error:
            _LOG.warning("runs are simulated one by one: %s", error)
            return False
    return engine == "auto"


def engine_of(scenario: Scenario, changes: Mapping[str, Any], *, together: bool) -> Engine:
    """Return what simulates a run. It depends on nothing but the run, and so does the run's key."""
    try:
        return "batch" if together and support(scenario.override(changes)) is None else "single"
    except Exception:  # a user's class may raise anything when it is built; the run itself reports it
        return "single"


def _parts(
    scenario: Scenario,
    controllers: Mapping[str, dict[str, Any]],
    trials: Mapping[str, Trial],
    seeds: int,
    *,
    together: bool,
) -> Iterator[_Part]:
    """Yield the sweeps of a scenario: its cases by whether they are random, and by what simulates them."""
    groups = defaultdict[tuple[bool, Engine], dict[tuple[str, str], dict[str, Any]]](dict)
    for name, controller in controllers.items():
        for label, trial in trials.items():
            changes = changes_of(scenario, trial, controller)
            groups[trial.random, engine_of(scenario, changes, together=together)][name, label] = changes
    for (random, engine), cases in sorted(groups.items()):
        plan = SweepPlan(
            base=scenario,
            cases={"run": {" | ".join(cell): changes for cell, changes in cases.items()}},
            metrics=(measures,),
            repeats=seeds if random else 1,
            engine=engine,
        )
        folder = ("random" if random else "fixed") + ("-batch" if engine == "batch" else "")
        yield _Part(Path(scenario.name, folder), scenario.name, list(cases), {}, plan)


def _merged(parts: Sequence[_Part], folders: Sequence[Path]) -> dict[Path, list[Path]]:
    """Return the folders of other comparisons that have runs of a part, by its folder."""
    found = {
        part.folder: [f / part.folder for f in folders if (f / part.folder / "runs").is_dir()]
        for part in parts
    }
    for folder in folders:
        if not any(folder / place in found[place] for place in found):
            places = ", ".join(map(str, found))
            raise FileReadError(f"has no runs to merge; there is none of {places} in it", str(folder))
    return found


def _trials(scenario: Scenario, wanted: Sequence[str] | Mapping[str, Any] | None) -> dict[str, Trial]:
    """Return the trials of a scenario by name; a standard one that does not apply to it is left out."""
    standard = standard_trials(scenario)
    if wanted is None:
        return standard
    if isinstance(wanted, Mapping):
        return {
            name: trial if isinstance(trial, Trial) else Trial(dict(trial)) for name, trial in wanted.items()
        }
    require_type("trials", wanted, list, tuple)
    known = {*standard, "friction x0", "friction x3"}
    for name in wanted:
        if name not in known:
            raise NameNotFoundError("trial", name, standard, "the standard trials")
    return {name: standard[name] for name in wanted if name in standard}


def _cells(part: _Part, result: SweepResult) -> pd.DataFrame:
    """Return the cells of a sweep, one row for each: medians, intervals and counts."""
    shape, table = (len(part.cells), -1), result.table
    finished = (table["status"] == "ok").to_numpy().reshape(shape)
    none = pd.Series(np.nan, table.index)  # where every run failed
    trusted = table.get("trustworthy", none).to_numpy(dtype=float).reshape(shape) == 1.0
    values: dict[str, Any] = {
        "gains": [part.gains[controller] for controller, _ in part.cells],
        "runs": finished.shape[1],
        "finished": finished.sum(axis=1),
        "trustworthy": (finished & trusted).sum(axis=1),
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
