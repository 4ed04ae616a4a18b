"""Sweep plan: the scenarios of a sweep and the fields that vary; nothing about how it is executed."""

from __future__ import annotations

import functools
import math
import sys
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from coop_pin.base.arrays import require_path
from coop_pin.base.errors import FieldError, NameNotFoundError, ScenarioError, UnknownFieldError, one_or_all
from coop_pin.base.schema.base import Description
from coop_pin.base.schema.user_code import FunctionName, code_named
from coop_pin.base.user_files import read_toml
from coop_pin.compiled.engines import Engine, engine_named
from coop_pin.description.scenario import Scenario
from coop_pin.stability.step_size import AUTO, AUTO_ERROR, STEPS_FIELD
from coop_pin.sweeps.dimensions import Dimension, Sample, Values

COLUMNS = ("number", "status", "failure", "message", "failed_at_s", "merged", "wall_s", "cpu_s", "key")
"""Columns that the table of every sweep has beside metrics and varied fields."""


def _scenarios(argument: Any) -> Any:
    """Return scenarios by name, from a scenario, its name or path, several of these, or a table of them."""
    if isinstance(argument, str | Path | Scenario):
        argument = [argument]
    if isinstance(argument, Mapping):
        return {str(name): _scenario(entry) for name, entry in argument.items()}
    if not isinstance(argument, Sequence) or not argument:
        raise FieldError(f"is {argument!r}; it must be a scenario, its name or path, or several of them")
    scenarios = [_scenario(entry) for entry in argument]
    named = {scenario.name: scenario for scenario in scenarios}
    if len(named) < len(scenarios):
        raise FieldError("has several scenarios of one name; give each a name: {first = ..., second = ...}")
    return named


def _scenario(argument: Any) -> Scenario:
    loaded = Scenario(**argument) if isinstance(argument, Mapping) else argument
    return loaded if isinstance(loaded, Scenario) else Scenario.load(loaded)


Bases = Annotated[dict[str, Scenario], BeforeValidator(_scenarios), Field(min_length=1)]
"""Scenarios by name."""
Cases = Annotated[dict[str, dict[str, Any]], Field(min_length=1)]
"""Named groups of changes."""


def _cases_by_dimension(argument: Any) -> Any:
    """Return dimensions of cases; cases without one, {"late": {"seed": 1}}, are the dimension "case"."""
    if not isinstance(argument, Mapping) or not argument:
        return argument
    groups = list(argument.values())
    if all(isinstance(group, Mapping) and group for group in groups):
        tables = [table for group in groups for table in group.values()]
        is_deep = all(isinstance(table, Mapping) for table in tables)
        if is_deep and (all(map(_names_fields, tables)) or not all(map(_names_fields, groups))):
            return argument
    return {"case": argument}


def _names_fields(table: Mapping[str, Any]) -> bool:
    """Return whether the keys of a table are fields of a scenario, by dotted path."""
    return all(str(path).partition(".")[0] in Scenario.model_fields for path in table)


def _anchored(base: Any, folder: Path) -> Any:
    """Return scenarios as written in a plan's file, with absolute paths of files in its folder."""
    if isinstance(base, Mapping):
        return dict(zip(base, _anchored(list(base.values()), folder), strict=True))
    if isinstance(base, list):
        return [entry if isinstance(entry, dict | list) else _anchored(entry, folder) for entry in base]
    return str((folder / base).resolve()) if isinstance(base, str) and (folder / base).is_file() else base


def _is_plain(values: Sequence[Any]) -> bool:
    """Return whether values are numbers or rows of them, as those of samples, which are not made here."""
    if not isinstance(values, tuple):
        return True
    return not any(isinstance(value, str | Mapping | Description) for value in values)


class Point(NamedTuple):
    """One run of a plan.

    Attributes:
        number: number in the plan, counted from 0.
        base: name of its scenario.
        changes: changes of that scenario, by dotted path.
        places: place along each dimension.
        dimensions: dimensions of the plan.
    """

    number: int
    base: str
    changes: dict[str, Any]
    places: tuple[int, ...]
    dimensions: tuple[Dimension, ...]

    @property
    def parameters(self) -> dict[str, Any]:
        """Coordinates: the label along every dimension and the value of every varied field."""
        parameters = dict[str, Any]()
        for dimension, position in zip(self.dimensions, self.places, strict=True):
            parameters |= dimension.labels(position)
        return parameters


class SweepPlan(Description):
    """Sweep plan: the product of everything that varies, the last dimension running fastest.

    Points are computed when needed: the size of a plan costs no memory, but for the values of its fields.

    Attributes:
        base: a scenario, its name or path, a list of them, or a table of them by name.
        changes: fields changed in every run, by dotted path.
        cases: named groups of changes, {"paper": {}, "late": {"controller.force_path.kind": "late"}}: one
            dimension, "case". Several dimensions have names: {"law": {...}, "payload": {...}}.
        axes: the values of single fields: a list, {linspace = [first, last, count]}, {logspace = [first,
            last, count]} or {range = [start, stop, step]}.
        zipped: groups of fields that vary together.
        sample: points over the ranges of several fields.
        metrics: user functions, "module:function", that take a RunResult and return numbers by name.
        time_limit_s: wall time after which a run is aborted, s; a batch may take the sum of its runs, and is
            then simulated in halves, at last singly.
        memory_limit_gb: memory of a worker, or of the samples of a batch, GB; a run that needs more fails. A
            single run in this process has no limit.
        keep: runs whose full results are stored: their places in the plan, or "all", or "none".
        engine: "pinocchio" or "mujoco", each run alone; "compiled", runs of one kind together, or each alone
            on a compiled plant if the first run's law cannot be compiled, and on Pinocchio those that cannot
            be either; or "auto": "compiled" if the first run can be together with others and there are enough
            of them to be worth compiling, decided when the sweep first starts.
        steps_error_m: limit of the error with which "auto" as ``clock.steps_per_tick`` in ``changes`` is
            chosen, m; see ``fewest_steps``.
        repeats: number of runs of each point, with the scenario's ``seed`` 0, 1, 2, ...: the last dimension
            of the plan. With 1 the scenario keeps its own seed.
    """

    base: Bases
    changes: dict[str, Any] = Field(default_factory=dict)
    cases: Annotated[dict[str, Cases], BeforeValidator(_cases_by_dimension)] = Field(default_factory=dict)
    axes: dict[str, Values] = Field(default_factory=dict)
    zipped: tuple[Annotated[dict[str, Values], Field(min_length=1)], ...] = ()
    sample: Sample | None = None
    metrics: tuple[FunctionName, ...] = ()
    time_limit_s: float = Field(default=600.0, gt=0.0)
    memory_limit_gb: float = Field(default=4.0, gt=0.0)
    keep: str | tuple[int, ...] = "none"
    engine: Annotated[Engine, BeforeValidator(engine_named)] = "auto"
    steps_error_m: float = Field(default=AUTO_ERROR, gt=0.0)
    repeats: int = Field(default=1, ge=1)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for dimension in self.dimensions:
            lengths = {field: len(values) for field, values in dimension.fields.items()}
            if len(set(lengths.values())) > 1:
                raise FieldError(f"has fields with {lengths} values; they need equally many", "zipped")
        fields = [field for dimension in self.dimensions for field in dimension.fields]
        reserved = [name for name in self.cases if name in (*COLUMNS, "base", "sample")]
        if twice := [*reserved, *(field for field, count in Counter(fields).items() if count > 1)]:
            raise FieldError(f"varies {twice[0]!r} twice, or reserves it; vary every field in one place only")
        if (size := math.prod(self.shape)) > sys.maxsize:
            raise FieldError(f"has {size:.3g} runs; let fewer fields vary")
        for run in () if self.keep in ("all", "none") else self.keep:
            if isinstance(run, str) or not -size <= run < size:
                form = f"'all', 'none' or numbers of runs, of which there are {size}, counted from 0"
                raise FieldError(f"is {self.keep!r}; it must be {form}", "keep")
        for (
            scenario
        ) in self._tried.values():  # values that it refuses fail in their runs: one may search a limit
            problems = scenario.problems if isinstance(scenario, ScenarioError) else ()
            if unknown := [problem for problem in problems if isinstance(problem, UnknownFieldError)]:
                raise one_or_all(unknown, "the plan") from None
        return self

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a plan from a TOML file; paths of scenarios in it are relative to the file.

        Raises:
            NameNotFoundError: there is no such file, or no such scenario.
            FileReadError: it is not TOML.
            ScenarioError: it has mistakes.
        """
        require_path("path", path)
        path = Path(path)
        if not path.is_file():
            raise NameNotFoundError("sweep file", str(path), [], "the file system")
        data = read_toml(path, kind="a plan of a sweep")
        return cls(**data | {"base": _anchored(data.get("base"), path.parent)})

    # ------------------------------------------------------------ points

    @functools.cached_property
    def dimensions(self) -> tuple[Dimension, ...]:
        """The dimensions; the last one runs fastest."""
        bases: dict[str, Cases] = {"base": {name: {} for name in self.base}} if len(self.base) > 1 else {}
        dimensions = [
            Dimension({name: tuple(cases)}, "cases", cases) for name, cases in (bases | self.cases).items()
        ]
        dimensions += [Dimension({field: values}) for field, values in self.axes.items()]
        dimensions += map(Dimension, self.zipped)
        dimensions += [] if self.sample is None else [self.sample.dimension()]
        dimensions += [Dimension({"seed": range(self.repeats)})] if self.repeats > 1 else []
        return tuple(dimensions)

    @functools.cached_property
    def shape(self) -> tuple[int, ...]:
        """Size of each dimension."""
        return tuple(dimension.size for dimension in self.dimensions)

    def places(self, index: int) -> tuple[int, ...]:
        """Return the place of a run along each dimension."""
        return tuple(map(int, np.unravel_index(index, self.shape)))

    def __len__(self) -> int:
        """Return the number of runs."""
        return math.prod(self.shape)

    def __getitem__(self, index: int) -> Point:
        """Return one point with all that is overridden in its run; negative places count from the end."""
        if not -(size := len(self)) <= index < size:
            raise IndexError(f"point {index} of a plan with {size}")
        number, dimensions, changes = index % size, self.dimensions, self.changes.copy()
        places = self.places(number)
        for dimension, position in zip(dimensions, places, strict=True):
            changes |= dimension.changes(position)
        # Several scenarios are the first dimension.
        base = dimensions[0].fields["base"][places[0]] if len(self.base) > 1 else next(iter(self.base))
        return Point(number, base, changes, places, dimensions)

    def points(self, numbers: Iterable[int] | None = None) -> Iterator[Point]:
        """Yield points by their numbers, all in order when these are omitted."""
        return map(self.__getitem__, range(len(self)) if numbers is None else numbers)

    @functools.cached_property
    def has_open_steps(self) -> bool:
        """Whether the number of plant steps is still to be chosen; until then scenarios have their own."""
        varied = {field for dimension in self.dimensions for field in dimension.fields}
        return self.changes.get(STEPS_FIELD) == AUTO and STEPS_FIELD not in varied

    def scenario(self, index: int) -> Scenario:
        """Return the scenario of one point.

        Raises:
            ScenarioError: the changed scenario has mistakes.
        """
        scenario = self.resolved(self[index])
        if isinstance(scenario, ScenarioError):
            raise scenario
        return scenario

    def resolved(self, point: Point) -> Scenario | ScenarioError:
        """Return the scenario of one point, or the mistakes in it."""
        return self._tried[point.number] if point.number in self._tried else self._overridden(point)

    def _overridden(self, point: Point) -> Scenario | ScenarioError:
        changes = point.changes
        if self.has_open_steps:  # the scenario's own number
            changes = {field: value for field, value in changes.items() if field != STEPS_FIELD}
        try:
            return self.base[point.base].override(changes) if changes else self.base[point.base]
        except ScenarioError as error:
            return error

    @functools.cached_property
    def _tried(self) -> dict[int, Scenario | ScenarioError]:
        """Scenarios of the first point, and of every case, table or text, which are validated once."""
        trials, stride = {0}, len(self)
        for dimension in self.dimensions:
            stride //= dimension.size
            is_plain = dimension.cases is None and all(map(_is_plain, dimension.fields.values()))
            trials |= set() if is_plain else set(range(0, dimension.size * stride, stride))
        return {index: self._overridden(self[index]) for index in sorted(trials)}

    def code_named(self) -> Iterator[tuple[str, str]]:
        """Yield field and name, "module:name", of the code that the plan and its scenarios name."""
        yield from code_named(self)
        for number, scenario in self._tried.items():
            yield from ((f"{path} ({number})", name) for path, name in code_named(scenario))

    def part(self, cases: Collection[str], engine: Engine) -> Self:
        """Return the plan of some of the cases that are its first dimension, by another engine.

        Nothing is validated again.
        """
        ((name, entries),) = self.cases.items()
        repeats, numbers = len(self) // len(entries), [n for n, case in enumerate(entries) if case in cases]
        scenarios = {index * repeats: self._tried[n * repeats] for index, n in enumerate(numbers)}
        subset = {name: {case: changes for case, changes in entries.items() if case in cases}}
        part = self.model_copy(update={"cases": subset, "engine": engine, "_tried": scenarios})
        for name in ("dimensions", "shape"):
            vars(part).pop(name, None)
        return part

    def keeps(self, index: int) -> bool:
        """Return whether the full result of a point is stored."""
        if isinstance(self.keep, str):
            return self.keep == "all"
        return index in self.keep or index - len(self) in self.keep

    def summary(self) -> str:
        """Return the scenarios, the dimensions and the number of runs as text."""
        sizes = " x ".join(map(str, self.shape)) or "1"
        total = f"{sizes} = {len(self)} runs" if len(self.shape) > 1 else f"{len(self)} runs"
        total += {"auto": ""}.get(self.engine, f", engine {self.engine}")
        lines = [f"sweep of {', '.join(self.base)}: {total}"]
        width = max((len(dimension.name) for dimension in self.dimensions), default=0)
        lines += [f"  {dimension.name:<{width}}  {dimension.summary()}" for dimension in self.dimensions]
        return "\n".join(lines + [f"  {field} = {value}" for field, value in self.changes.items()])
