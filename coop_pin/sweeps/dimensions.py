"""Dimensions of a sweep plan: the fields that vary along each, and their values."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator

from coop_pin.arrays import as_number, require_memory
from coop_pin.errors import FieldError
from coop_pin.sweeps.sampling import Sample


def linspace(first: float, last: float, count: int) -> list[float]:
    """Return count evenly spaced values from first to last, both included.

    Raises:
        FieldError: the count is not a whole number of at least 1.
    """
    ends = as_number("first", first), as_number("last", last)
    return [float(value) for value in np.linspace(*ends, _require_count(count))]


def logspace(first: float, last: float, count: int) -> list[float]:
    """Return count values in equal ratios from first to last, both included.

    first and last are values, not exponents.

    Raises:
        FieldError: the count is not a whole number of at least 1, or an end is not positive.
    """
    first, last = as_number("first", first), as_number("last", last)
    if first <= 0.0 or last <= 0.0:
        raise FieldError(f"goes from {first:g} to {last:g}; a logarithmic scale needs positive ends")
    return [float(value) for value in np.geomspace(first, last, _require_count(count))]


def _range(start: float, stop: float, step: float) -> list[float]:
    """Return start, start + step, ... up to stop, which is excluded."""
    count = math.ceil((stop - start) / step - 1e-9) if step else 0
    if count < 1:
        wanted = "the step must lead from start to stop"
        raise FieldError(f"from {start:g} to {stop:g} in steps of {step:g} is empty; {wanted}")
    return [start + i * step for i in range(count)]


def _require_count(count: Any) -> int:
    if not isinstance(count, int) or count < 1:
        raise FieldError(f"counts {count!r}; the count must be a whole number of at least 1")
    require_memory(f"{count} values", 64.0 * count if count < 1 << 60 else math.inf, "lower the count")
    return count


_SPACINGS = {"linspace": linspace, "logspace": logspace, "range": _range}


def _values(given: Any) -> tuple[Any, ...]:
    """Return the values of a list, or those of ``{linspace = [first, last, count]}`` and the like."""
    if isinstance(given, Mapping):
        return _spaced(given)
    if isinstance(given, np.ndarray | range):
        given = given.tolist() if isinstance(given, np.ndarray) else list(given)
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        wanted = f"a list with at least one value, or one of {', '.join(_SPACINGS)} = [...]"
        raise FieldError(f"is {given!r}; it must be {wanted}")
    return tuple(given)


def _spaced(given: Mapping[str, Any]) -> tuple[Any, ...]:
    kind, numbers = next(iter(given.items())) if len(given) == 1 else ("", ())
    if kind not in _SPACINGS:
        wanted = " = [...]}, {".join(_SPACINGS)
        raise FieldError(f"is {dict(given)!r}; it must be one of {{{wanted} = [...]}}")
    if (
        not isinstance(numbers, Sequence)
        or len(numbers) != 3
        or not all(isinstance(n, int | float) for n in numbers)
    ):
        wanted = "[start, stop, step]" if kind == "range" else "[first, last, count]"
        raise FieldError(f"is {numbers!r}; it must be three numbers {wanted}", kind)
    try:
        return tuple(_SPACINGS[kind](*numbers))
    except FieldError as error:
        raise error.below(kind) from None


Values = Annotated[tuple[Any, ...], BeforeValidator(_values)]
"""The values that a field takes, in order."""


def _label(value: Any) -> Any:
    """Return the coordinate of a value: a number, text or truth value itself, anything else as JSON text."""
    if isinstance(value, str | int | float | bool):
        return value
    return json.dumps(
        value,
        default=lambda entry: entry.model_dump(mode="json") if hasattr(entry, "model_dump") else str(entry),
    )


class FieldsDimension(NamedTuple):
    """Dimension of a plan: one field, or several that vary together, or named cases.

    Attributes:
        fields: the values of each field, all of one length; the first one names the dimension.
        cases: named groups of changes, such as controllers or payloads that take several fields to describe;
            the values of the only field are then their names.
    """

    fields: Mapping[str, tuple[Any, ...]]
    cases: Mapping[str, Mapping[str, Any]] | None = None

    @classmethod
    def of_cases(cls, name: str, cases: Mapping[str, Mapping[str, Any]]) -> FieldsDimension:
        """Return the dimension of named cases."""
        return cls({name: tuple(cases)}, cases)

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return next(iter(self.fields))

    @property
    def size(self) -> int:
        """Number of places."""
        return len(self.fields[self.name])

    def changes(self, place: int) -> Mapping[str, Any]:
        """Return the changed fields at one place."""
        values = {field: values[place] for field, values in self.fields.items()}
        return values if self.cases is None else self.cases[values[self.name]]

    def labels(self, place: int) -> dict[str, Any]:
        """Return the coordinates of one place."""
        return {field: _label(values[place]) for field, values in self.fields.items()}

    def summary(self) -> str:
        """Return the values, or the names of the cases, on one line."""
        labels = [_label(value) for value in self.fields[self.name][:6]]
        shown = ", ".join(f"{each:.10g}" if isinstance(each, float) else str(each) for each in labels)
        more = ", ..." if self.size > len(labels) else ""
        together = f" together with {', '.join(list(self.fields)[1:])}" if len(self.fields) > 1 else ""
        return f"{self.size} {'values' if self.cases is None else 'cases'}: {shown}{more}{together}"


Dimension = FieldsDimension | Sample
