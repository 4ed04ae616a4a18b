"""Fields of a scenario with values and meanings, for the command line and for the documentation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from coop_pin.base.schema.meanings import kinds, meanings
from coop_pin.base.schema.parts import fields_of
from coop_pin.base.schema.pose import POSE_MEANINGS, Pose

_VALUE_WIDTH = 28


def field_list(description: BaseModel) -> list[str]:
    """Return one line for each field: ``--a.b.c VALUE  meaning``, with meanings from the docstrings."""
    fields = list(_fields(description, "", "", None))
    width = max(len(option) for option, _, _ in fields)
    return [
        f"{option:<{width}}  {value:<{_VALUE_WIDTH}}  {meaning}".rstrip() for option, value, meaning in fields
    ]


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
        texts = meanings(type(value)) | {name: f"{brief}: {text}." for name, text in POSE_MEANINGS.items()}
        entries = {
            name.replace("_", "-"): (entry, texts[name], None) for name, entry in fields_of(value).items()
        }
    elif isinstance(value, BaseModel):
        texts = meanings(type(value))
        if names := kinds(annotation):
            texts["kind"] = f"{brief}; one of {', '.join(names)}."
        entries = {
            name.replace("_", "-"): (
                entry,
                texts.get(name, meaning),
                type(value).model_fields[name].annotation,
            )
            for name, entry in fields_of(value).items()
        }
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
