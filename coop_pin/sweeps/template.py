"""Templates of scenarios of a sweep: validated once, with holes for the plain numbers in which runs differ.

A number is plain if nothing but its own field, or the class that holds it, looks at it while a scenario is
validated and written. That is tried: something that cannot be read takes its place, and all classes around
it validate and write it. What none of them reads, none of them can depend on.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from pydantic import BaseModel, TypeAdapter

from coop_pin.base.errors import ScenarioError
from coop_pin.base.schema.parts import Pattern, Tree, fields_of, part_of, refilled, tree_of, with_parts
from coop_pin.description.scenario import Scenario
from coop_pin.sweeps.dimensions import Dimension
from coop_pin.sweeps.plan import Point, SweepPlan

_FEWEST, _MOST = 16, 64
"""Runs of a template from which on it pays, and templates that are kept."""
_VALUES = 4096
"""Validated values of a field that are kept."""


class Number(NamedTuple):
    """Number that a field takes.

    Attributes:
        value: number.
        text: number as JSON.
    """

    value: Any
    text: bytes


class _Hole:
    """Stand-in for a number that nothing may read; whatever does raises TypeError."""

    def __init__(self, index: int) -> None:
        object.__setattr__(self, "mark", f"coop_pin number {index} ")

    def _refuse(self, *_: object) -> Any:
        raise TypeError("is read")

    __class__ = property(_refuse)
    __eq__ = __hash__ = __bool__ = __repr__ = __array__ = _refuse  # it has no other operations


class Template:
    """Template of scenarios that differ in plain numbers.

    Attributes:
        pattern: pattern of the scenarios; its numbers are in the order of ``texts``.
        texts: JSON before, between and after the numbers.
    """

    def __init__(self, first: Scenario, names: Sequence[str]) -> None:
        """Try whether numbers are plain.

        Args:
            first: One of the scenarios.
            names: Dotted paths of the numbers.

        Raises:
            TypeError, LookupError, AttributeError, ScenarioError: They are not.
        """
        holes = {name: _Hole(index) for index, name in enumerate(names)}
        with_holes = _tried(first, tree_of(holes))
        text = with_holes.__pydantic_serializer__.to_json(with_holes, warnings=False, fallback=_mark).decode()
        marks = {name: json.dumps(_mark(hole)) for name, hole in holes.items()}
        self.texts = list[str]()
        self.pattern = Pattern(first, tuple(sorted(names, key=lambda name: text.index(marks[name]))))
        for name in self.pattern.names:
            before, text = text.split(marks[name])
            self.texts.append(before)
        self.texts.append(text)
        self._checks = {name: _check(first, name) for name in self.pattern.names}

    def numbers(self, changes: Mapping[str, Any]) -> list[Number] | None:
        """Return the numbers of a run, validated; None if a field refuses one."""
        try:
            return [check(changes[name]) for name, check in self._checks.items()]
        except (ValueError, ScenarioError):
            return None

    def scenario(self, numbers: Sequence[Number]) -> Scenario:
        """Return the scenario of a run."""
        return cast(Scenario, self.pattern.filled([number.value for number in numbers]))

    def text(self, numbers: Iterable[Number]) -> str:
        """Return the scenario of a run as JSON."""
        pairs = zip(numbers, self.texts[1:], strict=True)
        return self.texts[0] + "".join(number.text.decode() + text for number, text in pairs)

    def agrees(self, run: Scenario | ScenarioError, changes: Mapping[str, Any]) -> bool:
        """Return whether a run that was validated as a whole is as the template has it."""
        numbers = self.numbers(changes)
        return numbers is None or (
            isinstance(run, Scenario)
            and run == self.scenario(numbers)
            and run.model_dump_json() == self.text(numbers)
        )


class Templates:
    """Templates of a plan, made as they are needed."""

    def __init__(self, plan: SweepPlan) -> None:
        """Look at the dimensions: those of numbers may vary within a template."""
        self._plan, self._shape = plan, plan.shape
        axes = [axis for axis, each in enumerate(plan.dimensions) if _is_of_numbers(each)]
        self._numbers = axes if math.prod(self._shape[axis] for axis in axes) >= _FEWEST else []
        self._others = [axis for axis in range(len(self._shape)) if axis not in self._numbers]
        self._plain, self._made = dict[Any, list[int]](), dict[Any, Template | None]()

    def of(self, point: Point) -> Template | None:
        """Return the template of a run; None if it must be validated by itself."""
        if not self._numbers:
            return None
        others = tuple([point.places[axis] for axis in self._others])
        if others not in self._plain and isinstance(first := self._plan.resolved(point), Scenario):
            self._plain[others] = [axis for axis in self._numbers if self._template(first, [axis])]
        plain = self._plain.get(others, [])
        key = tuple([position for axis, position in enumerate(point.places) if axis not in plain])
        if key not in self._made:
            while len(self._made) >= _MOST:
                del self._made[next(iter(self._made))]
            self._made[key] = self._checked(point, plain)
        return self._made[key]

    def _template(self, first: Scenario, axes: Iterable[int]) -> Template | None:
        """Return the template of runs along some dimensions; None if a number is not plain."""
        names = [name for axis in axes for name in self._plan.dimensions[axis].varied]
        try:
            return Template(first, names)
        except (TypeError, LookupError, AttributeError, ValueError, ScenarioError):
            return None

    def _checked(self, point: Point, axes: Sequence[int]) -> Template | None:
        """Return the template of runs along some dimensions, if it agrees with the runs at their ends."""
        first = self._plan.resolved(point)
        if not isinstance(first, Scenario) or math.prod(self._shape[axis] for axis in axes) < _FEWEST:
            return None
        template = self._template(first, axes)
        for end in (0, -1):
            ends = {axis: self._plan.dimensions[axis].ends()[end] for axis in axes}
            corner = [ends.get(axis, position) for axis, position in enumerate(point.places)]
            run = self._plan[int(np.ravel_multi_index(corner, self._shape))]
            if template is not None and not template.agrees(self._plan.resolved(run), run.changes):
                return None
        return template


def _is_of_numbers(dimension: Dimension) -> bool:
    return dimension.cases is None and all(
        type(value) in (int, float) for values in dimension.varied.values() for value in values
    )


def _tried(node: Any, tree: Tree) -> Any:
    """Return a copy of an object with holes; classes around those with a hole validate it anew."""
    inner = {name: _tried(part_of(node, name), part) for name, part in tree.items() if type(part) is dict}
    if inner and isinstance(node, BaseModel):
        node = type(node)(**fields_of(node) | inner)
    elif inner:
        node = with_parts(node, inner)
    holes = {name: hole for name, hole in tree.items() if name not in inner}
    if holes and not isinstance(node, BaseModel):
        raise LookupError("a number in a table or a row")
    return with_parts(node, holes) if holes else node


def _mark(hole: Any) -> str:
    """Return the text that is written for a hole."""
    return str(object.__getattribute__(hole, "mark"))


def _check(scenario: Scenario, path: str) -> Callable[[Any], Number]:
    """Return the validation of a number by its field, or by the class that holds it if that has validators.

    Raises:
        LookupError: What the class writes may depend on the number.
    """
    *names, name = path.split(".")
    owner = functools.reduce(part_of, names, scenario)
    kind, rules = type(owner), type(owner).__pydantic_decorators__
    if owner is scenario and path != "seed":  # which no validator of a scenario looks at
        raise LookupError("is read with other fields of the scenario")
    field, fields = kind.model_fields[name], fields_of(owner)
    annotation: Any = Annotated[(field.annotation, *field.metadata, None)]
    adapter = TypeAdapter(annotation, config=kind.model_config)

    def by_class(value: Any) -> Any:
        made = kind(**fields | {name: value})
        if made != refilled(owner, {name: part_of(made, name)}):
            raise ValueError("changes others")
        return part_of(made, name)

    is_plain = owner is scenario or not (rules.model_validators or rules.field_validators)
    validated = adapter.validator.validate_python if is_plain else by_class

    @functools.lru_cache(_VALUES, typed=True)
    def check(value: Any) -> Number:
        number = validated(value)
        if type(number) not in (int, float):
            raise ValueError("is no number")
        return Number(number, adapter.serializer.to_json(number))

    return check
