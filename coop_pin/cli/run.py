"""Command ``coop-pin run``: simulate a scenario and write its results into a folder."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from coop_pin import viz
from coop_pin.base.errors import CoopPinError, RunInterruptedError
from coop_pin.cli.exit_codes import INTERRUPTED, NOT_KEPT, NOT_SOUND, OK
from coop_pin.cli.overrides import ANY_CODE, NO_FIELDS, Code, ScenarioName, TypedFields, load_scenario
from coop_pin.cli.terminal import Working, print_wrapped
from coop_pin.compiled.engines import Engine


def run(
    scenario: ScenarioName,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    quiet: bool = False,
    verbose: bool = False,
    stop_at_breach: bool = False,
    engine: Engine = "pinocchio",
    replay: bool = True,
    figures: bool = True,
    svg: bool = False,
    report: bool = False,
    distances: bool = False,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> int:
    """Run a scenario and write its results into a folder.

    Every field of the scenario can be changed: --controller.gains.sign-gain 0.5 --cell.arms.left.posture 1 2
    3 --controller.switching.kind tanh --events []. 'coop-pin fields NAME_OR_FILE' lists them.

    The exit code is 3 if the simulation is not sound, by the thresholds in the scenario's table 'trust'. It
    is 4 if the task is not kept: off the limits in the table 'task', dropped, or ended by an error.

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        out: output folder; out/ and the scenario's name when omitted.
        quiet: no progress bar and no table.
        verbose: list every breach of thresholds and limits.
        stop_at_breach: end the run at its first breach of the trust thresholds.
        engine: engine of the run; auto takes the fastest.
        replay: write replay.html, the motion in 3-D.
        figures: write the figures, as PNG.
        svg: write the figures as SVG as well.
        report: write report.html, the whole run on one page.
        distances: record the least distance between bodies at every sample, which the replay draws.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        CoopPinError: the run could not start.
    """
    from coop_pin.cli.run_folder import RunFolder, Timing
    from coop_pin.compiled.engine_choice import choose_engine
    from coop_pin.running import run_scenario
    from coop_pin.sweeps.progress_bar import ProgressBar

    chosen = load_scenario(scenario, fields, code, quiet=quiet)
    folder = RunFolder(out or Path("out") / chosen.name)
    folder.path.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made must not cost a run
    if engine == "auto" and not quiet:
        print(choose_engine(chosen, is_live=stop_at_breach).summary())
    start = time.perf_counter(), time.process_time()
    try:
        with ProgressBar("ticks", title=chosen.name, quiet=quiet) as bar:
            result = run_scenario.run(
                chosen, progress=bar.advance_to, stop_at_breach=stop_at_breach, engine=engine
            )
    except (CoopPinError, RunInterruptedError) as error:
        if (result := error.result) is None:
            raise
        folder.write(result, Timing.since(start, result), replay=False, figures=())
        print(f"coop-pin: {error} in {folder.path / folder.RESULT}", file=sys.stderr)
        _warn(result, verbose)
        return INTERRUPTED if isinstance(error, RunInterruptedError) else _exit_code(result)
    timing = Timing.since(start, result)
    if distances:
        from coop_pin.running.recorded_distances import with_distances  # slow to load

        with Working("measuring distances", quiet=quiet):
            result = with_distances(result)
    formats: tuple[Literal["png", "svg"], ...] = ("png", "svg") if svg else ("png",)
    with Working(f"writing into {folder.path}", quiet=quiet):
        folder.write(result, timing, replay=replay, figures=formats if figures else ())
        if report:
            viz.save_report(result, folder.path / folder.REPORT)
    status = _exit_code(result)
    if not quiet:
        written = f"written to {folder.path}, {timing.real_time_factor:.2g} times real time"
        print_wrapped(result.summary(), *_details(result, verbose), written, sep="\n")
    elif status != OK:
        _warn(result, verbose)
    return status


def _exit_code(result: Any) -> int:
    if not result.simulation_sound:
        return NOT_SOUND
    return OK if result.task.kept else NOT_KEPT


def _warn(result: Any, verbose: bool) -> None:
    print(f"coop-pin: {result.verdict()}", *_details(result, verbose), sep="\n", file=sys.stderr)


def _details(result: Any, verbose: bool) -> list[str]:
    """Return every breach as a line where details are wanted, otherwise the option that lists several."""
    breaches = [*result.breaches(), *result.task.deviations]
    if verbose:
        return [f"  {breach}" for breach in breaches]
    return [f"  --verbose lists all {len(breaches)} errors beyond their limits"] if len(breaches) > 1 else []
