"""Overrides: fields of a configuration value changed by dotted path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from coop_pin.errors import UnknownFieldError, suggestion


def overridden(description: BaseModel, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a configuration value with changes by dotted path, not yet validated.

    Outer fields change before inner ones, and a ``kind`` before the fields beside it, whatever the order they
    are given in.

    Raises:
        UnknownFieldError: a path leads through something that has no fields. An unknown last field is left to
            the validation.
    """
    fields: Any = description
    for path, value in sorted(changes.items(), key=lambda change: _order(change[0])):
        fields = _changed(fields, path.split("."), value, path)
    return dict(fields)


def _order(path: str) -> tuple[int, bool]:
    keys = path.split(".")
    return len(keys), keys[-1] != "kind"


def _changed(node: Any, keys: Sequence[str], value: Any, path: str) -> Any:
    """Return a copy of a node with the value at the end of the keys replaced."""
    key, rest = keys[0], keys[1:]
    if isinstance(node, BaseModel):
        node = {name: getattr(node, name) for name in type(node).model_fields}
    if isinstance(node, list | tuple):
        index = _index(node, key, path)
        old = node[index] if index < len(node) else None
        return (*node[:index], _changed(old, rest, value, path) if rest else value, *node[index + 1 :])
    if node is None:
        node = {}
    if not isinstance(node, dict):
        raise UnknownFieldError(f"there is no field {key!r} in {node!r}", path)
    if key == "kind" and not rest and node.get("kind", value) != value:
        return {"kind": value}
    if rest and node and key not in node and "kind" not in node:
        raise UnknownFieldError(f"there is no field {key!r}; {suggestion(key, list(node))}", path)
    return node | {key: _changed(node.get(key), rest, value, path) if rest else value}


def _index(entries: Sequence[Any], key: str, path: str) -> int:
    if key.isdecimal() and int(key) <= len(entries):
        return int(key)
    raise UnknownFieldError(f"there is no entry {key!r}; it has {len(entries)} entries, counted from 0", path)
