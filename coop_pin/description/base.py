"""The frozen base of all descriptions, and its mistakes as typed errors with paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from coop_pin.errors import (
    FieldError,
    FieldNotFiniteError,
    FieldShapeError,
    MissingFieldError,
    ScenarioError,
    UnknownFieldError,
    one_or_all,
    suggestion,
)


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


Positive = Annotated[float, AfterValidator(_positive)]
NotNegative = Annotated[float, AfterValidator(_not_negative)]
Vector3 = Annotated[tuple[float, float, float], BeforeValidator(_as_tuples)]
Vector6 = Annotated[tuple[float, float, float, float, float, float], BeforeValidator(_as_tuples)]
Vector = Annotated[tuple[float, ...], BeforeValidator(_as_tuples)]
Matrix = Annotated[tuple[tuple[float, ...], ...], BeforeValidator(_as_tuples)]


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
            raise one_or_all(_problems(error, type(self)), type(self).__name__) from None

    def replace(self, **fields: Any) -> Self:
        """Return a copy with some fields changed, checked like a new one."""
        return type(self)(**{name: getattr(self, name) for name in type(self).model_fields} | fields)

    def override(self, changes: Mapping[str, Any]) -> Self:
        """Return a copy with fields changed by dotted path, for example ``{"clock.rate_hz": 400}``."""
        data = self.model_dump(exclude_unset=False)
        for path, value in changes.items():
            _set(data, path.split("."), value, path)
        return type(self)(**data)


def _set(data: Any, keys: Sequence[str], value: Any, path: str) -> None:
    """Set one entry of nested dictionaries and lists."""
    for key in keys[:-1]:
        data = _entry(data, key, path)
    _entry(data, keys[-1], path, missing_ok=True)
    data[int(keys[-1]) if isinstance(data, list) else keys[-1]] = value


def _entry(data: Any, key: str, path: str, missing_ok: bool = False) -> Any:
    if isinstance(data, list | tuple) and key.isdigit() and int(key) < len(data):
        return data[int(key)]
    if isinstance(data, dict) and (key in data or missing_ok):
        return data.get(key)
    known = list(data) if isinstance(data, dict) else [str(i) for i in range(len(data))] if isinstance(data, list | tuple) else []
    raise UnknownFieldError(f"there is no field {key!r}; {suggestion(key, known)}", path)


def _problems(error: ValidationError, model: type[BaseModel]) -> list[FieldError]:
    """Turn pydantic's findings into our own, keeping the typed ones that validators raised."""
    return [problem for details in error.errors() for problem in _problem(details, model)]


def _problem(details: ErrorDetails, model: type[BaseModel]) -> list[FieldError]:
    path = ".".join(str(part) for part in details["loc"])
    cause = details.get("ctx", {}).get("error")
    if isinstance(cause, ScenarioError):
        return [problem.below(path) for problem in cause.problems]
    value, message = details["input"], details["msg"]
    match details["type"]:
        case "extra_forbidden":
            return [UnknownFieldError(f"there is no such field; {suggestion(str(details['loc'][-1]), list(model.model_fields))}", path)]
        case "missing":
            return [MissingFieldError("must be given", path)]
        case "finite_number":
            return [FieldNotFiniteError(f"is {value}; it must be a finite number", path)]
        case "too_short" | "too_long":
            return [FieldShapeError(f"has {len(value)} entries ({value}); {message[0].lower()}{message[1:]}", path)]
        case _:
            return [FieldError(f"is {value!r}: {message[0].lower()}{message[1:]}", path)]
