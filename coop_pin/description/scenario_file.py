"""TOML text of a scenario: every field, or the fields that are not at their defaults with their meanings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import tomli_w
from pydantic import BaseModel

from coop_pin.description.payload import Payload
from coop_pin.schema.meanings import kinds, meanings
from coop_pin.schema.pose import POSE_MEANINGS, Pose

# tomli_w writes one number per line. No string can match: it writes those on one line.
_NUMBERS_IN_LINES = re.compile(r"\[\n((?: *[-+.\w]+,\n)+) *\]")
_HEADER, _ENTRY = re.compile(r"\[+([^\]]+)\]+$"), re.compile(r"(\w+) = ")
_OF_BOX = "The inertia follows from mass and edges."


def resolved_toml(scenario: BaseModel) -> str:
    """Return every field with its value, as TOML."""
    return _dumps(scenario.model_dump(mode="json"))


def commented_toml(scenario: BaseModel) -> str:
    """Return the fields that are not at their defaults, with the meanings of tables and fields as comments.

    The meanings are those of the docstrings; a table also names the kinds there are and its other fields.
    """
    text = _dumps(_stated(scenario, scenario.model_dump(mode="json")))
    comments, table, lines, written = dict(_comments(scenario, "", "", None)), "", list[str](), set[str]()
    for line in text.splitlines():
        if header := _HEADER.match(line):
            table = header[1].replace('"', "")
            lines += [f"# {comments[table]}"] if table in comments else []
        entry = _ENTRY.match(line)
        comment = comments.get(f"{table}.{entry[1]}".lstrip("."), "") if entry else ""
        lines.append(f"{line}  # {comment}" if comment and comment not in written else line)
        written.add(comment)
    return "\n".join((*lines, ""))


def _dumps(fields: dict[str, Any]) -> str:
    text = tomli_w.dumps(_without_none(fields))
    return _NUMBERS_IN_LINES.sub(
        lambda match: "[" + ", ".join(match[1].replace(",", " ").split()) + "]", text
    )


def _without_none(value: Any) -> Any:
    """Return a value without omitted optional fields: TOML has no null."""
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    return [_without_none(entry) for entry in value] if isinstance(value, list) else value


def _stated(value: Any, dumped: Any) -> Any:
    """Return what is dumped of a value without fields at their defaults; a ``kind`` stays."""
    if isinstance(value, Payload) and _is_box(value):
        return {"kind": "box", "mass": dumped["mass"], "size": dumped["size"]}
    if isinstance(value, Pose) and any(value.rpy[:2]) and Pose(**value.by_axis()) == value:
        return value.by_axis()
    if isinstance(value, BaseModel) and isinstance(dumped, dict):
        left_out = set(_at_defaults(value))
        stated = {
            name: getattr(value, name) for name in type(value).model_fields
        } | dumped  # not all are dumped
        kept = {name: entry for name, entry in stated.items() if name not in left_out}
        return {name: _stated(getattr(value, name, None), entry) for name, entry in kept.items()}
    if isinstance(value, dict):
        return {name: _stated(value[name], entry) for name, entry in dumped.items()}
    return dumped


def _is_box(value: BaseModel) -> bool:
    """Whether a value is a homogeneous box, which its mass and edges state."""
    return isinstance(value, Payload) and value == Payload.box(value.mass, value.size)


def _at_defaults(value: BaseModel) -> Iterator[str]:
    """Yield the names of the fields that are at their defaults."""
    for name, field in type(value).model_fields.items():
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        if name != "kind" and not field.is_required() and getattr(value, name) == default:
            yield name


def _comments(value: Any, path: str, meaning: str, annotation: Any) -> Iterator[tuple[str, str]]:
    """Yield the path and the comment of each table and field, in one line."""
    if isinstance(value, dict):
        for name, entry in value.items():
            first = (inspect.getdoc(type(entry)) or "").split("\n\n")[0] if _has_own(entry) else meaning
            yield from _comments(entry, f"{path}.{name}", first, annotation)
    elif isinstance(value, BaseModel):
        if path:
            yield path, " ".join(_of_table(value, meaning, annotation))
        if isinstance(value, Pose):
            texts = meanings(type(value)) | POSE_MEANINGS
            yield from ((f"{path}.{name}", _brief(text)) for name, text in texts.items())
            return
        texts = meanings(type(value))
        for name, field in type(value).model_fields.items():
            below = f"{path}.{name}".lstrip(".")
            yield from _comments(getattr(value, name), below, texts.get(name, ""), field.annotation)
    elif meaning:
        yield path, _brief(meaning)


def _has_own(entry: Any) -> bool:
    """Whether the docstring of an entry's class says what it is: poses differ by their field."""
    return isinstance(entry, BaseModel) and not isinstance(entry, Pose)


def _of_table(value: BaseModel, meaning: str, annotation: Any) -> Iterator[str]:
    brief = _brief(meaning)
    yield f"{brief[:1].upper()}{brief[1:]}."
    if _is_box(value):
        yield _OF_BOX
    elif (others := list(_at_defaults(value))) and not isinstance(value, Pose):
        yield f"Also: {', '.join(others)}."
    if names := kinds(annotation):
        yield f"Kinds: {', '.join(names)}."


def _brief(meaning: str) -> str:
    """Return a meaning up to its first semicolon or sentence."""
    return re.split(r";|\.(?= [A-Z]|$)", meaning.replace("``", ""), maxsplit=1)[0]
