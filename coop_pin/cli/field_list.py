"""The fields of a scenario as options of the command line, with values and meanings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from coop_pin.description import Pose

_VALUE_WIDTH = 28
_POSE = {"xyz": "x, y, z, m", "rpy": "roll, pitch, yaw about fixed axes, rad"}
"""What the fields of a pose mean, after the words for the pose itself."""


def field_list(description: BaseModel) -> list[str]:
    """Return one line for each field: ``--a.b.c VALUE  meaning``; the meanings are those of the docstrings."""
    fields = list(_fields(description, "", "", None))
    width = max(len(option) for option, _, _ in fields)
    return [
        f"{option:<{width}}  {value:<{_VALUE_WIDTH}}  {meaning}".rstrip() for option, value, meaning in fields
    ]


def _fields(value: Any, path: str, meaning: str, annotation: Any) -> Iterator[tuple[str, str, str]]:
    """Yield option, value and meaning of everything below a path.

    Args:
        value: what stands at the path.
        path: its dotted path.
        meaning: what the docstring says of it.
        annotation: the type that its description declares, which lists the kinds there are.
    """
    entries: dict[str, tuple[Any, str, Any]] = {}
    if isinstance(value, Pose):
        pose = meaning.split(";")[0].rstrip(".")
        entries = {name: (getattr(value, name), f"{pose}: {part}.", None) for name, part in _POSE.items()}
    elif isinstance(value, BaseModel):
        meanings = _meanings(type(value)) | _kind_meaning(meaning, annotation)
        for name, field in type(value).model_fields.items():
            entries[name.replace("_", "-")] = (
                getattr(value, name),
                meanings.get(name, meaning),
                field.annotation,
            )
    elif isinstance(value, dict):
        entries = {name: (entry, meaning, annotation) for name, entry in value.items()}
    elif isinstance(value, tuple) and any(isinstance(entry, BaseModel) for entry in value):
        entries = {str(index): (entry, meaning, annotation) for index, entry in enumerate(value)}
    if not entries:
        yield f"--{path}", _written(value), meaning
    for name, (entry, entry_meaning, entry_annotation) in entries.items():
        yield from _fields(entry, f"{path}.{name}" if path else name, entry_meaning, entry_annotation)


def _kind_meaning(meaning: str, annotation: Any) -> dict[str, str]:
    """Return what a ``kind`` means: the words for the whole, and the kinds to choose from."""
    kinds = list(dict.fromkeys(_kinds(annotation)))
    return (
        {"kind": f"{meaning.split(';')[0].rstrip('.')}; one of {', '.join(kinds)}."} if len(kinds) > 1 else {}
    )


def _kinds(annotation: Any) -> Iterator[str]:
    """Yield the kinds of all descriptions that a type allows."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        field = annotation.model_fields.get("kind")
        if field is not None:
            yield str(field.default)
    for inner in get_args(annotation):
        yield from _kinds(inner)


def _meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return what the docstrings of a description and of its bases say of each field."""
    documented = [
        kind for kind in reversed(model.__mro__) if issubclass(kind, BaseModel) and kind is not BaseModel
    ]
    return {name: meaning for kind in documented for name, meaning in _attributes(kind.__doc__ or "")}


def _attributes(docstring: str) -> list[tuple[str, str]]:
    """Return names and texts below ``Attributes:``."""
    _, _, attributes = inspect.cleandoc(docstring).partition("Attributes:\n")
    found = re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", attributes, re.MULTILINE)
    return [(name, " ".join(text.split())) for name, text in found]


def _written(value: Any) -> str:
    """Return a value as it can be typed; one with brackets needs quotes in a shell."""
    match value:
        case None:
            return "(omitted)"
        case "":
            return '""'
        case bool():
            return str(value).lower()
        case tuple() if len(value) > 1 and not any(isinstance(entry, tuple) for entry in value):
            return " ".join(map(str, value))
        case tuple():
            return str([list(entry) if isinstance(entry, tuple) else entry for entry in value])
        case _:
            return str(value)
