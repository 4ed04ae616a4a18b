"""Dimensions of a sweep plan: the fields that vary along each and their values, and samples over several."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from coop_pin.base.arrays import Array, as_fitting_count, as_number
from coop_pin.base.errors import FieldError, OutOfRangeError
from coop_pin.base.memory import require_memory
from coop_pin.base.schema.base import Description

_VALUE = 64.0
"""Memory of a value, bytes."""


def linspace(first: float, last: float, count: int) -> list[float]:
    """Return count evenly spaced values from first to last, both included.

    Raises:
        WrongTypeError: the count is not a whole number.
        ArgumentError: the count is below 1 or beyond the memory, or an end is not finite.
    """
    ends = as_number("first", first), as_number("last", last)
    return np.linspace(*ends, as_fitting_count("count", count, 1, _VALUE)).tolist()


def logspace(first: float, last: float, count: int) -> list[float]:
    """Return count values in equal ratios from first to last, both included.

    first and last are values, not exponents.

    Raises:
        WrongTypeError: the count is not a whole number.
        ArgumentError: as for linspace, or an end is not positive.
    """
    ends = as_number("first", first), as_number("last", last)
    if min(ends) <= 0.0:
        raise OutOfRangeError("an end of a logarithmic scale", min(ends))
    return np.geomspace(*ends, as_fitting_count("count", count, 1, _VALUE)).tolist()


def _range(start: float, stop: float, step: float) -> list[float]:
    """Return start, start + step, ... up to stop, which is excluded."""
    count = math.ceil((stop - start) / step - 1e-9)
    return [start + i * step for i in range(as_fitting_count("count", count, 1, _VALUE))]


_SPACINGS = {"linspace": linspace, "logspace": logspace, "range": _range}


def _values(argument: Any) -> tuple[Any, ...]:
    """Return the values of a list, or those of ``{linspace = [first, last, count]}`` and the like."""
    if isinstance(argument, Mapping):
        try:
            ((kind, numbers),) = argument.items()
            return tuple(_SPACINGS[kind](*numbers))
        except (TypeError, ValueError, KeyError, ArithmeticError) as error:
            form = "{linspace = [first, last, count]}, {logspace = [...]} or {range = [start, stop, step]}"
            raise FieldError(f"is {dict(argument)!r}; it must be {form} ({error})") from None
    if isinstance(argument, np.ndarray):
        argument = argument.tolist()
    if isinstance(argument, str) or not isinstance(argument, Sequence) or not argument:
        form = f"a list with at least one value, or one of {', '.join(_SPACINGS)} = [...]"
        raise FieldError(f"is {argument!r}; it must be {form}")
    return tuple(argument)


Values = Annotated[tuple[Any, ...], BeforeValidator(_values)]
"""The values that a field takes, in order."""


class Dimension(NamedTuple):
    """Dimension of a plan: one field, several that vary together, named cases, or a sample.

    Attributes:
        fields: the values of each field, all of one length; the first name is the dimension's.
        kind: kind of the values, for the summary.
        cases: named groups of changes, such as controllers or payloads that take several fields to describe;
            the values of the only field are then their names.
    """

    fields: Mapping[str, Sequence[Any]]
    kind: str = "values"
    cases: Mapping[str, Mapping[str, Any]] | None = None

    @property
    def name(self) -> str:
        """Name of the dimension."""
        return next(iter(self.fields))

    @property
    def size(self) -> int:
        """Number of places."""
        return len(self.fields[self.name])

    @property
    def varied(self) -> dict[str, Sequence[Any]]:
        """Values of each field of the scenario."""
        return {field: values for field, values in self.fields.items() if field != "sample"}

    def changes(self, index: int) -> Mapping[str, Any]:
        """Return the changed fields at one place."""
        if self.cases is not None:
            return self.cases[self.fields[self.name][index]]
        return {field: values[index] for field, values in self.fields.items() if field != "sample"}

    def ends(self) -> list[int]:
        """Return the places of the least and largest values of each field; all of cases."""
        if self.cases is not None:
            return list(range(self.size))
        places = list[int]()
        for values in self.fields.values():
            is_ordered = all(isinstance(value, int | float) for value in values)
            order = sorted(range(self.size), key=values.__getitem__) if is_ordered else range(self.size)
            places += [order[0], order[-1]]
        return places

    def labels(self, index: int) -> dict[str, Any]:
        """Return the coordinates of one place."""
        return {field: label(values[index]) for field, values in self.fields.items()}

    def summary(self) -> str:
        """Return the values, or the names of the cases, on one line."""
        labels = [label(value) for value in self.fields[self.name][:6]]
        shown = ", ".join(f"{each:.10g}" if isinstance(each, float) else str(each) for each in labels)
        more = ", ..." if self.size > len(labels) else ""
        together = f" together with {', '.join(list(self.fields)[1:])}" if len(self.fields) > 1 else ""
        return f"{self.size} {self.kind}: {shown}{more}{together}"


def label(value: Any) -> Any:
    """Return the coordinate of a value: a number, text or truth value itself, anything else as JSON text."""
    is_plain = isinstance(value, str | int | float)
    return value if is_plain else json.dumps(value, default=lambda x: getattr(x, "model_dump", x.__str__)())


class Span(Description):
    """The range of one field; (low, high) is one, too.

    Attributes:
        low: lower end.
        high: upper end.
        scale: "linear", or "log" to sample evenly in the logarithm.
    """

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="before")
    @classmethod
    def _of_a_pair(cls, argument: Any) -> Any:
        is_pair = isinstance(argument, list | tuple) and len(argument) == 2
        return {"low": argument[0], "high": argument[1]} if is_pair else argument

    @model_validator(mode="after")
    def _with_valid_ends(self) -> Self:
        if not self.high > self.low:
            raise FieldError(f"is {self.high:g}; it must be above low = {self.low:g}", "high")
        if self.scale == "log" and self.low <= 0.0:
            raise FieldError(f"is 'log', but low is {self.low:g}; it must be positive", "scale")
        return self

    def at(self, fractions: Array) -> Array:
        """Return the values at fractions of the range."""
        is_log, width = self.scale == "log", self.high - self.low
        return self.low * (self.high / self.low) ** fractions if is_log else self.low + fractions * width


class Sample(Description):
    """Sample of points over the ranges of several fields; one dimension of a sweep plan.

    Attributes:
        fields: the range of each field, a Span or a pair.
        count: number of points; a power of two for "sobol" and "saltelli".
        method: "sobol" (scrambled), "latin-hypercube", "random", or "saltelli": count (2 + number of fields)
            points, from which Sobol' indices are computed.
        seed: seed of the sampling.
    """

    fields: dict[str, Span] = Field(min_length=1)
    count: int = Field(ge=1, le=1 << 30)
    method: Literal["sobol", "latin-hypercube", "random", "saltelli"] = "sobol"
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _balanced(self) -> Self:
        if self.method in ("sobol", "saltelli") and self.count & (self.count - 1):
            form = f"a power of two for {self.method}, for example {1 << self.count.bit_length()}"
            raise FieldError(f"is {self.count}; it must be {form}", "count")
        return self

    def fractions(self) -> Array:
        """Return the points in the unit cube, one in each row.

        Those of Saltelli are the rows of A, of B, and of A with one column from B for each field.

        Raises:
            NotEnoughMemoryError: they do not fit into the memory.
        """
        d, random = len(self.fields), np.random.default_rng(self.seed)
        require_memory(f"{self.count} points", _VALUE * self.count * d * (d + 2), "lower the count")
        if self.method == "random":
            return random.random((self.count, d))
        from scipy.stats import qmc  # slow to load

        if self.method == "latin-hypercube":
            return np.asarray(qmc.LatinHypercube(d, rng=random).random(self.count))
        if self.method == "sobol":
            return np.asarray(qmc.Sobol(d, rng=random).random(self.count))
        A, B = np.hsplit(qmc.Sobol(2 * d, rng=random).random(self.count), 2)
        return np.concatenate([A, B, *np.where(np.eye(d, dtype=bool)[:, None], B, A)])

    def dimension(self) -> Dimension:
        """Return the points as a dimension: their numbers, and the values of each field."""
        values = {
            name: span.at(u).tolist()
            for (name, span), u in zip(self.fields.items(), self.fractions().T, strict=True)
        }
        ranges = (f"{name} in [{span.low:g}, {span.high:g}]" for name, span in self.fields.items())
        numbers = range(len(next(iter(values.values()))))
        return Dimension({"sample": numbers, **values}, f"{self.method} points, {', '.join(ranges)}")
