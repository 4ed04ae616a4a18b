"""Benchmark of all controllers, from stored gains, in the cells that have them.

Runs what is missing in out/studies/benchmark, and writes studies/benchmark.csv, what was run into
docs/concepts/benchmark.md and docs/studies/benchmark.md, and docs/images/benchmark-CELL.png. With --page,
only the text, from the CSV.

With --controllers, only those are run, and the other rows of the CSV stay.

Usage: python studies/benchmark.py [--duration SECONDS] [--seeds N] [--trials NAME ...]
    [--controllers NAME ...] [--cells NAME ...] [--workers N] [--page]
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr
from pages import IMAGES, markdown, save_image, write_block

from coop_pin import Execution, Scenario, compare
from coop_pin.comparison import BENCHMARK, Comparison, controller_names, controllers_for, standard_trials
from coop_pin.comparison.controllers import GAINS, stored_gains, t_lambda
from coop_pin.comparison.measures import payload_damping
from coop_pin.comparison.trials import benchmark_scenario
from coop_pin.figures import comparison_figure
from coop_pin.stability.loop_stability import LEAST_DAMPING

HERE = Path(__file__).parent
DATA = HERE / "benchmark.csv"
PAGE = HERE.parent / "docs" / "concepts" / "benchmark.md"
TABLES = HERE.parent / "docs" / "studies" / "benchmark.md"
FORCES = ("nominal", "noise", "bias 0.1 mm", "bias 1 mm", "base turned by 1 mrad", "wrist lost at half time")
TRACKING = ("nominal", "bias 1 mm", "mass x0.5", "mass x2", "push", "torque of an arm lost")
NEAR = 0.05
"""Gains closer to an end of their range than this part of it, in logarithms as searched, are counted."""


def tuned_cells() -> list[str]:
    """Return the cells of the benchmark in which every controller has stored gains."""
    names = set(controller_names())
    return [cell for cell in BENCHMARK if names <= set(stored_gains(cell))]


def text(found: Comparison, duration: float | None) -> str:
    """Return what was run, which cells are still to be tuned, and the ranks over all of it, as Markdown."""
    sizes = found.data.sizes
    names = ("runs", "finished", "sound", "kept")
    runs, finished, sound, kept = (int(found.table[name].sum()) for name in names)
    verdicts = f", {sound} sound, {kept} keep their task" * bool(found.table["kept"].notna().all())
    length = "of the scenario's own length" if duration is None else f"of {duration:g} s"
    cells = ", ".join(f"`{name}`" for name in found.data["scenario"].values)
    others = ", ".join(f"`{name}`" for name in BENCHMARK if name not in found.data["scenario"].values)
    missing = f" Not tuned yet, and so not run: {others}." if others else ""
    tuned = list(map(str, found.data["scenario"].values))
    return (
        f"{sizes['controller']} controllers, {sizes['trial']} trials, {cells}: {runs} runs {length},"
        f" {finished} finished{verdicts}.{missing}"
        "\n\nMean rank of each controller over all cells and trials, 1 is the best, with an interval from"
        " 95 % of resamplings of the places (cell and trial), which are chosen by hand:\n\n"
        f"{ranks(found)}\n\n{at_ends(tuned)}"
    )


def tables(found: Comparison) -> str:
    """Return internal force, tracking error and T lambda of all controllers, as Markdown."""
    tuned, names = (list(map(str, found.data[name].values)) for name in ("scenario", "controller"))
    return (
        "Internal force, axial and shear together, N, from the cell where it is least to that where it is"
        f" largest:\n\n{spans(found, force(found), FORCES)}\n\n"
        "Tracking error in the same way, mm:\n\n"
        f"{spans(found, found.data['tracking_rms_mm'], TRACKING)}\n\n"
        "$T\\lambda$ of every controller with these gains, the largest of nine poses along the motion"
        f" (sampled damping holds below 2):\n\n{stability(names, tuned, t_lambda)}\n\n"
        "Smallest damping ratio of a mode of the payload with all gains, at six poses along the motion and"
        f" without friction (`coop-pin check` asks for {LEAST_DAMPING}; sgn counts as no integral):"
        f"\n\n{stability(names, tuned, payload_damping)}"
    )


def write(found: Comparison, duration: float | None) -> None:
    """Write the text of the page and the tables of the study."""
    write_block(PAGE, "benchmark", text(found, duration))
    write_block(TABLES, "tables", tables(found))
    write_block(TABLES, "printed", printed(list(map(str, found.data["scenario"].values))))


def printed(cells: list[str]) -> str:
    """Return the gains of the printed law in each cell, tuned and used, as Markdown."""
    rows = []
    for cell in cells:
        gains = stored_gains(cell)["printed"]
        rows.append((f"`{cell}`", *(f"{gains[f'gains.{name}']:.3g}" for name in ("pose_gain", "sign_gain"))))
    return markdown(("cell", "$\\gamma$", "$\\alpha$"), rows)


def at_ends(cells: list[str]) -> str:
    """Return how many tuned gains lie near an end of the range that was searched."""
    with GAINS.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["scenario"] in cells]
    places = [place(*(float(row[name]) for name in ("value", "low", "high"))) for row in rows]
    near = sum(min(each, 1.0 - each) < NEAR for each in places)
    return f"{near} of {len(rows)} tuned gains lie within {NEAR:.0%} of an end of their range."


def place(value: float, low: float, high: float) -> float:
    """Return where a gain lies in its range, 0 to 1, in logarithms."""
    return math.log(value / low) / math.log(high / low)


def stability(names: list[str], cells: list[str], of: Callable[[Scenario], float]) -> str:
    """Return a measure of the stability of controllers with their tuned gains in cells, as a table."""
    columns = []
    for cell in cells:
        scenario = benchmark_scenario(Scenario.load(cell))
        laws = controllers_for(scenario, names)
        columns.append([f"{of(scenario.override({'controller': laws[name]})):.2f}" for name in names])
    rows = zip((f"`{name}`" for name in names), *columns, strict=True)
    return markdown(("controller", *(f"`{cell}`" for cell in cells)), list(rows))


def force(found: Comparison) -> xr.DataArray:
    """Return the error of the internal force, axial and shear together, N."""
    return (found.data["axial_rms_N"] ** 2 + found.data["shear_rms_N"] ** 2) ** 0.5


def spans(found: Comparison, measure: xr.DataArray, trials: Sequence[str]) -> str:
    """Return the least and the largest of all cells for each controller and some trials, as a table."""
    ran = measure.where(found.data["runs"].notnull())
    ends = [getattr(ran.sel(trial=list(trials)), end)("scenario").T for end in ("min", "max")]
    rows = [
        (f"`{name}`", *(f"{rounded(low)} to {rounded(high)}" for low, high in zip(*values, strict=True)))
        for name, *values in zip(
            found.data["controller"].values, *(end.values.T for end in ends), strict=True
        )
    ]
    return markdown(("controller", *trials), rows)


def rounded(value: float) -> str:
    """Return a measure to two digits."""
    return f"{float(f'{value:.2g}'):g}" if math.isfinite(value) else "failed"


def ranks(found: Comparison) -> str:
    """Return mean ranks by tracking and by both internal forces, and the share of finished runs."""
    by_force = Comparison(found.data.assign(axial_rms_N=force(found))).ranks("axial_rms_N")
    by_tracking = found.ranks("tracking_rms_mm")
    runs = found.table.groupby("controller")[["runs", "finished"]].sum()
    classes = {row["controller"]: row["information"] for _, row in found.table.reset_index().iterrows()}
    rows = [
        (
            f"`{name}`",
            classes[str(name)],
            interval(row),
            interval(by_force.loc[name]),
            "{finished} of {runs}".format(**runs.loc[name]),
        )
        for name, row in by_tracking.iterrows()
    ]
    return markdown(("controller", "measures", "by tracking", "by internal force", "finished runs"), rows)


def interval(row: Any) -> str:
    """Return a mean rank and its interval."""
    return f"{row['rank']:.1f} ({row['low']:.1f} to {row['high']:.1f})"


def merged(kept: Comparison, new: Comparison) -> Comparison:
    """Return the rows of both, the second's in place of the first's, by cell and controller."""
    first, second, names = kept.table, new.table, controller_names()
    rows = pd.concat([first[~first.index.isin(second.index)], second])
    cells = first.index.append(second.index).drop_duplicates()
    return Comparison.of_cells(
        rows.loc[sorted(cells, key=lambda cell: (BENCHMARK.index(cell[0]), names.index(cell[1])))]
    )


def store(found: Comparison) -> None:
    """Write the CSV, without verdicts and engines that some of its rows do not have."""
    known = found.table[["sound", "kept", "engine"]].replace("", math.nan).notna().all()
    Comparison(found.data.drop_vars(list(known[~known].index))).write_csv(DATA)


def main() -> None:
    """Run what is missing, and write table, figures and text."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, help="of every run, s; the scenarios' own when omitted")
    parser.add_argument("--seeds", type=int, default=10, help="of random trials")
    parser.add_argument("--trials", nargs="+", help="names; all when omitted")
    parser.add_argument("--controllers", nargs="+", default=controller_names(), help="all when omitted")
    parser.add_argument("--cells", nargs="+", help="all that have gains when omitted")
    parser.add_argument("--workers", type=int, help="processes; one for each processor when omitted")
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "benchmark")
    parser.add_argument("--page", action="store_true", help="only write the text, from the CSV")
    asked = parser.parse_args()
    if asked.page:
        write(Comparison.load(DATA), asked.duration)
        return
    cells = asked.cells or tuned_cells()
    known = {name: None for cell in cells for name in standard_trials(Scenario.load(cell))}
    wanted = asked.trials or list(known)
    options: dict[str, Any] = {"seeds": asked.seeds, "duration": asked.duration}
    execution = Execution(asked.workers, engine="auto")
    new = compare(cells, asked.controllers, wanted, out=asked.out, execution=execution, **options)
    found = merged(Comparison.load(DATA), new)
    store(found)
    for cell in map(str, found.data["scenario"].values):
        save_image(comparison_figure(found, cell), IMAGES / f"benchmark-{cell}")
    write(found, asked.duration)
    print(found.summary())


if __name__ == "__main__":
    main()
