"""What a sweep runs: scenarios, what varies, and nothing about how or where."""

from __future__ import annotations

import functools
import math
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

from pydantic import BeforeValidator, Field, PrivateAttr, field_validator, model_validator

from coop_pin.description.scenario import Scenario
from coop_pin.errors import (
    EntryNotFoundError,
    FieldError,
    FieldShapeError,
    ScenarioError,
    ScenarioFileError,
    UnknownFieldError,
    one_or_all,
)
from coop_pin.schema.base import Description
from coop_pin.schema.user_code import FunctionName
from coop_pin.sweeps.dimensions import (
    CasesDimension,
    Dimension,
    FieldsDimension,
    RepeatDimension,
    SampleDimension,
    Values,
)
from coop_pin.sweeps.sampling import Sample


def _scenarios(given: Any) -> Any:
    """Return scenarios by name from a scenario, the name or path of one, several of these, or a table of them."""
    if isinstance(given, str | Path | Scenario):
        given = [given]
    if isinstance(given, Mapping):
        return {str(name): _scenario(entry) for name, entry in given.items()}
    if not isinstance(given, Sequence) or not given:
        raise FieldError(f"is {given!r}; it must be a scenario, its name or path, or several of them")
    scenarios = [_scenario(entry) for entry in given]
    twice = [name for name, count in Counter(entry.name for entry in scenarios).items() if count > 1]
    if twice:
        raise FieldError(
            f"has several scenarios named {twice[0]!r}; give them names of their own: {{first = ..., second = ...}}"
        )
    return {scenario.name: scenario for scenario in scenarios}


def _scenario(given: Any) -> Scenario:
    if isinstance(given, Scenario):
        return given
    return Scenario.from_dict(dict(given)) if isinstance(given, Mapping) else Scenario.load(given)


Bases = Annotated[dict[str, Scenario], BeforeValidator(_scenarios), Field(min_length=1)]
"""Scenarios by name."""


def anchored(base: Any, folder: Path) -> Any:
    """Return scenarios as written in a file, with paths of files that exist beside it made whole."""
    if isinstance(base, str):
        return str((folder / base).resolve()) if (folder / base).is_file() else base
    if isinstance(base, Mapping):
        return {
            name: anchored(entry, folder) if isinstance(entry, str) else entry for name, entry in base.items()
        }
    return [anchored(entry, folder) for entry in base] if isinstance(base, list) else base


class Point(NamedTuple):
    """One run of a plan.

    Attributes:
        number: its place in the plan, counted from 0.
        base: name of its scenario.
        changes: what is changed in it, by dotted path.
        parameters: what a table shows of it: the label of every dimension and the value of every varied
            field.
    """

    number: int
    base: str
    changes: dict[str, Any]
    parameters: dict[str, Any]


class SweepPlan(Description):
    """What a sweep runs. Everything that varies is crossed with everything else, the last dimension running fastest.

    A plan computes its points when asked for them: its size costs no memory.

    Attributes:
        base: a scenario, its name or path, a list of them, or a table of them by name.
        changes: fields changed in every run, by dotted path.
        cases: dimensions of named bundles of changes: {"controller": {"paper": {}, "late":
            {"controller.force_path.kind": "late"}}}.
        axes: the values of single fields: a list, {linspace = [first, last, count]}, {logspace = [first,
            last, count]} or {range = [start, stop, step]}.
        zipped: groups of fields that move together.
        sample: points spread over ranges of fields.
        repeats: how often each point is run, with seeds counted up from the scenario's.
        metrics: functions of the user's own, "module:function", that take a RunResult and return a table of
            numbers by name.
        time_limit_s: wall time after which a run is given up, s.
        keep: which runs are kept as full results, by their place in the plan, or "all", or "none".
    """

    base: Bases
    changes: dict[str, Any] = Field(default_factory=dict)
    cases: dict[str, dict[str, dict[str, Any]]] = Field(default_factory=dict)
    axes: dict[str, Values] = Field(default_factory=dict)
    zipped: tuple[dict[str, Values], ...] = ()
    sample: Sample | None = None
    repeats: int = Field(default=1, ge=1)
    metrics: tuple[FunctionName, ...] = ()
    time_limit_s: float = Field(default=600.0, gt=0.0)
    keep: str | tuple[int, ...] = "none"
    _dimensions: tuple[Dimension, ...] = PrivateAttr(default=())

    @field_validator("zipped")
    @classmethod
    def _of_one_length(cls, groups: tuple[dict[str, Values], ...]) -> tuple[dict[str, Values], ...]:
        for index, group in enumerate(groups):
            lengths = {field: len(values) for field, values in group.items()}
            if len(set(lengths.values())) != 1:
                raise FieldShapeError(
                    f"has fields with {lengths} values; fields that move together need equally many",
                    str(index),
                )
        return groups

    @field_validator("cases")
    @classmethod
    def _not_empty(cls, cases: dict[str, dict[str, dict[str, Any]]]) -> dict[str, dict[str, dict[str, Any]]]:
        for name, entries in cases.items():
            if not entries or name in ("base", "sample", "repeat", "point"):
                raise FieldError(
                    "must have at least one case"
                    if not entries
                    else "is a name that plans use themselves; choose another",
                    name,
                )
        return cases

    @field_validator("keep")
    @classmethod
    def _known(cls, keep: str | tuple[int, ...]) -> str | tuple[int, ...]:
        if isinstance(keep, str) and keep not in ("all", "none"):
            raise FieldError(f"is {keep!r}; it must be 'all', 'none' or a list of places in the plan")
        return keep

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._dimensions = tuple(self._built())
        fields = [
            *self.axes,
            *(f for group in self.zipped for f in group),
            *(self.sample.fields if self.sample else ()),
        ]
        twice = [field for field, count in Counter([*fields, *self.cases]).items() if count > 1]
        if twice:
            raise FieldError(f"varies {twice[0]!r} twice; let every field vary in one place only")
        beyond = [
            place for place in self.keep if not isinstance(place, str) and not -len(self) <= place < len(self)
        ]
        if beyond:
            raise FieldError(f"names run {beyond[0]}; the plan has {len(self)} runs, counted from 0", "keep")
        self._require_known_fields()
        return self

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a plan from a TOML file. Paths of scenarios in it are relative to it.

        Raises:
            EntryNotFoundError: there is no such file, or no such scenario.
            ScenarioFileError: it is not TOML.
            ScenarioError: it has mistakes.
        """
        path = Path(path)
        if not path.is_file():
            raise EntryNotFoundError("sweep file", str(path), [], "the file system")
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ScenarioFileError(f"{path} is not a TOML file: {error}") from None
        return cls(**data | {"base": anchored(data.get("base"), path.parent)})

    # ------------------------------------------------------------ points

    @property
    def dimensions(self) -> tuple[Dimension, ...]:
        """What varies; the last runs fastest."""
        return self._dimensions

    @property
    def shape(self) -> tuple[int, ...]:
        """Size of each dimension."""
        return tuple(dimension.size for dimension in self._dimensions)

    def __len__(self) -> int:
        """Return the number of runs."""
        return math.prod(self.shape)

    def __getitem__(self, index: int) -> Point:
        """Return one point; negative places count from the end."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"point {index} of a plan with {len(self)}")
        index %= len(self)
        changes, parameters = dict(self.changes), dict[str, Any]()
        for dimension, place in zip(self._dimensions, self.places(index), strict=True):
            changes |= dimension.changes(place)
            parameters |= dimension.labels(place)
        base = str(parameters.get("base", next(iter(self.base))))
        if self.repeats > 1:
            changes["seed"] = changes.get("seed", self.base[base].seed) + parameters["repeat"]
        return Point(index, base, changes, parameters)

    def places(self, index: int) -> tuple[int, ...]:
        """Return the place of a point along each dimension."""
        places: list[int] = []
        for size in reversed(self.shape):
            index, place = divmod(index, size)
            places.insert(0, place)
        return tuple(places)

    def points(self) -> Iterator[Point]:
        """Yield the points one by one."""
        return map(self.__getitem__, range(len(self)))

    def scenario(self, index: int) -> Scenario:
        """Return the scenario of one point.

        Raises:
            ScenarioError: the changes make no scenario.
        """
        point = self[index]
        return self.base[point.base].override(point.changes) if point.changes else self.base[point.base]

    def keeps(self, index: int) -> bool:
        """Say whether the full result of a point is kept."""
        return self.keep == "all" or (not isinstance(self.keep, str) and index in self._kept)

    @functools.cached_property
    def _kept(self) -> frozenset[int]:
        return frozenset(range(len(self))[int(index)] for index in self.keep)

    def summary(self) -> str:
        """Return what is run and how often, for people."""
        sizes = " x ".join(map(str, self.shape)) or "1"
        total = f"{sizes} = {len(self)} runs" if len(self.shape) > 1 else f"{len(self)} runs"
        lines = [f"sweep of {', '.join(self.base)}: {total}"]
        width = max((len(dimension.name) for dimension in self._dimensions), default=0)
        lines += [f"  {dimension.name:<{width}}  {dimension.describe()}" for dimension in self._dimensions]
        return "\n".join(lines + [f"  {field} = {value}" for field, value in self.changes.items()])

    def __str__(self) -> str:
        return self.summary()

    # ------------------------------------------------------------ checks

    def _built(self) -> Iterator[Dimension]:
        if len(self.base) > 1:
            yield CasesDimension("base", {name: {} for name in self.base})
        for name, cases in self.cases.items():
            yield CasesDimension(name, cases)
        for field, values in self.axes.items():
            yield FieldsDimension({field: values})
        yield from map(FieldsDimension, self.zipped)
        if self.sample is not None:
            yield SampleDimension(self.sample)
        if self.repeats > 1:
            yield RepeatDimension(self.repeats)

    def _require_known_fields(self) -> None:
        """Refuse misspelt fields now, not in every run: the first place of every dimension and every case is tried.

        Values that a scenario refuses are left to the runs: where they begin may be what the sweep looks for.
        """
        trials = {0}
        stride = len(self)
        for dimension in self._dimensions:
            stride //= dimension.size
            if isinstance(dimension, CasesDimension):
                trials |= {place * stride for place in range(dimension.size)}
        for index in sorted(trials):
            try:
                self.scenario(index)
            except ScenarioError as error:
                unknown = [problem for problem in error.problems if isinstance(problem, UnknownFieldError)]
                if unknown:
                    raise one_or_all(unknown, "the plan") from None
