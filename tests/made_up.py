"""A comparison with numbers that are made up."""

from __future__ import annotations

import numpy as np
import pandas as pd

from coop_pin.comparison import Comparison
from coop_pin.comparison.table import CELL, COLUMNS


def made_up(scenarios, controllers, trials, largest):
    """A table of values from 1 to the largest; the second scenario does not have the second trial.

    The second controller fails everywhere, and one cell in ten besides; names have up to 35 letters.
    """
    rng, sizes = np.random.default_rng(0), (scenarios, controllers, trials)
    names = [[f"{word}-{i}" for i in range(n)] for word, n in zip(CELL, sizes, strict=True)]
    names[1] = [f"{name}-{2 * i * 'x'}"[:35] for i, name in enumerate(names[1])]
    names[2][-1] = "torque of an arm lost"
    cells = pd.DataFrame(index=pd.MultiIndex.from_product(names, names=CELL)).reset_index()
    cells = cells[(cells["scenario"] != "scenario-1") | (cells["trial"] != "trial-1")]
    fails = (cells["controller"] == names[1][1]) | (rng.random(len(cells)) < 0.1)
    for name in COLUMNS:
        cells[name] = np.where(fails, np.inf, largest ** rng.random(len(cells)))
    cells["engine"] = "pinocchio"
    cells["gains"] = np.where(cells["controller"].str.len() > 30, "untuned", "tuned")
    cells["information"] = cells["controller"].map(lambda name: "model" if name[-1] == "x" else "blind")
    cells = cells.assign(runs=1, finished=1 - fails, dropped=0, merged=0, failure="")
    for verdict in ("sound", "kept"):
        cells[verdict] = cells["finished"] * (rng.random(len(cells)) < 0.8)
    return Comparison.of_cells(cells.set_index(list(CELL)))
