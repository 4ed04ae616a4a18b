"""Command ``coop-pin compare``: controllers by scenarios and trials, in one table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin import figures
from coop_pin.cli.overrides import ANY_CODE, NO_FIELDS, Code, load_scenario
from coop_pin.cli.sweep import ExecutionOptions, tell
from coop_pin.cli.terminal import Working
from coop_pin.sweeps.workers.execution import HERE


def compare(
    scenarios: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")] = (),
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = (),
    trials: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = (),
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out") / "compare",
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 10,
    duration: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    untuned: bool = False,
    gains: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    tune: bool = False,
    generations: Annotated[int, tyro.conf.arg(metavar="N")] = 4,
    size: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    least_damping: Annotated[float, tyro.conf.arg(metavar="RATIO")] = 0.55,
    list: bool = False,
    replay: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CELL")] = (),
    execution: ExecutionOptions = HERE,
    retry_failed: bool = False,
    code: Code = ANY_CODE,
) -> None:
    """Compare controllers under standard trials. Finished runs are kept: the same command goes on with them.

    For example, a controller of your own (mine.py in this folder) beside two others:

    coop-pin compare adept-anchored --controllers anchored computed-torque mine:Law --trials nominal push

    comparison.html shows the table as a heat map; 'coop-pin view DIR' opens it so that a cell opens its
    replay, and two cells open theirs side by side.

    Args:
        scenarios: names listed by 'coop-pin list', or TOML files; the six of the benchmark when omitted.
        controllers: names, or module:Class of your own; all that come with coop-pin when omitted.
        trials: names; all standard trials when omitted, or with --tune those of a search.
        out: output folder for the runs, comparison.csv, comparison.html, and figures of each
            scenario.
        seeds: number of seeds of random trials.
        duration: duration of every run, s; the scenarios' own when omitted.
        untuned: do not use stored gains.
        gains: gains.csv of your own, as --tune writes it; that of coop-pin when omitted.
        tune: search the gains of the controllers instead, and write gains.csv.
        generations: number of generations of the search after the first one.
        size: points in a generation of the search, whatever the number of gains.
        least_damping: smallest damping ratio of the payload's modes that the search takes; -1 bounds nothing.
        list: print only the names of controllers and trials.
        replay: write only the replay of a cell of the table in the output folder, or of up to four side by
            side, and link it in comparison.html: "SCENARIO | CONTROLLER | TRIAL", with "| SEED" behind a
            random trial.
        execution: workers, engine and folders to merge.
        retry_failed: repeat runs that failed for lack of time or of a worker.
        code: code that the scenarios may name, and the controllers.

    Raises:
        CoopPinError: whatever ``compare``, ``tune_controllers`` or ``Comparison.open`` raises.
    """
    from coop_pin import comparison
    from coop_pin.base.schema.user_code import code_named
    from coop_pin.comparison import benchmark
    from coop_pin.comparison.controllers import GAINS
    from coop_pin.description.scenario import Scenario

    names, cells = controllers or tuple(comparison.controller_names()), scenarios or comparison.BENCHMARK
    if not (replay or list):
        named = [("controllers", name) for name in names if ":" in name]
        for cell in cells:
            named += [(f"{cell}: {path}", name) for path, name in code_named(load_scenario(cell, NO_FIELDS))]
        code.admit(named, quiet=execution.quiet)
    if replay:
        _write_replay(comparison.Comparison.load(out), out, replay)
    elif list:
        print("controllers:", ", ".join(names))
        for cell in cells:
            base = comparison.benchmark_scenario(Scenario.load(cell))
            print(f"trials of {cell}:", ", ".join(comparison.standard_trials(base)))
    elif tune:
        comparison.tune_controllers(
            cells,
            names,
            out=out,
            generations=generations,
            size=size,
            duration=duration,
            trials=trials,
            least_damping=least_damping,
            execution=execution,
        )
        print(f"written to {out / 'gains.csv'}")
    else:
        result = benchmark.compare(
            cells,
            {name: name for name in names},
            trials or None,
            out=out,
            seeds=seeds,
            duration=duration,
            tuned=not untuned,
            gains=gains or GAINS,
            execution=execution,
            retry_failed=retry_failed,
        )
        for name in map(str, result.data["scenario"].values):
            figures.save_figure(figures.comparison_figure(result, name), out / name / "comparison")
        tell(execution, result.summary(), out)


def _write_replay(table: Any, folder: Path, texts: Sequence[str]) -> None:
    """Write the replay of some cells side by side, and link it in the page of the table."""
    from coop_pin.viz.explorer import comparison_replay

    with Working("simulating and drawing"):
        page = comparison_replay(table, texts, folder)
    table.write_html(folder / "comparison.html")
    print(page.resolve())
