"""Frozen base class of the configuration classes, and the types of their fields."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from numbers import Real
from typing import Annotated, Any, Self, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
)

from coop_pin.base.errors import FieldError, one_or_all, suggestion
from coop_pin.base.schema.changes import table_differences
from coop_pin.base.schema.parts import fields_of, overridden
from coop_pin.base.schema.validation_errors import field_errors


def _as_tuples(value: Any) -> Any:
    """Return numpy arrays and lists as nested tuples, anything else as it is."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_as_tuples, value)) if isinstance(value, list | tuple) else value


def _sized(size: int) -> Callable[[Any], Any]:
    """Return a validator of the number of entries of a row."""

    def check(value: Any) -> Any:
        entries = _as_tuples(value)
        if isinstance(entries, tuple) and len(entries) != size:
            raise FieldError(f"has {len(entries)} entries {list(entries)}; it must have {size}")
        return entries

    return check


def number_or_row(value: Any) -> float | tuple[float, ...]:
    """Return a number or a row of numbers.

    One validator, because pydantic reports a mistake in a union once for each member.
    """
    entries = _as_tuples(value)
    if not isinstance(entries, tuple):
        return _number(entries)
    if not entries:
        raise FieldError("has no entries; it must be a number or have one entry for each row it acts on")
    return tuple(_number(entry, str(index)) for index, entry in enumerate(entries))


def positive(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    """Return a number or a row of numbers that are positive."""
    if (min(value) if isinstance(value, tuple) else value) <= 0.0:
        raise FieldError(f"is {value}; it must be positive")
    return value


def not_negative(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    """Return a number or a row of numbers that are not negative."""
    if (min(value) if isinstance(value, tuple) else value) < 0.0:
        raise FieldError(f"is {value}; it must not be negative")
    return value


def by_name(values: Mapping[str, Any], form: str) -> BeforeValidator:
    """Return a validator that takes a value by its name, and leaves anything but a text as it is.

    Args:
        values: Values by name.
        form: Form of a value that is not named, for the error.
    """

    def value_of(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        if value not in values:
            raise FieldError(f"is {value!r}; it must be {form}, or one of {list(values)}")
        return values[value]

    return BeforeValidator(value_of)


def number_row_or_rows(value: Any) -> float | tuple[float, ...] | tuple[tuple[float, ...], ...]:
    """Return a number, a row of numbers, or rows of equal length."""
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
    if type(value) is float and math.isfinite(value):
        return value
    if isinstance(value, bool) or not isinstance(value, Real):
        raise FieldError(f"is {value!r}; it must be a number", path)
    try:
        number = float(value)
    except OverflowError:
        raise FieldError("is an integer beyond the range of a float; write 1e30", path) from None
    if not math.isfinite(number):
        raise FieldError(f"is {number}; it must be a finite number", path)
    return number


_LONGEST_NAME = 100


def plain_name(name: str) -> str:
    """Return a name that can name a folder on any system, a path of fields and a curve."""
    if not name.strip() or len(name) > _LONGEST_NAME:
        raise FieldError(f"has {len(name)} characters; a name has 1 to {_LONGEST_NAME}, not only blanks")
    wrong = sorted({sign for sign in name if sign in "/\\:" or not sign.isprintable()})
    if wrong or name.startswith("."):
        signs = ", ".join(map(ascii, wrong)) or "a dot at its start"
        raise FieldError(
            f"is {name!a}, with {signs}; a name must not contain / \\ : or control characters, nor start"
            " with a dot: folders are named after it"
        )
    return name


def _text_line(text: str) -> str:
    """Return a text without control characters but tabs and line breaks."""
    if wrong := sorted({sign for sign in text if not (sign.isprintable() or sign in "\t\n")}):
        raise FieldError(f"contains {', '.join(map(ascii, wrong))}; remove control characters")
    return text


Name = Annotated[str, AfterValidator(plain_name)]
"""A name that is safe as the name of a folder."""
Text = Annotated[str, AfterValidator(_text_line)]
"""Text to read, without control characters."""
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Interval = Annotated[tuple[float, float], BeforeValidator(_sized(2))]
"""Start and end."""
Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_sized(3))]
Vector6 = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_sized(6))]
Vector = Annotated[tuple[float, ...], BeforeValidator(_as_tuples)]
Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_as_tuples)]
NumberOrVector = Annotated[float | tuple[float, ...], BeforeValidator(number_or_row)]
Magnitude = Annotated[NumberOrVector, AfterValidator(not_negative)]
"""A number or a row of numbers, none of them negative."""


def check_arm_names(names: Iterable[str], arms: Iterable[str] | None, path: str = "") -> None:
    """Refuse a table by arm that misses an arm or names an unknown one.

    Args:
        names: names in the table.
        arms: names in the cell; None, because the arms themselves have mistakes, accepts any table.
        path: path of the table, for the error.
    """
    if arms is None:
        return
    names, arms = list(names), list(arms)
    for name in names:
        if name not in arms:
            raise FieldError(
                f"names arm {name!r}, which the cell does not have; {suggestion(name, arms)}", path
            )
    missing = [name for name in arms if name not in names]
    if missing:
        raise FieldError(f"has no entry for {', '.join(map(repr, missing))}; every arm needs one", path)


def unknown_arms(names: Iterable[str], arms: Iterable[str]) -> list[FieldError]:
    """Return one problem for each arm of a table that a cell does not have."""
    known = list(arms)
    return [
        FieldError(f"names an arm that the cell does not have; {suggestion(name, known)}", name)
        for name in names
        if name not in known
    ]


def _public_names(model: type) -> list[str]:
    """Return the public names of a class without those of pydantic: ``help`` stays short."""
    names = {name for base in model.__mro__ for name in vars(base)} - {*vars(BaseModel)}
    return sorted(name for name in names if not name.startswith("_"))


_Listed: Any = type("_Listed", (type(BaseModel),), {"__dir__": _public_names})
"""Metaclass of the configuration classes: pydantic's, with another ``dir``."""


class Description(BaseModel, metaclass=_Listed):  # type: ignore[metaclass]
    """Base of the configuration classes: frozen, no unknown fields, finite numbers only.

    Two values are equal if their types and fields are; what a value has precomputed does not count.

    Raises:
        ScenarioError: with every mistake at once; a single mistake is raised as its own FieldError subclass.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise one_or_all(field_errors(error, fields, type(self)), type(self).__name__) from None
        except TypeError as error:  # pydantic builds an inner table by keywords
            if "keywords must be strings" not in str(error):
                raise
            raise FieldError("has a table with a key that is not a text") from None

    def __eq__(self, other: object) -> bool:
        return self is other or (
            isinstance(other, Description)
            and type(self) is type(other)
            and fields_of(self) == fields_of(other)
        )

    def __tree__(self) -> tuple[dict[str, Any], Callable[[dict[str, Any]], Self]]:
        """Return the fields, and a function that makes a copy with others; see coop_pin.tracing.tree."""
        fields = {name: getattr(self, name) for name in type(self).model_fields}
        return fields, lambda others: self.model_copy(update=others)

    def differences(self, base: Self, path: tuple[str, ...]) -> Iterator[str]:
        """Yield what makes it different from another value of its class; see ``schema.changes``."""
        yield from table_differences(dict(self), dict(base), path)

    def replace(self, **fields: Any) -> Self:
        """Return a copy with some fields changed, validated like a new value."""
        return type(self)(**fields_of(self) | fields)

    def override(self, changes: Mapping[str, Any]) -> Self:
        """Return a copy with fields changed by dotted path.

        For example ``{"clock.rate_hz": 400, "events.0.time": 5.0}``. Entries of lists are counted from zero;
        the number after the last one adds an entry. A changed ``kind`` starts from the defaults of the new
        kind.

        Raises:
            ScenarioError: a path does not exist, or the copy has mistakes.
        """
        return type(self)(**overridden(self, changes))


Maker = TypeVar("Maker", bound=Callable[..., Any])


def checked(make: Maker) -> Maker:
    """Validate the arguments of a class method by their annotations, all mistakes at once.

    Raises:
        ScenarioError: with the names of the arguments as paths.
    """
    signature, types = inspect.signature(make), get_type_hints(make, include_extras=True)
    fields: dict[str, Any] = {
        name: (types[name], ... if argument.default is argument.empty else argument.default)
        for name, argument in signature.parameters.items()
        if name in types
    }
    arguments = create_model(make.__name__, __base__=Description, **fields)

    @functools.wraps(make)
    def checked(cls: Any, *args: Any, **kwargs: Any) -> Any:
        positional = signature.bind_partial(cls, *args).arguments
        named = {name: value for name, value in positional.items() if name in fields}
        return make(cls, **dict(arguments(**named, **kwargs)))

    return cast(Maker, checked)
