"""The frozen base of all descriptions, and the kinds of numbers they hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from numbers import Real
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from coop_pin.errors import FieldError, one_or_all
from coop_pin.schema.overrides import overridden
from coop_pin.schema.validation_errors import field_errors


def _as_tuples(value: Any) -> Any:
    """Let numpy arrays and lists stand where tuples of numbers are stored."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_as_tuples, value)) if isinstance(value, list | tuple) else value


def _positive(value: float) -> float:
    if value <= 0.0:
        raise FieldError(f"is {value:g}; it must be positive")
    return value


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise FieldError(f"is {value:g}; it must not be negative")
    return value


def _sized(size: int) -> Callable[[Any], Any]:
    """Return a validator of the number of entries."""

    def check(value: Any) -> Any:
        entries = _as_tuples(value)
        if isinstance(entries, tuple) and len(entries) != size:
            raise FieldError(f"has {len(entries)} entries {list(entries)}; it must have {size}")
        return entries

    return check


def number_or_row(value: Any) -> float | tuple[float, ...]:
    """Read a number or a row of numbers. One reader, because a union of types reports one mistake once for each type."""
    entries = _as_tuples(value)
    if not isinstance(entries, tuple):
        return _number(entries)
    if not entries:
        raise FieldError("has no entries; it must be a number or have one entry for each row it acts on")
    return tuple(_number(entry, str(index)) for index, entry in enumerate(entries))


def _number_row_or_rows(value: Any) -> float | tuple[float, ...] | tuple[tuple[float, ...], ...]:
    """Read a number, a row of numbers, or rows of equal length."""
    entries = _as_tuples(value)
    if not (isinstance(entries, tuple) and any(isinstance(row, tuple) for row in entries)):
        return number_or_row(entries)
    lengths = [len(row) if isinstance(row, tuple) else 0 for row in entries]
    if len(set(lengths)) > 1 or not lengths[0]:
        raise FieldError(
            f"has rows of {lengths} entries; all rows must have the same number of entries, at least one"
        )
    return tuple(
        tuple(_number(entry, f"{i}.{j}") for j, entry in enumerate(row)) for i, row in enumerate(entries)
    )


def _number(value: Any, path: str = "") -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise FieldError(f"is {value!r}; it must be a number", path)
    number = float(value)
    if not math.isfinite(number):
        raise FieldError(f"is {number}; it must be a finite number", path)
    return number


Positive = Annotated[float, AfterValidator(_positive)]
NotNegative = Annotated[float, AfterValidator(_not_negative)]
Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_sized(3))]
Vector6 = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_sized(6))]
Vector = Annotated[tuple[float, ...], BeforeValidator(_as_tuples)]
Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_as_tuples)]
NumberOrVector = Annotated[float | tuple[float, ...], BeforeValidator(number_or_row)]
NumberVectorOrMatrix = Annotated[
    float | tuple[float, ...] | tuple[tuple[float, ...], ...], BeforeValidator(_number_row_or_rows)
]


class Description(BaseModel):
    """Base of everything a user says: frozen, nothing unknown accepted, only finite numbers.

    Raises:
        ScenarioError: with every mistake at once; a single mistake is raised as its own FieldError subclass.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise one_or_all(field_errors(error, fields, type(self)), type(self).__name__) from None

    def replace(self, **fields: Any) -> Self:
        """Return a copy with some fields changed, checked like a new one."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | fields)

    def override(self, changes: Mapping[str, Any]) -> Self:
        """Return a copy with fields changed by dotted path, for example ``{"clock.rate_hz": 400, "events.0.time": 5.0}``.

        Entries of lists are counted from zero; the number after the last one adds an entry. A changed
        ``kind`` starts from the defaults of the new kind.

        Raises:
            ScenarioError: a path does not exist, or the copy has mistakes.
        """
        return type(self)(**overridden(self, changes))
