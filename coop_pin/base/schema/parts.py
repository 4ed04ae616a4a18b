"""Parts of configuration values by dotted path: copies with other parts, and changes, not yet validated."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from coop_pin.base.arrays import require_type
from coop_pin.base.errors import UnknownFieldError, suggestion

Tree = dict[str, Any]
"""Parts by name, of an object or of an object within it."""
Model = TypeVar("Model", bound=BaseModel)
_OF_PYDANTIC = ("__pydantic_fields_set__", "__pydantic_extra__", "__pydantic_private__")
"""Attributes of an object that are no fields."""


def fields_of(description: BaseModel) -> dict[str, Any]:
    """Return the fields of a validated value by name, without what it has precomputed."""
    fields, names = vars(description), type(description).__pydantic_fields__
    return dict(fields) if len(fields) == len(names) else {name: fields[name] for name in names}


def refilled(description: Model, parts: Mapping[str, Any]) -> Model:
    """Return a copy of a validated value with other parts, not validated, and with nothing precomputed."""
    copied = object.__new__(type(description))  # pydantic's own copy takes three times as long
    object.__setattr__(copied, "__dict__", {**fields_of(description), **parts})
    for name in _OF_PYDANTIC:
        object.__setattr__(copied, name, getattr(description, name))
    return copied


def tree_of(parts: Mapping[str, Any]) -> Tree:
    """Return parts by dotted path as a tree."""
    tree: Tree = {}
    for path, part in parts.items():
        *names, last = path.split(".")
        functools.reduce(lambda node, name: node.setdefault(name, {}), names, tree)[last] = part
    return tree


def part_of(node: Any, name: str) -> Any:
    """Return a part of an object, a table or a tuple by its name."""
    if isinstance(node, BaseModel):
        return vars(node)[name]
    return node[int(name)] if isinstance(node, tuple) else node[name]


def with_parts(node: Any, parts: Tree) -> Any:
    """Return a copy of a validated object, a table or a tuple with other parts."""
    if isinstance(node, BaseModel):
        return refilled(node, parts)
    if isinstance(node, tuple):
        return tuple(parts.get(str(index), part) for index, part in enumerate(node))
    return {**node, **parts}


def filled(node: Any, tree: Tree, numbers: Sequence[Any]) -> Any:
    """Return a copy of an object with the numbers of which a tree has the indices."""
    parts = {
        name: numbers[part] if isinstance(part, int) else filled(part_of(node, name), part, numbers)
        for name, part in tree.items()
    }
    return with_parts(node, parts)


class Pattern(NamedTuple):
    """Pattern of configuration values that differ in numbers.

    Attributes:
        first: one of them.
        names: dotted paths of the numbers.
    """

    first: Any
    names: tuple[str, ...]

    def filled(self, numbers: Sequence[Any]) -> Any:
        """Return the one with these numbers."""
        return filled(self.first, _tree_of_places(self.names), numbers)


class Filled(Sequence[Any]):
    """Configuration values of one pattern; each is made on access.

    Attributes:
        pattern: pattern of the values.
        rows: numbers of each of them.
    """

    def __init__(self, pattern: Pattern, rows: Sequence[Sequence[Any]]) -> None:
        """Make nothing yet."""
        self.pattern, self.rows = pattern, rows

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.rows)

    def __getitem__(self, index: Any) -> Any:
        """Return one of them, or some of them."""
        rows = self.rows[index]
        return type(self)(self.pattern, rows) if isinstance(index, slice) else self.pattern.filled(rows)


@functools.lru_cache(64)
def _tree_of_places(names: tuple[str, ...]) -> Tree:
    """Return the places of names in a row as a tree."""
    return tree_of({name: index for index, name in enumerate(names)})


def overridden(description: BaseModel, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a configuration value with changes by dotted path, not yet validated.

    Outer fields change before inner ones, and a ``kind`` before the fields beside it, whatever the order they
    are given in.

    Raises:
        UnknownFieldError: a path leads through something that has no fields. An unknown last field is left to
            the validation.
    """
    require_type("changes", changes, Mapping)
    for path in changes:
        require_type("a path of changes", path, str)
    fields: Any = description
    for path, value in sorted(changes.items(), key=lambda change: _order(change[0])):
        fields = _changed(fields, path.split("."), value, path)
    return dict(fields)


def _order(path: str) -> tuple[int, bool]:
    keys = path.split(".")
    return len(keys), keys[-1] != "kind"


class _Begun(dict[str, Any]):
    """Table that changes begin; which fields it may have is left to the validation."""


def _changed(node: Any, keys: Sequence[str], value: Any, path: str) -> Any:
    """Return a copy of a node with the value at the end of the keys replaced."""
    key, rest = keys[0], keys[1:]
    if isinstance(node, BaseModel):
        node = fields_of(node)
    if isinstance(node, list | tuple):
        index = _index(node, key, path)
        old = node[index] if index < len(node) else None
        return (*node[:index], _changed(old, rest, value, path) if rest else value, *node[index + 1 :])
    if node is None or node == {}:
        node = _Begun()
    if not isinstance(node, dict):
        raise UnknownFieldError(f"there is no field {key!r} in {node!r}", path)
    if key == "kind" and not rest and node.get("kind", value) != value:
        return {"kind": value}
    if rest and key not in node and "kind" not in node and not isinstance(node, _Begun):
        raise UnknownFieldError(f"there is no field {key!r}; {suggestion(key, list(node))}", path)
    return type(node)({**node, key: _changed(node.get(key), rest, value, path) if rest else value})


def _index(entries: Sequence[Any], key: str, path: str) -> int:
    if key.isdecimal() and int(key) <= len(entries):
        return int(key)
    raise UnknownFieldError(f"there is no entry {key!r}; it has {len(entries)} entries, counted from 0", path)
