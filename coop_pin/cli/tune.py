"""Command ``coop-pin tune``: search fields of a scenario for the smallest value of a metric."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import Annotated

import tyro

from coop_pin import sweeps
from coop_pin.cli.execution import HERE, ExecutionOptions
from coop_pin.cli.exit_codes import OK
from coop_pin.cli.overrides import ScenarioCommand, changes, field_path
from coop_pin.errors import FieldError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tune(ScenarioCommand):
    """Search fields of a scenario for the smallest value of a metric.

    Every field of the scenario can be changed as in 'coop-pin run'. Every run is kept: the same command
    resumes an interrupted search. For example, two gains that keep the internal force small among those that
    settle in time:

    coop-pin tune adept-paper --minimize internal_axial_rms_error_N --subject-to 'settling_time_s<2.5'
    --vary controller.gains.sign_gain 0 1 --vary controller.gains.pose_gain 1 5

    Attributes:
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
    """

    minimize: Annotated[str, tyro.conf.arg(metavar="METRIC")]
    vary: Annotated[
        tuple[tuple[str, float, float], ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="FIELD LOW HIGH"),
    ]
    subject_to: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="BOUND")] = ()
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    metric: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FUNCTION")] = ()
    generations: Annotated[int, tyro.conf.arg(metavar="N")] = 10
    population: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    execution: ExecutionOptions = HERE

    def execute(self) -> int:
        """Search, print the best run, and return the exit code.

        Raises:
            FieldError: a field has two ranges, or a range and a value.
            CoopPinError: whatever ``tune`` raises.
        """
        scenario = self.loaded()
        fixed = changes(self.fields, scenario.cell.arms)
        folder = self.out or Path("out") / f"tune-{Path(self.scenario).stem}"
        ranges: dict[str, tuple[float, float]] = {}
        for field, low, high in self.vary:
            path = field_path(field, scenario.cell.arms)
            if path in ranges:
                raise FieldError("has two ranges; give it one", path)
            if path in fixed:
                raise FieldError("has a range and a value; give it one of them", path)
            ranges[path] = (low, high)
        result = sweeps.tune(
            scenario,
            ranges,
            minimize=self.minimize,
            subject_to=self.subject_to,
            out=folder,
            metrics=self.metric,
            generations=self.generations,
            population=self.population,
            seed=self.seed,
            execution=self.execution,
        )
        if not self.execution.quiet:
            print(result.summary())
            best = result.tuned.items()
            words = [word for field, typed in self.fields.items() for word in (f"--{field}", *typed)]
            words += [word for field, value in best for word in (f"--{field}", repr(value))]
            print("run it: " + shlex.join(["coop-pin", "run", self.scenario, *words]))
            print("all runs: " + shlex.join(["coop-pin", "sweep-show", str(folder)]))
            print(f"written to {folder}")
        return OK
