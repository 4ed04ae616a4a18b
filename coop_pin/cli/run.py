"""Command ``coop-pin run``: simulate a scenario and write its results into a folder."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from coop_pin import viz
from coop_pin.cli.exit_codes import FAILED, INTERRUPTED, NOT_TRUSTWORTHY, OK
from coop_pin.cli.overrides import ScenarioCommand
from coop_pin.engines import Engine
from coop_pin.errors import CoopPinError, RunInterruptedError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run(ScenarioCommand):
    """Run a scenario and write its results into a folder.

    Every field of the scenario can be changed: --controller.gains.sign-gain 0.5 --cell.arms.left.posture 1 2
    3 --controller.switching.kind tanh --events []. 'coop-pin fields NAME_OR_FILE' lists them.

    The exit code is 3 if the run is not trustworthy: it breached a threshold in the scenario's table 'trust'.

    Attributes:
        out: output folder; out/ and the scenario's name when omitted.
        quiet: no progress bar and no table.
        verbose: list every breach of the trust thresholds.
        stop_at_breach: end the run at its first breach of the trust thresholds.
        engine: engine of the run; traced and batch are compiled code, auto takes the fastest.
        replay: write replay.html, the motion in 3-D.
        figures: write the figures, as PNG.
        svg: write the figures as SVG as well.
        report: write report.html, the whole run on one page.
    """

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    quiet: bool = False
    verbose: bool = False
    stop_at_breach: bool = False
    engine: Engine = "pinocchio"
    replay: bool = True
    figures: bool = True
    svg: bool = False
    report: bool = False

    def execute(self) -> int:
        """Run the scenario, write its folder, print its metrics, and return the exit code.

        An aborted run is written up to its last tick.

        Raises:
            CoopPinError: the run could not start.
        """
        from coop_pin.engine_choice import choose_engine
        from coop_pin.progress_bar import ProgressBar
        from coop_pin.run_folder import RunFolder, Stopwatch
        from coop_pin.run_scenario import run

        scenario = self.loaded()
        folder = RunFolder(self.out or Path("out") / scenario.name)
        folder.path.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made must not cost a run
        if self.engine == "auto" and not self.quiet:
            choice = choose_engine(scenario, is_live=self.stop_at_breach)
            print(f"engine {choice.engine}: {choice.reason}")
        watch = Stopwatch()
        try:
            with ProgressBar("ticks", title=scenario.name, quiet=self.quiet) as bar:
                advance, stop = bar.advance_to, self.stop_at_breach
                result = run(scenario, progress=advance, stop_at_breach=stop, engine=self.engine)
        except (CoopPinError, RunInterruptedError) as error:
            if error.result is None:
                raise
            folder.write(error.result, watch.timing(error.result), replay=False, figures=())
            print(f"coop-pin: {error} in {folder.path / folder.RESULT}", file=sys.stderr)
            self._warn(error.result.verdict(), error.result.breaches())
            return INTERRUPTED if isinstance(error, RunInterruptedError) else FAILED
        timing = watch.timing(result)
        formats: tuple[Literal["png", "svg"], ...] = ("png", "svg") if self.svg else ("png",)
        folder.write(result, timing, replay=self.replay, figures=formats if self.figures else ())
        if self.report:
            viz.save_report(result, folder.path / folder.REPORT)
        breaches = result.breaches()
        if not self.quiet:
            written = f"written to {folder.path}, {timing.real_time_factor:.1f} times real time"
            print(result.summary(), *self._details(breaches), written, sep="\n")
        elif breaches:
            self._warn(result.verdict(), breaches)
        return NOT_TRUSTWORTHY if breaches else OK

    def _warn(self, verdict: str, breaches: Sequence[object]) -> None:
        print(f"coop-pin: {verdict}", *self._details(breaches), sep="\n", file=sys.stderr)

    def _details(self, breaches: Sequence[object]) -> list[str]:
        """Return every breach as a line if asked for, otherwise how to ask when there are several."""
        if self.verbose:
            return [f"  {breach}" for breach in breaches]
        return [f"  --verbose lists all {len(breaches)} breaches"] if len(breaches) > 1 else []
