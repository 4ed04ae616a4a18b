"""Comparison of controllers: runs through the sweep store, medians with bootstrap intervals, one table."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from coop_pin.arrays import as_count, require_path, require_type
from coop_pin.comparison.controllers import Controllers, controllers_for, tuned_ranges
from coop_pin.comparison.measures import measures, tuning_cost
from coop_pin.comparison.table import COLUMNS, Comparison, bootstrap_interval
from coop_pin.comparison.trials import Trial, benchmark_scenario, changes_of, standard_trials
from coop_pin.description.scenario import Scenario
from coop_pin.errors import NameNotFoundError
from coop_pin.sweeps import SweepPlan, SweepResult, sweep, tune

TUNED_SEED = 1000
"""Seed of the search and of its noise; trials are judged with the seeds 0, 1, 2, ..."""


def compare(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    controllers: Controllers,
    trials: Sequence[str] | Mapping[str, Any] | None = None,
    *,
    out: str | Path,
    seeds: int = 10,
    duration: float | None = None,
    tuned: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
    quiet: bool = False,
) -> Comparison:
    """Return the comparison of controllers in scenarios under trials; finished runs are never repeated.

    Every scenario is run as ``benchmark_scenario`` makes it. The table is written to ``comparison.csv``
    and, to be sorted in a browser, to ``comparison.html``.

    Args:
        scenarios: scenarios, or their names or paths.
        controllers: names of ``controller_names``, or descriptions by name: "module:Class", a Controller, or
            a table of its fields.
        trials: names of ``standard_trials``, or changes by dotted path, or a Trial, by name; all standard
            trials when None.
        out: folder of the runs and the table.
        seeds: of random trials, 0, 1, 2, ...
        duration: of every run, s; the scenarios' own when None.
        tuned: whether stored gains are used.
        workers: number of processes; one for each processor when omitted, 0 for this process.
        scheduler: address of a dask scheduler to use instead.
        quiet: no progress bar.

    Raises:
        NameNotFoundError: there is no such scenario, controller or trial.
        CoopPinError: whatever ``sweep`` raises.
    """
    require_path("out", out)
    seeds, folder = as_count("seeds", seeds, 1), Path(out)
    given = [scenarios] if isinstance(scenarios, str | Path | Scenario) else list(scenarios)
    parts = []
    for entry in given:
        loaded = entry if isinstance(entry, Scenario) else Scenario.load(entry)
        chosen = controllers_for(loaded, controllers, tuned=tuned)
        scenario = benchmark_scenario(loaded, duration)
        for random in (False, True):
            wanted = {
                name: trial for name, trial in _trials(scenario, trials).items() if trial.random == random
            }
            if not wanted:
                continue
            cases = {
                f"{name} | {label}": changes_of(scenario, trial, controller)
                for name, controller in chosen.items()
                for label, trial in wanted.items()
            }
            plan = SweepPlan(
                base=scenario, cases={"run": cases}, metrics=(measures,), repeats=seeds if random else 1
            )
            place = folder / scenario.name / ("random" if random else "fixed")
            result = sweep(plan, out=place, workers=workers, scheduler=scheduler, quiet=quiet)
            parts.append(_part(result, scenario.name, list(chosen), list(wanted)))
    merged = xr.merge(parts, join="outer", compat="no_conflicts")
    order = {
        dim: list(dict.fromkeys(np.concatenate([part[dim].values for part in parts]))) for dim in merged.dims
    }
    comparison = Comparison(merged.reindex(order))
    comparison.write_csv(folder / "comparison.csv")
    comparison.write_html(folder / "comparison.html")
    return comparison


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


def _part(result: SweepResult, scenario: str, controllers: list[str], trials: list[str]) -> xr.Dataset:
    """Return the cells of one sweep: medians, intervals and counts."""
    shape = len(controllers), len(trials), -1
    table = result.table
    finished = (table["status"] == "ok").to_numpy().reshape(shape)
    none = pd.Series(np.nan, table.index)  # where every run failed
    trusted = table.get("trustworthy", none).to_numpy(dtype=float).reshape(shape) == 1.0
    counts = {"runs": np.full(shape[:2], finished.shape[2]), "finished": finished.sum(axis=2)}
    counts["trustworthy"] = (finished & trusted).sum(axis=2)
    values = {name: (("scenario", "controller", "trial"), count[None]) for name, count in counts.items()}
    for name in COLUMNS:
        column = table.get(name, none).to_numpy(dtype=float).reshape(shape)
        runs = np.where(finished & np.isfinite(column), column, np.inf)
        low, high = bootstrap_interval(np.moveaxis(runs, 2, 0), np.median, 0)
        for label, value in ((name, np.median(runs, axis=2)), (f"{name}_low", low), (f"{name}_high", high)):
            values[label] = ("scenario", "controller", "trial"), value[None]
    return xr.Dataset(values, {"scenario": [scenario], "controller": controllers, "trial": trials})


def tune_controllers(
    scenario: str | Path | Scenario,
    controllers: Sequence[str],
    *,
    out: str | Path,
    generations: int = 4,
    size: int = 6,
    duration: float | None = None,
    workers: int | None = None,
    quiet: bool = False,
) -> list[dict[str, Any]]:
    """Return the best gains of controllers for a scenario, in rows as ``gains.csv`` has them.

    Every controller has the same search, seed and budget, (generations + 1) x size points whatever the number
    of its gains, each run with and without the noise trial: with seeds that the comparison does not use.

    Args:
        scenario: the scenario, its name or path.
        controllers: names; those without ranges are passed over.
        out: folder of the runs; ``gains.csv`` is written there.
        generations: number of generations after the first one.
        size: points in a generation, at least 6.
        duration: of every run, s.
        workers: as for compare.
        quiet: no progress bar.

    Raises:
        NothingFeasibleError: every run of a controller failed.
        CoopPinError: whatever ``tune`` raises.
    """
    loaded = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    base, rows = benchmark_scenario(loaded, duration), []
    noise = standard_trials(base)["noise"].changes | {"seed": TUNED_SEED}
    for name, controller in controllers_for(loaded, controllers, tuned=False).items():
        ranges = {f"controller.{path}": span for path, span in tuned_ranges(name).items()}
        if not ranges:
            continue
        found = tune(
            base.override({"controller": controller} | noise),
            ranges,
            minimize="cost",
            metrics=[tuning_cost],
            out=Path(out) / loaded.name / name,
            generations=generations,
            population=max(1, size // len(ranges)),
            seed=TUNED_SEED,
            workers=workers,
            quiet=quiet,
        )
        for path, (low, high) in ranges.items():
            value, cost = found.best.parameters[path], found.best.metrics["cost"]
            budget = {"runs": len(found.history.plan), "seed": TUNED_SEED, "cost": f"{cost:.6g}"}
            place = {"scenario": loaded.name, "controller": name, "field": path.removeprefix("controller.")}
            rows.append(place | {"value": f"{value:.6g}", "low": low, "high": high} | budget)
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (Path(out) / "gains.csv").write_text(text.getvalue(), encoding="utf-8")
    return rows
