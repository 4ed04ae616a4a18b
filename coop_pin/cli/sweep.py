"""Commands with many runs: ``coop-pin sweep``, ``sweep-show`` and ``tune``, and their common options."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro

from coop_pin import figures, sweeps
from coop_pin.base.errors import FieldError
from coop_pin.cli.overrides import (
    ANY_CODE,
    NO_FIELDS,
    Code,
    ScenarioName,
    TypedFields,
    changes,
    field_path,
    load_scenario,
)
from coop_pin.sweeps.workers.execution import HERE, Execution

ExecutionOptions: TypeAlias = Annotated[Execution, tyro.conf.OmitArgPrefixes, tyro.conf.UseAppendAction]
"""Fields of an Execution as options of a command: --workers, --scheduler, --engine, --merge, --quiet."""


def tell(execution: Execution, summary: str, folder: Path) -> None:
    """Print the summary of many runs and their folder, unless they are to be quiet."""
    if not execution.quiet:
        print(summary, f"written to {folder}", sep="\n")


def sweep(
    plan: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP.toml")],
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    execution: ExecutionOptions = HERE,
    retry_failed: bool = False,
    estimate: bool = False,
    code: Code = ANY_CODE,
) -> None:
    """Run a scenario many times. Finished runs are kept: the same command resumes an interrupted sweep.

    Args:
        plan: a TOML file with the scenario and the fields that vary.
        out: output folder for the runs and their table; out/ and the file's name when omitted.
        execution: workers, engine and folders to merge.
        retry_failed: repeat runs that failed for lack of time or of a worker.
        estimate: print only the plan and an estimate of its duration.
        code: code that the plan and its scenarios may name.
    """
    from coop_pin.sweeps import engine
    from coop_pin.sweeps.plan import SweepPlan

    whole = SweepPlan.load(plan)
    code.admit(whole.code_named(), quiet=execution.quiet)
    if estimate:
        print(whole.summary(), sweeps.estimate(whole, workers=execution.workers).summary(), sep="\n")
        return
    folder = out or Path("out") / plan.stem.lstrip(".")
    result = engine.sweep(whole, out=folder, execution=execution, retry_failed=retry_failed)
    tell(execution, result.summary(), folder)


def sweep_show(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    best: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None,
    count: Annotated[int, tyro.conf.arg(metavar="N")] = 5,
    failures: bool = False,
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    metric: Annotated[str, tyro.conf.arg(metavar="METRIC")] = "internal_force_error_max_N",
    over: Annotated[str | None, tyro.conf.arg(metavar="FIELD")] = None,
    against: Annotated[str | None, tyro.conf.arg(metavar="METRIC")] = None,
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    replay: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N...")] = (),
    at: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FIELD=VALUE")] = (),
) -> None:
    """Print the results of a sweep, finished or not, and draw them.

    Args:
        folder: the folder of a sweep.
        best: a metric; the runs with its smallest values are listed.
        count: number of these runs.
        failures: list the runs that failed, with their errors.
        figure: draw the metric over the fields that vary; written as PNG and as SVG.
        metric: the metric that the figure shows.
        over: draw lines along this field instead of a map or lines along the longest dimension.
        against: a second metric: draw all runs by the two metrics, with the Pareto front.
        table: write these runs as CSV: varied fields, status, error, metrics, durations.
        page: write a heat map of these runs, an HTML page that is explored; it shows the metric first.
            'coop-pin view FOLDER' opens it so that a cell opens its run.
        replay: number of a run, or of up to four: simulate them again and write their 3-D replay, side by
            side, which the page links.
        at: show, list, draw and write only runs in which a varied field has this value, FIELD=VALUE; once for
            each field.

    Raises:
        FileReadError: the folder is not that of a sweep.
        NameNotFoundError: no run has the metric, or no field of ``at`` varies.
        FieldError: no run has a value of ``at``.
    """
    from coop_pin.sweeps.result import SweepResult

    varied = {field: value for field, _, value in (text.partition("=") for text in at)}
    result = SweepResult.load(folder).at(varied)
    print(result.summary())
    if best is not None:
        print(f"smallest {best}:")
        for run in result.best(best, count):
            verdict = f" ({text})" if (text := run.verdict()) else ""
            print(f"  {run.metrics[best]:<12.5g} run {run.number}: {_text(run.parameters)}{verdict}")
    if failures:
        print("failed:")
        for failure in result.failures:
            reason = f"{failure.kind}: {failure.message}"
            print(f"  run {failure.number}: {_text(failure.parameters)}: {reason}")
    if figure is not None:
        if against is not None:
            drawn = figures.pareto_figure(result, against, metric)
        else:
            drawn = figures.sweep_figure(result, metric, over)
        stem = figure.with_suffix("") if figure.suffix in (".png", ".svg") else figure
        print("written to " + " and ".join(map(str, figures.save_figure(drawn, stem))))
    if table is not None:
        result.store.write_with(table, result.table.to_csv)
        print(f"written to {table}")
    if replay:
        from coop_pin.viz.explorer import sweep_replay

        file = sweep_replay(result, list(map(str, replay)), (page or folder / "map.html").parent)
        print(f"written to {file}")
    if page is not None:
        result.write_html(page, metric)
        print(f"written to {page}")


def _text(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in parameters.items())


def tune(
    scenario: ScenarioName,
    minimize: Annotated[str, tyro.conf.arg(metavar="METRIC")],
    vary: Annotated[
        tuple[tuple[str, float, float], ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="FIELD LOW HIGH"),
    ],
    subject_to: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="BOUND")] = (),
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    metric: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FUNCTION")] = (),
    generations: Annotated[int, tyro.conf.arg(metavar="N")] = 10,
    population: Annotated[int, tyro.conf.arg(metavar="N")] = 8,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    execution: ExecutionOptions = HERE,
    code: Code = ANY_CODE,
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Search fields of a scenario for the smallest value of a metric.

    Every field of the scenario can be changed as in 'coop-pin run'. Every run is kept: the same command
    resumes an interrupted search. For example, two gains that keep the internal force small among those that
    settle in time:

    coop-pin tune adept-paper --minimize moving_internal_axial_rms_error_N --subject-to 'settling_time_s<2.5'
    --vary controller.gains.sign_gain 0 1 --vary controller.gains.pose_gain 1 5

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        minimize: metric, for example moving_position_rms_m or torque_peak_Nm; metrics.json of any run has
            their names.
        vary: field with its lowest and highest value; once for each field. 'coop-pin fields SCENARIO' lists
            fields.
        subject_to: constraint on the best run, METRIC<NUMBER or METRIC>NUMBER in quotes; once for each
            constraint.
        out: output folder for the runs and their table; out/tune- and the scenario's name when omitted.
        metric: metric of your own, module:function, as in a sweep; once for each.
        generations: number of generations after the first one.
        population: runs in a generation for each field, at least 5 together: there are (generations + 1) x
            population x fields runs in all.
        seed: seed of the search; another seed tries other values.
        execution: workers, engine and folders to merge.
        code: code that the scenario may name.
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: a field has two ranges, or a range and a value.
        CoopPinError: whatever ``tune`` raises.
    """
    from coop_pin.sweeps import optimisation

    base = load_scenario(scenario, fields, code, quiet=execution.quiet)
    arms, ranges = base.cell.arms, dict[str, tuple[float, float]]()
    fixed, folder = changes(fields, arms), out or Path("out") / f"tune-{Path(scenario).stem}"
    for field, low, high in vary:
        path = field_path(field, arms)
        if path in ranges:
            raise FieldError("has two ranges; give it one", path)
        if path in fixed:
            raise FieldError("has a range and a value; give it one of them", path)
        ranges[path] = (low, high)
    result = optimisation.tune(
        base,
        ranges,
        minimize=minimize,
        subject_to=subject_to,
        out=folder,
        metrics=metric,
        generations=generations,
        population=population,
        seed=seed,
        execution=execution,
    )
    words = [word for field, typed in fields.items() for word in (f"--{field}", *typed)]
    words += [word for field, value in result.tuned.items() for word in (f"--{field}", repr(value))]
    rerun = "run it: " + shlex.join(["coop-pin", "run", scenario, *words])
    show = "all runs: " + shlex.join(["coop-pin", "sweep-show", str(folder)])
    tell(execution, f"{result.summary()}\n{rerun}\n{show}", folder)
