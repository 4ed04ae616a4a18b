"""Gains of the comparison whose motion is damped: those of the search, one of them lowered where it swings.

The search bounds T lambda alone. Where a mode of the payload has a damping ratio below that of ``check``, the
one gain is lowered that has to change least, in logarithms, until it has not, within the range of the search;
where none does it alone, two. Reads the column ``searched`` of coop_pin/comparison/gains.csv, and writes
``value``. Two minutes of one processor.

Usage: python studies/damped_gains.py [--cells NAME ...] [--controllers NAME ...]
"""

from __future__ import annotations

import argparse
import itertools
import math

import pandas as pd

from coop_pin import Scenario
from coop_pin.base.errors import CoopPinError
from coop_pin.comparison import BENCHMARK, benchmark_scenario, controllers_for
from coop_pin.comparison.controllers import GAINS, t_lambda
from coop_pin.comparison.measures import payload_damping
from coop_pin.stability.loop_stability import LEAST_DAMPING

MARGIN = 1e-3
"""Damping ratio by which lowered gains lie above the bound, so that rounding keeps them there."""
ERROR = 0.02
"""Part of itself to which a lowered gain is found."""
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


def main() -> None:
    """Lower what swings, cell by cell, and write the table after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cells", nargs="+", default=BENCHMARK)
    parser.add_argument("--controllers", nargs="+", help="names; all when omitted")
    asked = parser.parse_args()
    table = pd.read_csv(GAINS)
    for (cell, name), rows in table.groupby(["scenario", "controller"], sort=False):
        if cell not in asked.cells or name not in (asked.controllers or [name]):
            continue
        base = benchmark_scenario(Scenario.load(str(cell)))
        law = controllers_for(base, [str(name)], tuned=False)[str(name)]
        searched = dict(zip(rows["field"], rows["searched"], strict=True))
        lows = dict(zip(rows["field"], rows["low"], strict=True))
        scenario = base.override({"controller": law})
        gains = searched if is_damped(scenario, searched) else damped(scenario, searched, lows)
        table.loc[rows.index, "value"] = [gains[field] for field in rows["field"]]
        changed = {field: f"{searched[field]:.3g} to {gains[field]:.3g}" for field in gains}
        print(cell, name, {field: text for field, text in changed.items() if gains[field] != searched[field]})
    table.to_csv(GAINS, index=False, lineterminator="\n")


if __name__ == "__main__":
    main()
