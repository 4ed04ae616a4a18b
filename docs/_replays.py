"""Replays of the site, in as many processes as there are cores: ``python docs/_replays.py STATIC CACHE``."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import coop_pin as cp
from coop_pin import RunResult, Scenario, scenario_names
from coop_pin.comparison import Comparison, benchmark_scenario, controllers_for, standard_trials
from coop_pin.comparison.trials import changes_of
from coop_pin.sweeps.heat_map import REPLAYS, replay_file, wanted_squeeze
from coop_pin.viz import save_replay

TELLING = (
    *(("adept-anchored", law, "bias 1 mm") for law in ("printed", "zeroed-leaky", "anchored")),
    *(
        ("two-pandas-box", law, "bias 1 mm")
        for law in ("printed", "computed-torque", "mean-pose", "anchored")
    ),
    *(("two-pandas-box", "anchored", trial) for trial in ("push", "torque of an arm lost")),
    *(("three-ur5-plate", law, "bias 1 mm") for law in ("leader-follower", "anchored")),
    ("panda-ur5-bar", "anchored", "wrist lost at half time"),
)
"""Cells of the comparison whose replays the site has: scenario, controller, trial."""
PAIRS = tuple(
    tuple((scenario, law, "bias 1 mm") for law in laws)
    for scenario, *laws in (
        ("adept-anchored", "printed", "anchored"),
        ("two-pandas-box", "printed", "anchored"),
        ("three-ur5-plate", "anchored", "leader-follower"),
    )
)
"""Pairs of them of which the site has panes, in the order of the comparison's rows."""
EMBEDDED = "replay.html"
"""Replay that a page embeds."""


def benchmark_run(scenario: str, controller: str, trial: str) -> RunResult:
    """Return the run of a cell of the benchmark, with its stored gains."""
    base = benchmark_scenario(Scenario.load(scenario))
    law = controllers_for(base, [controller])[controller]
    return cp.run(base, changes_of(base, standard_trials(base)[trial], law), warn=False)


def runs() -> dict[str, dict[str, Callable[[], RunResult]]]:
    """Return what makes the runs of each replay and their names, by its file below the static files."""
    first = ("pick-carry-place", "two-pandas-palms", "three-ur5-handover")
    names = (*first, *(name for name in scenario_names() if name not in first))
    table = {f"{REPLAYS}/{name}.html": {name: partial(cp.run, name, warn=False)} for name in names}
    table |= {
        f"{REPLAYS}/{replay_file(cells)}": {cell[1]: partial(benchmark_run, *cell) for cell in cells}
        for cells in (*((cell,) for cell in TELLING), *PAIRS)
    }
    return table | {EMBEDDED: {EMBEDDED: partial(cp.run, "adept-paper", {"duration": 12.0}, warn=False)}}


def write(file: str, static: Path, cache: Path) -> None:
    """Write one replay, or copy it from the cache of this state of the package."""
    kept = cache / file
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        made = runs()[file]
        first, *others = (run() for run in made.values())
        save_replay(first, kept, *others, names=tuple(made) if others else ())
    shutil.copy(kept, static / file)


def write_drafts(static: Path) -> None:
    """Write one short replay under the names of all."""
    save_replay(cp.run("adept-paper", {"duration": 0.1, "events": ()}, warn=False), static / EMBEDDED)
    for file in runs():
        if file != EMBEDDED:
            shutil.copy(static / EMBEDDED, static / file)


def write_explorer(static: Path) -> None:
    """Write the explorers of the benchmark and of both engines, after the replays that the first links to."""
    studies = Path(__file__).parents[1] / "studies"
    Comparison.load(studies / "both_engines" / "explorer.csv").write_html(static / "engines.html")
    comparison = Comparison.load(studies / "benchmark.csv")
    scenarios = {
        str(name): benchmark_scenario(Scenario.load(str(name))) for name in comparison.data["scenario"].values
    }
    squeezes = {name: wanted_squeeze(scenario) for name, scenario in scenarios.items()}
    comparison.write_html(static / "comparison.html", squeezes=squeezes)


def main(static: Path, cache: Path) -> None:
    """Write all replays and the explorer."""
    (static / REPLAYS).mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(partial(write, static=static, cache=cache), runs()))
    write_explorer(static)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
