"""Command ``coop-pin compare``: controllers by scenarios and trials, in one table."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import tyro

from coop_pin import figures, viz
from coop_pin.cli.execution import HERE, ExecutionOptions, kept_result
from coop_pin.cli.exit_codes import OK
from coop_pin.errors import FieldError


@dataclasses.dataclass(frozen=True)
class Compare:
    """Compare controllers under standard trials. Finished runs are kept: the same command goes on with them.

    For example, a controller of your own (mine.py in this folder) beside two others:

    coop-pin compare adept-anchored --controllers anchored computed-torque mine:Law --trials nominal push

    comparison.html shows the table as a heat map; it has the command that writes the replay of a cell.

    Attributes:
        scenarios: names listed by 'coop-pin list', or TOML files; the six of the benchmark when omitted.
        controllers: names, or module:Class of your own; all that come with coop-pin when omitted.
        trials: names; all standard trials when omitted.
        out: output folder for the runs, comparison.csv, comparison.html, and figures of each
            scenario.
        seeds: number of seeds of random trials.
        duration: duration of every run, s; the scenarios' own when omitted.
        untuned: do not use stored gains.
        gains: gains.csv of your own, as --tune writes it; that of coop-pin when omitted.
        tune: search the gains of the controllers instead, and write gains.csv.
        generations: number of generations of the search after the first one.
        size: points in a generation of the search, whatever the number of gains.
        list: print only the names of controllers and trials.
        replay: write only the replay of a cell of the table in the output folder, or of up to four side by
            side, and link it in comparison.html: "SCENARIO | CONTROLLER | TRIAL", with "| SEED" behind a
            random trial.
        execution: workers, engine and folders to merge.
    """

    scenarios: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")] = ()
    controllers: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    trials: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ()
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out") / "compare"
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    duration: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    untuned: bool = False
    gains: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    tune: bool = False
    generations: Annotated[int, tyro.conf.arg(metavar="N")] = 4
    size: Annotated[int, tyro.conf.arg(metavar="N")] = 6
    list: bool = False
    replay: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CELL")] = ()
    execution: ExecutionOptions = HERE

    def execute(self) -> int:
        """Run what is missing, print the table and return the exit code; failed runs do not fail the command.

        Raises:
            CoopPinError: whatever ``compare``, ``tune_controllers`` or ``Comparison.open`` raises.
        """
        from coop_pin.comparison import BENCHMARK, compare, controller_names, tune_controllers
        from coop_pin.comparison.controllers import GAINS

        controllers, scenarios = self.controllers or tuple(controller_names()), self.scenarios or BENCHMARK
        if self.replay:
            self._write_replay()
        elif self.list:
            self._print_names(controllers, scenarios)
        elif self.tune:
            tune_controllers(
                scenarios,
                controllers,
                out=self.out,
                generations=self.generations,
                size=self.size,
                duration=self.duration,
                execution=self.execution,
            )
            print(f"written to {self.out / 'gains.csv'}")
        else:
            result = compare(
                scenarios,
                {name: name for name in controllers},
                self.trials or None,
                out=self.out,
                seeds=self.seeds,
                duration=self.duration,
                tuned=not self.untuned,
                gains=self.gains or GAINS,
                execution=self.execution,
            )
            for name in map(str, result.data["scenario"].values):
                figures.save_figure(figures.comparison_figure(result, name), self.out / name / "comparison")
            if not self.execution.quiet:
                print(result.summary())
                print(f"written to {self.out}")
        return OK

    def _write_replay(self) -> None:
        from coop_pin.comparison import Comparison
        from coop_pin.heat_map import REPLAYS, cell_names, replay_file

        comparison, cells = Comparison.load(self.out), list(map(cell_names, self.replay))
        runs = [_run(comparison, cell) for cell in cells]
        page = self.out / REPLAYS / replay_file(cells)
        viz.save_replay(runs[0], page, *runs[1:], names=self.replay)
        comparison.write_html(self.out / "comparison.html")
        print(page.resolve())

    def _print_names(self, controllers: tuple[str, ...], scenarios: tuple[str, ...]) -> None:
        from coop_pin.comparison import benchmark_scenario, standard_trials
        from coop_pin.description import Scenario

        print("controllers:", ", ".join(controllers))
        for name in scenarios:
            trials = standard_trials(benchmark_scenario(Scenario.load(name)))
            print(f"trials of {name}:", ", ".join(trials))


def _run(comparison: Any, cell: list[str]) -> Any:
    """Return the result of a cell's run."""
    names, seed = cell[:3], "".join(cell[3:]) or "0"
    if len(names) < 3 or not seed.isdecimal():
        form = "'SCENARIO | CONTROLLER | TRIAL', with '| SEED' behind a random trial"
        raise FieldError(f"is {' | '.join(cell)!r}; it must be {form}", "--replay")
    return kept_result(lambda: comparison.open(*names, seed=int(seed)))
