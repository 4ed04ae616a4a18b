"""Search of gains: every controller with the same search, seed and budget, into one table."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from coop_pin.comparison.benchmark import different, engine_of, with_batches
from coop_pin.comparison.controllers import controllers_for, tuned_ranges
from coop_pin.comparison.measures import tuning_cost
from coop_pin.comparison.trials import benchmark_scenario, standard_trials
from coop_pin.description.scenario import Scenario
from coop_pin.errors import NothingFeasibleError
from coop_pin.sweeps import TuneResult, tune

TUNED_SEED = 1000
"""Seed of the search and of its noise; trials are judged with the seeds 0, 1, 2, ..."""
_COLUMNS = ("scenario", "controller", "field", "value", "low", "high", "runs", "duration_s", "seed", "cost")
_LOG = logging.getLogger("coop_pin.comparison")


def tune_controllers(
    scenarios: str | Path | Scenario | Sequence[str | Path | Scenario],
    controllers: Sequence[str],
    *,
    out: str | Path,
    generations: int = 4,
    size: int = 6,
    duration: float | None = None,
    engine: Literal["single", "auto"] = "single",
    workers: int | None = None,
    quiet: bool = False,
) -> list[dict[str, Any]]:
    """Return the best gains of controllers for scenarios, in rows as ``gains.csv`` has them.

    Every controller has the same search, seed and budget, (generations + 1) x size points whatever the number
    of its gains, each run in the nominal trial and in that with noise, with a seed that the comparison does
    not use. A controller of which no run finishes has no rows.

    Args:
        scenarios: scenarios, or their names or paths.
        controllers: names; those without ranges are passed over.
        out: folder of the runs; ``gains.csv`` is written there.
        generations: number of generations after the first one.
        size: points in a generation, at least 6.
        duration: of every run, s; the scenarios' own when None.
        engine: as for compare.
        workers: as for compare.
        quiet: no progress bar.

    Raises:
        CoopPinError: whatever ``tune`` raises.
    """
    rows, together = list[dict[str, Any]](), with_batches(engine)
    for scenario in different(scenarios):
        base = benchmark_scenario(scenario, duration)
        noise = standard_trials(base)["noise"].changes | {"seed": TUNED_SEED}
        trials = {"nominal": dict[str, Any](), "noise": noise}
        for name, controller in controllers_for(scenario, controllers, tuned=False).items():
            if not (ranges := {f"controller.{path}": span for path, span in tuned_ranges(name).items()}):
                continue
            changes = {"controller": controller}
            try:
                found = tune(
                    base.override(changes),
                    ranges,
                    minimize="cost",
                    metrics=[tuning_cost],
                    cases=trials,
                    out=Path(out) / scenario.name / name,
                    generations=generations,
                    population=max(1, size // len(ranges)),
                    seed=TUNED_SEED,
                    engine=engine_of(base, changes, together=together),
                    workers=workers,
                    quiet=quiet,
                )
            except NothingFeasibleError as error:
                _LOG.warning("%s has no tuned gains in %s: %s", name, scenario.name, error)
            else:
                rows += _rows(found, base, name, ranges)
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    Path(out).mkdir(parents=True, exist_ok=True)
    (Path(out) / "gains.csv").write_text(text.getvalue(), encoding="utf-8")
    return rows


def _rows(
    found: TuneResult, scenario: Scenario, name: str, ranges: dict[str, tuple[float, float]]
) -> list[dict[str, Any]]:
    """Return the rows of a controller: its best gains, with ranges, budget and cost."""
    budget = {"runs": len(found.history.plan), "duration_s": scenario.duration, "seed": TUNED_SEED}
    rows: list[dict[str, Any]] = []
    for path, value in found.tuned.items():
        low, high = ranges[path]
        place = {"scenario": scenario.name, "controller": name, "field": path.removeprefix("controller.")}
        row = place | {"value": f"{value:.6g}", "low": low, "high": high} | budget
        rows.append(row | {"cost": f"{found.value:.6g}"})
    return rows
