"""Command ``coop-pin tune``: search fields of a scenario for the smallest value of a metric."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin.base.errors import FieldError
from coop_pin.cli.execution import HERE, ExecutionOptions, tell
from coop_pin.cli.overrides import NO_FIELDS, ScenarioName, TypedFields, changes, field_path, load_scenario


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
    fields: TypedFields = NO_FIELDS,
) -> None:
    """Search fields of a scenario for the smallest value of a metric.

    Every field of the scenario can be changed as in 'coop-pin run'. Every run is kept: the same command
    resumes an interrupted search. For example, two gains that keep the internal force small among those that
    settle in time:

    coop-pin tune adept-paper --minimize internal_axial_rms_error_N --subject-to 'settling_time_s<2.5'
    --vary controller.gains.sign_gain 0 1 --vary controller.gains.pose_gain 1 5

    Args:
        scenario: a name listed by 'coop-pin list', or a TOML file.
        minimize: metric, for example position_rms_m or torque_peak_Nm; metrics.json of any run has their
            names.
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
        fields: fields of the scenario, as typed.

    Raises:
        FieldError: a field has two ranges, or a range and a value.
        CoopPinError: whatever ``tune`` raises.
    """
    from coop_pin.sweeps import optimisation

    base = load_scenario(scenario, fields)
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
