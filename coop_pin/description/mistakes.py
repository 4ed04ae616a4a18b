"""What pydantic finds, as typed errors with the paths that the user wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from coop_pin.errors import (
    FieldError,
    FieldNotFiniteError,
    FieldShapeError,
    MissingFieldError,
    ScenarioError,
    UnknownFieldError,
    suggestion,
)

_ABSENT = object()


def field_errors(error: ValidationError, fields: Mapping[str, Any], model: type[BaseModel]) -> list[FieldError]:
    """Turn pydantic's findings into our own, keeping the typed ones that validators raised.

    Args:
        error: the findings.
        fields: what was checked.
        model: the description that it should have become.
    """
    return [problem for details in error.errors() for problem in _translated(details, fields, model)]


def _translated(details: ErrorDetails, fields: Mapping[str, Any], model: type[BaseModel]) -> list[FieldError]:
    kind, value, message, context = details["type"], details["input"], details["msg"], details.get("ctx", {})
    path = _path(details["loc"], fields, keep_last=kind == "missing")
    cause = context.get("error")
    if isinstance(cause, ScenarioError):
        return [problem.below(path) for problem in cause.problems]
    match kind:
        case "extra_forbidden":
            return [UnknownFieldError(f"there is no such field; {suggestion(str(details['loc'][-1]), list(model.model_fields))}", path)]
        case "missing":
            return [MissingFieldError("must be given", path)]
        case "finite_number":
            return [FieldNotFiniteError(f"is {value}; it must be a finite number", path)]
        case "too_short" | "too_long":
            return [FieldShapeError(f"has {len(value)} entries ({value}); {message[0].lower()}{message[1:]}", path)]
        case "union_tag_invalid":
            return [FieldError(f"is {context['tag']!r}; it must be one of {context['expected_tags']}", f"{path}.kind")]
        case "union_tag_not_found":
            return [MissingFieldError("must be given: it says what the other fields mean", f"{path}.kind")]
        case _:
            return [FieldError(f"is {value!r}: {message[0].lower()}{message[1:]}", path)]


def _path(location: Sequence[str | int], fields: Mapping[str, Any], keep_last: bool) -> str:
    """Return pydantic's location without the names of union members, which are not in the data."""
    if not location:
        return ""
    parts, data = [str(location[0])], fields.get(str(location[0]), _ABSENT)
    for part in location[1:]:
        inner = _part(data, part)
        if inner is not _ABSENT:
            parts.append(str(part))
            data = inner
    if keep_last and len(location) > 1:
        parts.append(str(location[-1]))
    return ".".join(parts)


def _part(data: Any, part: str | int) -> Any:
    if isinstance(data, dict):
        return data.get(part, _ABSENT)
    if isinstance(data, list | tuple) and isinstance(part, int) and part < len(data):
        return data[part]
    return _ABSENT
