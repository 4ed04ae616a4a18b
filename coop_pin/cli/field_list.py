"""Fields of a scenario with values and meanings, for the command line and for the documentation."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from coop_pin.description import Pose

_VALUE_WIDTH = 28
_POSE = {"xyz": "x, y, z, m", "rpy": "roll, pitch, yaw about fixed axes, rad"}
"""Meanings of the fields of a pose, after the meaning of the pose itself."""


def field_list(description: BaseModel) -> list[str]:
    """Return one line for each field: ``--a.b.c VALUE  meaning``, with meanings from the docstrings."""
    fields = list(_fields(description, "", "", None))
    width = max(len(option) for option, _, _ in fields)
    return [
        f"{option:<{width}}  {value:<{_VALUE_WIDTH}}  {meaning}".rstrip() for option, value, meaning in fields
    ]


def described(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the configuration classes that a type contains, in its order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from described(inner)


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the meanings of a configuration class's fields, from its docstring and those of its bases."""
    documented = [base.__doc__ or "" for base in reversed(model.__mro__) if base is not BaseModel]
    return {name: meaning for text in documented for name, meaning in section(text, "Attributes").items()}


def section(docstring: str, name: str) -> dict[str, str]:
    """Return the entries of a section of a docstring, such as "Attributes" or "Args", by their names."""
    _, _, text = inspect.cleandoc(docstring).partition(f"{name}:\n")
    text = re.split(r"^\S", text, maxsplit=1, flags=re.MULTILINE)[0]
    matches = re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", text, re.MULTILINE)
    return {entry: " ".join(meaning.split()) for entry, meaning in matches}


def _fields(value: Any, path: str, meaning: str, annotation: Any) -> Iterator[tuple[str, str, str]]:
    """Yield option, value and meaning of all fields below a path.

    Args:
        value: the value at the path.
        path: dotted path.
        meaning: meaning of the value, from the docstring of its class.
        annotation: type of the field, which lists the kinds there are.
    """
    entries: dict[str, tuple[Any, str, Any]] = {}
    brief = meaning.split(";")[0].rstrip(".")
    if isinstance(value, Pose):
        entries = {name: (getattr(value, name), f"{brief}: {part}.", None) for name, part in _POSE.items()}
    elif isinstance(value, BaseModel):
        texts = meanings(type(value))
        kinds = [
            str(one.model_fields["kind"].default)
            for one in described(annotation)
            if "kind" in one.model_fields
        ]
        if len(kinds) > 1:
            texts["kind"] = f"{brief}; one of {', '.join(dict.fromkeys(kinds))}."
        for name, field in type(value).model_fields.items():
            entry = getattr(value, name), texts.get(name, meaning), field.annotation
            entries[name.replace("_", "-")] = entry
    elif isinstance(value, dict):
        entries = {name: (entry, meaning, annotation) for name, entry in value.items()}
    elif isinstance(value, tuple) and any(isinstance(entry, BaseModel) for entry in value):
        entries = {str(index): (entry, meaning, annotation) for index, entry in enumerate(value)}
    if not entries:
        yield f"--{path}", _written(value), meaning
    for name, (entry, entry_meaning, entry_annotation) in entries.items():
        yield from _fields(entry, f"{path}.{name}" if path else name, entry_meaning, entry_annotation)


def _written(value: Any) -> str:
    """Return a value as it can be typed on the command line; one with brackets needs quotes in a shell."""
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
