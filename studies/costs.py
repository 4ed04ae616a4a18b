"""Cost of a tick by controller, for arms of 3, 6 and 7 joints: time in Python as a ratio, and operations.

Writes studies/costs.csv, the table in docs/studies/benchmark-tables.md and docs/images/study-costs.png.
The times are those of the machine that runs it. Usage: python studies/costs.py [--draw]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from pages import IMAGES, markdown, save_image, write_block

import coop_pin as cp
from coop_pin.comparison import controller_names, tick_costs
from coop_pin.figures import palette
from coop_pin.figures.style import label, styled

HERE = Path(__file__).parent
DATA = HERE / "costs.csv"
PAGE = HERE.parent / "docs" / "studies" / "benchmark-tables.md"
CELLS = {3: "adept-anchored", 6: "kinova-pair", 7: "two-pandas-box"}
"""Cells of two arms, by the joints of an arm."""
MARKS = {3: (palette.ACTUAL, "o"), 6: (palette.INTERNAL, "s"), 7: (palette.LOAD, "D")}
ROUNDS = 5


def measured() -> pd.DataFrame:
    """Return the costs of all controllers in all cells."""
    names = controller_names()
    tables = {
        joints: tick_costs(cp.Scenario.load(cell), names, rounds=ROUNDS) for joints, cell in CELLS.items()
    }
    return pd.concat(tables, names=["joints", "controller"]).reset_index()


def table(costs: pd.DataFrame) -> str:
    """Return ratios and operations by controller, as Markdown."""
    rows = []
    for name, mine in costs.groupby("controller", sort=False):
        counted = mine["operations"].notna().all()
        operations = ", ".join(f"{count:.0f}" for count in mine["operations"])
        ratios = ", ".join(f"{ratio:.2f}" for ratio in mine["ratio"])
        rows.append([f"`{name}`", ratios, operations if counted else f"not counted: {why(mine)}"])
    joints = ", ".join(map(str, CELLS))
    return markdown(["controller", f"ratio at {joints} joints", f"operations at {joints} joints"], rows)


def why(costs: pd.DataFrame) -> str:
    """Return why the operations of a controller are not counted, in short."""
    return str(costs["not_counted"].iloc[0]).rpartition(": it ")[2].replace(" (__call__),", ",")


def figure(costs: pd.DataFrame) -> Figure:
    """Return ratios and operations of all controllers, a mark for each number of joints."""
    names = list(dict.fromkeys(costs["controller"]))
    places = {name: len(names) - place for place, name in enumerate(names)}
    with styled():
        drawn = Figure(figsize=(10.0, 4.6), layout="constrained")
        panels = drawn.subplots(1, 2, sharey=True)
        for joints, mine in costs.groupby("joints"):
            colour, shape = MARKS[joints]
            height = np.array([places[name] for name in mine["controller"]])
            for panel, column in zip(panels, ("ratio", "operations"), strict=True):
                panel.plot(
                    mine[column], height, shape, color=colour, label=f"{joints} joints", markersize=5.0
                )
        panels[0].set_yticks(list(places.values()), list(places))
        panels[0].set(xscale="log", xlabel="time of a tick in Python, ratio to the printed law's")
        panels[0].axvline(1.0, color=palette.LIMIT, linewidth=0.8, linestyle=":")
        panels[1].set(xscale="log", xlabel="floating-point operations of a tick")
        for panel, ticks in zip(panels, ([0.5, 1, 2, 5, 8], [300, 500, 1000, 2000, 3000]), strict=True):
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        for name in names:
            if costs.loc[costs["controller"] == name, "operations"].isna().all():
                panels[1].text(
                    0.02,
                    places[name],
                    "not counted",
                    va="center",
                    fontsize=7.5,
                    color=palette.LIMIT,
                    transform=panels[1].get_yaxis_transform(),
                )
        label(panels[0], "time", "")
        label(panels[1], "operations of the law with its kinematics", "")
        panels[0].legend(loc="upper right")
    return drawn


def main() -> None:
    """Measure, unless only told to draw, and write the table and the figure."""
    if "--draw" not in sys.argv[1:]:
        measured().to_csv(DATA, index=False, float_format="%.6g", lineterminator="\n")
    costs = pd.read_csv(DATA)
    write_block(PAGE, "costs", table(costs))
    save_image(figure(costs), IMAGES / "study-costs")
    print(table(costs))


if __name__ == "__main__":
    main()
