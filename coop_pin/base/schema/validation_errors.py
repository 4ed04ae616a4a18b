"""Conversion of pydantic's validation errors into typed errors with the paths that the user wrote."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from coop_pin.base.errors import FieldError, ScenarioError, UnknownFieldError, suggestion

_ABSENT = object()
_SHOWN_CHARACTERS = 100
"""Characters of a wrong value that a message shows."""

_WANTED = {
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a table",
    "model_type": "a table of fields",
    "model_attributes_type": "a table of fields",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "a text",
}
"""The wanted type by pydantic's error type, in the words of a scenario file."""


def field_errors(
    error: ValidationError, fields: Mapping[str, Any], model: type[BaseModel]
) -> list[FieldError]:
    """Return one FieldError for each of pydantic's errors; those that validators raised keep their type.

    Args:
        error: pydantic's errors.
        fields: the values that were validated.
        model: the class that they were validated for.
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
            known = suggestion(str(details["loc"][-1]), list(model.model_fields))
            return [UnknownFieldError(f"there is no such field; {known}", path)]
        case "missing":
            return [FieldError(f"must be given{_needs(model, details['loc'])}", path)]
        case "finite_number":
            return [FieldError(f"is {value}; it must be a finite number", path)]
        case "greater_than" if context["gt"] == 0.0:
            return [FieldError(f"is {_rounded(value)}; it must be positive", path)]
        case "greater_than_equal" if context["ge"] == 0.0:
            return [FieldError(f"is {_rounded(value)}; it must not be negative", path)]
        case "too_short" | "too_long":
            shown = f"{context['actual_length']} entries ({_shown(value)})"
            return [FieldError(f"has {shown}; {message[0].lower()}{message[1:]}", path)]
        case "union_tag_invalid":
            return [
                FieldError(
                    f"is {context['tag']!r}; it must be one of {context['expected_tags']}", f"{path}.kind"
                )
            ]
        case "union_tag_not_found":
            return [FieldError("must be given: it says what the other fields mean", f"{path}.kind")]
        case "literal_error":
            return [FieldError(f"is {value!r}; it must be {context['expected']}", path)]
        case _ if kind in _WANTED:
            return [FieldError(f"is {_shown(value)}; it must be {_WANTED[kind]}", path)]
        case _:
            return [FieldError(f"is {_shown(value)}: {message[0].lower()}{message[1:]}", path)]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARACTERS else text[:_SHOWN_CHARACTERS] + " ..."


def _rounded(number: Any) -> str:
    try:
        return f"{float(number):g}"
    except OverflowError:  # an integer of hundreds of digits
        return _shown(number)


def _needs(model: type[BaseModel], location: Sequence[str | int]) -> str:
    """Return which fields a missing table must have, for the message."""
    field = model.model_fields.get(str(location[-1])) if len(location) == 1 else None
    table = field.annotation if field is not None else None
    if not (isinstance(table, type) and issubclass(table, BaseModel)):
        return ""
    needed = [name for name, entry in table.model_fields.items() if entry.is_required()]
    return f": a table of {', '.join(needed)}" if needed else ""


def _path(location: Sequence[str | int], fields: Mapping[str, Any], keep_last: bool) -> str:
    """Return pydantic's location as dotted path, without the names of union members: the data has none."""
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
