"""Benchmark of all controllers, from stored gains, in the cells that have them.

Runs what is missing in out/studies/benchmark, and writes studies/benchmark.csv, what was run into
docs/concepts/benchmark.md, and docs/images/benchmark-CELL.png.

Usage: python studies/benchmark.py [--duration SECONDS] [--seeds N] [--trials NAME ...] [--workers N]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from pages import IMAGES, markdown, save_image, write_block

from coop_pin import Execution, Scenario
from coop_pin.comparison import BENCHMARK, Comparison, compare, controller_names, standard_trials
from coop_pin.comparison.controllers import stored_gains
from coop_pin.figures import comparison_figure

HERE = Path(__file__).parent
DATA = HERE / "benchmark.csv"
PAGE = HERE.parent / "docs" / "concepts" / "benchmark.md"
INFORMATION = {
    "printed": "blind",
    "sliding-pid": "blind",
    "prescribed-performance": "blind",
    "payload-pd": "agreed start",
    "payload-pi": "agreed start",
    "zeroed-leaky": "agreed start",
    "leader-follower": "own wrench",
    "anchored": "internal wrench",
    "computed-torque": "model, internal wrench",
    "computed-torque-wrong-model": "model, internal wrench",
    "object-impedance": "model, internal wrench",
    "torque-qp": "model, internal wrench",
    "adaptive": "model (regressor), internal wrench",
    "adaptive-verginis": "model (regressor)",
}
"""Class of information of each controller: what it has besides the joints of its own arm."""


def tuned_cells() -> list[str]:
    """Return the cells of the benchmark in which every controller has stored gains."""
    names = set(controller_names())
    return [cell for cell in BENCHMARK if names <= set(stored_gains(cell))]


def text(found: Comparison, duration: float | None) -> str:
    """Return what was run, which cells are still to be tuned, and the ranks over all of it, as Markdown."""
    sizes = found.data.sizes
    runs, finished, trusted = (int(found.table[name].sum()) for name in ("runs", "finished", "trustworthy"))
    length = "of the scenario's own length" if duration is None else f"of {duration:g} s"
    cells = ", ".join(f"`{name}`" for name in found.data["scenario"].values)
    others = ", ".join(f"`{name}`" for name in BENCHMARK if name not in found.data["scenario"].values)
    return (
        f"{sizes['controller']} controllers, {sizes['trial']} trials, {cells}: {runs} runs {length},"
        f" {finished} finished, {trusted} trustworthy. Not tuned yet, and so not run: {others or 'none'}."
        "\n\nMean rank of each controller over all cells and trials, 1 is the best, with an interval from"
        f" 95 % of resamplings of the places (cell and trial), which are chosen by hand:\n\n{ranks(found)}"
    )


def ranks(found: Comparison) -> str:
    """Return mean ranks by tracking and by both internal forces, and the share of trustworthy runs."""
    force = found.data["axial_rms_N"] ** 2 + found.data["shear_rms_N"] ** 2
    by_force = Comparison(found.data.assign(axial_rms_N=force)).ranks("axial_rms_N")
    by_tracking = found.ranks("tracking_rms_mm")
    runs = found.table.groupby("controller")[["runs", "trustworthy"]].sum()
    rows = [
        (
            f"`{name}`",
            INFORMATION[str(name)],
            interval(row),
            interval(by_force.loc[name]),
            "{trustworthy} of {runs}".format(**runs.loc[name]),
        )
        for name, row in by_tracking.iterrows()
    ]
    return markdown(("controller", "measures", "by tracking", "by internal force", "trustworthy runs"), rows)


def interval(row: Any) -> str:
    """Return a mean rank and its interval."""
    return f"{row['rank']:.1f} ({row['low']:.1f} to {row['high']:.1f})"


def main() -> None:
    """Run what is missing, and write table, figures and text."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, help="of every run, s; the scenarios' own when omitted")
    parser.add_argument("--seeds", type=int, default=10, help="of random trials")
    parser.add_argument("--trials", nargs="+", help="names; all when omitted")
    parser.add_argument("--workers", type=int, help="processes; one for each processor when omitted")
    parser.add_argument("--out", type=Path, default=Path("out") / "studies" / "benchmark")
    asked = parser.parse_args()
    cells = tuned_cells()
    known = {name: None for cell in cells for name in standard_trials(Scenario.load(cell))}
    wanted = asked.trials or list(known)
    options: dict[str, Any] = {"seeds": asked.seeds, "duration": asked.duration}
    execution = Execution(asked.workers, engine="auto")
    found = compare(cells, controller_names(), wanted, out=asked.out, execution=execution, **options)
    found.write_csv(DATA)
    for cell in map(str, found.data["scenario"].values):
        save_image(comparison_figure(found, cell), IMAGES / f"benchmark-{cell}")
    write_block(PAGE, "benchmark", text(found, asked.duration))
    print(found.summary())


if __name__ == "__main__":
    main()
