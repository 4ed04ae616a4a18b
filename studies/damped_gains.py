"""Gains of the comparison whose motion is damped: those of the search, one of them lowered where it swings.

The search bounds T lambda alone. Where a mode of the payload has a damping ratio below that of ``check``, the
one gain is lowered that has to change least, in logarithms, until it has not, within the range of the search;
where none does it alone, two. Gains of the search with that bound are within it, and stay. Reads ``searched``
of coop_pin/comparison/gains.csv, writes ``value``, and measures what it costs in the trials of the search:
studies/damped_gains.csv and a table of docs/studies/benchmark.md. Some minutes of one processor.

With --controllers, only those are lowered and measured, and the other rows stay.

Usage: python studies/damped_gains.py [--cells NAME ...] [--controllers NAME ...] [--page]
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pages import markdown, write_block

from coop_pin import Execution, Scenario, SweepPlan, sweep
from coop_pin.base.errors import CoopPinError
from coop_pin.comparison import (
    BENCHMARK,
    benchmark_scenario,
    controller_names,
    controllers_for,
    standard_trials,
)
from coop_pin.comparison.controllers import GAINS, t_lambda
from coop_pin.comparison.measures import payload_damping, tuning_cost
from coop_pin.comparison.tuned_gains import TUNED_SEED, TUNED_TRIALS
from coop_pin.stability.loop_stability import LEAST_DAMPING

HERE = Path(__file__).parent
DATA = HERE / "damped_gains.csv"
PAGE = HERE.parent / "docs" / "studies" / "benchmark.md"

MARGIN = 1e-3
"""Damping ratio by which lowered gains lie above the bound, so that rounding keeps them there."""
ERROR = 0.02
"""Part of itself to which a lowered gain is found."""
KEPT = ("prescribed-performance",)
"""Controllers that keep what was searched: damped about its floors, this law is off by 15 mm and more."""
STEPS = 8
"""Steps through the range of the first of two gains that are lowered together."""


def is_damped(scenario: Scenario, gains: dict[str, float]) -> bool:
    """Return whether a scenario's law with these gains is within the bounds of damping and T lambda."""
    try:
        changed = scenario.override({f"controller.{field}": value for field, value in gains.items()})
    except CoopPinError:
        return False
    return payload_damping(changed) >= LEAST_DAMPING + MARGIN and t_lambda(changed) <= 1.0


def lowered(
    scenario: Scenario, gains: dict[str, float], field: str, low: float, most: float
) -> dict[str, float]:
    """Return gains with one lowered as little as the bounds ask for, or none if that is not enough.

    Args:
        scenario: a benchmark scenario with the law.
        gains: gains by field.
        field: the one that is lowered.
        low: its least value.
        most: largest change of its logarithm that is looked at.
    """
    high = math.log(gains[field])
    least = max(math.log(low), high - most)
    if not is_damped(scenario, gains | {field: math.exp(least)}):
        return {}
    while high - least > ERROR:
        middle = (least + high) / 2.0
        if is_damped(scenario, gains | {field: math.exp(middle)}):
            least = middle
        else:
            high = middle
    return gains | {field: float(f"{math.exp(least):.3g}")}


def damped(scenario: Scenario, gains: dict[str, float], lows: dict[str, float]) -> dict[str, float]:
    """Return gains of the least change that are within the bounds: one of them lowered, or else two.

    Args:
        scenario: a benchmark scenario with the law.
        gains: the gains of the search by field.
        lows: the least value of each.
    """

    def change(found: dict[str, float]) -> float:
        return sum(math.log(gains[field] / found[field]) for field in gains) if found else math.inf

    best = dict[str, float]()
    for field in gains:
        best = min(best, lowered(scenario, gains, field, lows[field], change(best)), key=change)
    if best:
        return best
    for first, second in itertools.permutations(gains, 2):
        for part in range(1, STEPS):
            start = gains | {first: gains[first] * (lows[first] / gains[first]) ** (part / STEPS)}
            if (room := change(best) - change(start)) > 0.0:
                best = min(best, lowered(scenario, start, second, lows[second], room), key=change)
    return {field: float(f"{value:.3g}") for field, value in best.items()} or gains


def lower(table: pd.DataFrame, cells: Sequence[str], controllers: Sequence[str]) -> None:
    """Lower what swings in some cells and laws, and write the table after each controller."""
    for (cell, name), rows in table.groupby(["scenario", "controller"], sort=False):
        if cell not in cells or name not in controllers or name in KEPT:
            continue
        scenario = with_law(str(cell), str(name))
        searched = dict(zip(rows["field"], rows["searched"], strict=True))
        lows = dict(zip(rows["field"], rows["low"], strict=True))
        gains = searched if is_damped(scenario, searched) else damped(scenario, searched, lows)
        table.loc[rows.index, "value"] = [gains[field] for field in rows["field"]]
        table.to_csv(GAINS, index=False, lineterminator="\n")
        print(cell, name, {field: value for field, value in gains.items() if value != searched[field]})


def with_law(cell: str, name: str, duration: float | None = None) -> Scenario:
    """Return a scenario of the benchmark with a controller by the middle of its gains."""
    loaded = Scenario.load(cell)
    law = controllers_for(loaded, [name], tuned=False)[name]
    return benchmark_scenario(loaded, duration).override({"controller": law})


def measured(table: pd.DataFrame, out: Path) -> pd.DataFrame:
    """Return the controllers whose gains were lowered, with damping ratio and cost before and after.

    Args:
        table: the table of gains.
        out: folder of the runs.
    """
    found = []
    for (cell, name), rows in table.groupby(["scenario", "controller"], sort=False):
        changed = rows[rows["value"] != rows["searched"]]
        if changed.empty:
            continue
        scenario = with_law(str(cell), str(name), float(rows["duration_s"].iloc[0]))
        standard = standard_trials(scenario)
        cases = {trial: standard[trial].changes | {"seed": TUNED_SEED} for trial in TUNED_TRIALS}
        row: dict[str, Any] = {"scenario": cell, "controller": name}
        row["lowered"] = "; ".join(
            f"{field.removeprefix('gains.')} {before:.3g} to {after:.3g}"
            for field, before, after in changed[["field", "searched", "value"]].itertuples(index=False)
        )
        for column, word in (("searched", "before"), ("value", "after")):
            gains = {f"controller.{field}": x for field, x in zip(rows["field"], rows[column], strict=True)}
            plan = SweepPlan(base=scenario, changes=gains, cases={"trial": cases}, metrics=(tuning_cost,))
            folder = out / f"{cell}-{name}-{word}"
            runs = sweep(plan, out=folder, execution=Execution(workers=0, quiet=True))
            costs = runs.values("cost").values.ravel() if runs.metric_names else np.array([math.nan])
            row |= {f"damping_{word}": payload_damping(with_law(str(cell), str(name)).override(gains))}
            row |= {f"cost_{word}": float(costs.mean())}
        print(row, flush=True)
        found.append(row)
    return pd.DataFrame(found)


def page_table(rows: pd.DataFrame) -> str:
    """Return what was lowered and what it costs, as Markdown."""
    lines = [
        (
            f"`{row['scenario']}`",
            f"`{row['controller']}`",
            row["lowered"].replace("_", " "),
            *(
                f"{written(row[f'{name}_before'])} → {written(row[f'{name}_after'])}"
                for name in ("damping", "cost")
            ),
        )
        for _, row in rows.iterrows()
    ]
    return markdown(("cell", "controller", "gain", "damping ratio", "cost of the search, mm + N"), lines)


def written(value: float) -> str:
    """Return a number with two digits."""
    return f"{float(f'{value:.2g}'):g}" if math.isfinite(value) else "fails"


def main() -> None:
    """Lower what swings, measure what that costs, and write table and page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", nargs="*", default=BENCHMARK, help="in which gains are lowered anew")
    parser.add_argument("--controllers", nargs="*", default=controller_names(), help="all when omitted")
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "damped_gains")
    parser.add_argument("--page", action="store_true", help="only write the page, from the stored tables")
    asked = parser.parse_args()
    if not asked.page:
        table = pd.read_csv(GAINS)
        lower(table, asked.cells, asked.controllers)
        order, kept = table["scenario"].drop_duplicates(), pd.read_csv(DATA)
        new = measured(table[table["controller"].isin(asked.controllers)], asked.out)
        rows = pd.concat([kept[~kept["controller"].isin(asked.controllers)], new])
        rows = rows.set_index("scenario").loc[order[order.isin(rows["scenario"])]].reset_index()
        rows.to_csv(DATA, index=False, float_format="%.4g", lineterminator="\n")
    write_block(PAGE, "damped", page_table(pd.read_csv(DATA)))


if __name__ == "__main__":
    main()
