"""The dimensions of a plan: what varies along each, and how it changes a scenario."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator

from coop_pin.errors import FieldError
from coop_pin.sweeps.sampling import Sample

_SPACINGS = ("linspace", "logspace", "range")


def linspace(first: float, last: float, count: int) -> dict[str, list[float]]:
    """Say ``count`` numbers evenly spaced from first to last, both included."""
    return {"linspace": [first, last, count]}


def logspace(first: float, last: float, count: int) -> dict[str, list[float]]:
    """Say ``count`` numbers in equal ratios from first to last, both included (the numbers themselves, not their exponents)."""
    return {"logspace": [first, last, count]}


def _values(given: Any) -> tuple[Any, ...]:
    """Return the values as written, or those that ``{linspace = [first, last, count]}`` and its kind stand for."""
    if isinstance(given, Mapping):
        return _spaced(given)
    if isinstance(given, np.ndarray | range):
        given = given.tolist() if isinstance(given, np.ndarray) else list(given)
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise FieldError(
            f"is {given!r}; it must be a list with at least one value, or one of {', '.join(_SPACINGS)} = [...]"
        )
    return tuple(given)


def _spaced(given: Mapping[str, Any]) -> tuple[Any, ...]:
    kind, numbers = next(iter(given.items())) if len(given) == 1 else ("", ())
    if kind not in _SPACINGS:
        raise FieldError(
            f"is {dict(given)!r}; it must be one of {{{' = [...]}, {'.join(_SPACINGS)} = [...]}}"
        )
    if (
        not isinstance(numbers, Sequence)
        or len(numbers) != 3
        or not all(isinstance(n, int | float) for n in numbers)
    ):
        wanted = "[start, stop, step]" if kind == "range" else "[first, last, count]"
        raise FieldError(f"is {numbers!r}; it must be three numbers {wanted}", kind)
    first, last, third = numbers
    if kind == "range":
        return _range(first, last, third)
    if not isinstance(third, int) or third < 1:
        raise FieldError(f"counts {third!r}; the count must be a whole number of at least 1", kind)
    if kind == "linspace":
        return tuple(np.linspace(first, last, third).tolist())
    if first <= 0.0 or last <= 0.0:
        raise FieldError(f"goes from {first:g} to {last:g}; a logarithmic scale needs positive ends", kind)
    return tuple(np.geomspace(first, last, third).tolist())


def _range(start: float, stop: float, step: float) -> tuple[Any, ...]:
    """Return start, start + step, ... up to stop, which is not included."""
    count = math.ceil((stop - start) / step - 1e-9) if step else 0
    if count < 1:
        raise FieldError(
            f"from {start:g} to {stop:g} in steps of {step:g} is empty; its step must lead from start to stop",
            "range",
        )
    return tuple(start + i * step for i in range(count))


Values = Annotated[tuple[Any, ...], BeforeValidator(_values)]
"""What one field takes, one after the other."""


def label(value: Any) -> Any:
    """Return a value as it can stand on an axis: numbers, texts and truth values themselves, others as JSON text."""
    if isinstance(value, str | int | float | bool):
        return value
    return json.dumps(
        value,
        default=lambda entry: entry.model_dump(mode="json") if hasattr(entry, "model_dump") else str(entry),
    )


class FieldsDimension(NamedTuple):
    """One field, or several that move together; the first gives the dimension its name.

    Attributes:
        fields: the values of each field, all of one length.
    """

    fields: Mapping[str, tuple[Any, ...]]

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return next(iter(self.fields))

    @property
    def size(self) -> int:
        """Number of places."""
        return len(self.fields[self.name])

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields at one place."""
        return {field: values[place] for field, values in self.fields.items()}

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one place."""
        return {field: label(value) for field, value in self.changes(place).items()}

    def describe(self) -> str:
        """Return one line for people."""
        shown = [_short(label(value)) for value in self.fields[self.name][:6]]
        more = ", ..." if self.size > len(shown) else ""
        together = f" together with {', '.join(list(self.fields)[1:])}" if len(self.fields) > 1 else ""
        return f"{self.size} values: {', '.join(shown)}{more}{together}"


class CasesDimension(NamedTuple):
    """Named bundles of changes: controllers, payloads, anything that takes more than one field to say.

    Attributes:
        name: name of the dimension.
        cases: the changes of each case by its name.
    """

    name: str
    cases: Mapping[str, Mapping[str, Any]]

    @property
    def size(self) -> int:
        """Number of cases."""
        return len(self.cases)

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields of one case."""
        return dict(list(self.cases.values())[place])

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one case."""
        return {self.name: list(self.cases)[place]}

    def describe(self) -> str:
        """Return one line for people."""
        return f"{self.size} cases: {', '.join(self.cases)}"


class SampleDimension(NamedTuple):
    """Sampled points, numbered.

    Attributes:
        sample: the points.
    """

    sample: Sample

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return "sample"

    @property
    def size(self) -> int:
        """Number of points."""
        return len(self.sample)

    def changes(self, place: int) -> dict[str, Any]:
        """Return the changed fields at one point."""
        return dict(self.sample.point(place))

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one point."""
        return {"sample": place, **self.sample.point(place)}

    def describe(self) -> str:
        """Return one line for people."""
        ranges = (f"{name} in [{span.low:g}, {span.high:g}]" for name, span in self.sample.fields.items())
        return f"{self.size} {self.sample.method} points over {', '.join(ranges)}"


class RepeatDimension(NamedTuple):
    """The same again with the next seeds.

    Attributes:
        size: how often.
    """

    size: int

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return "repeat"

    def changes(self, place: int) -> dict[str, Any]:
        """Return nothing: the seed depends on the scenario, and the plan counts it up."""
        return {}

    def labels(self, place: int) -> dict[str, Any]:
        """Return what a table shows of one repeat."""
        return {"repeat": place}

    def describe(self) -> str:
        """Return one line for people."""
        return f"{self.size} repeats, the seed counted up from the scenario's"


Dimension = FieldsDimension | CasesDimension | SampleDimension | RepeatDimension


def _short(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)
