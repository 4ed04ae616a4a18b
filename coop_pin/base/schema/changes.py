"""Differences between two configuration values, and values as text, for people to read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

_CONTAINERS = ("cell", "arms", "controller", "gains")
"""Fields that only hold others: they are left out of the words of a field."""

_MOST_CHANGES = 6
"""Most changes that a caption tells."""
_LONGEST = 60
"""Most characters of a value; a longer one counts as changed, without its value."""


def differences(new: Any, base: Any, path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield what makes a value different from another, one text for each field.

    Args:
        new: the value.
        base: value that it is compared with.
        path: names of the fields that lead to both.
    """
    if new == base:
        return
    if type(new) is type(base) and isinstance(base, BaseModel):
        yield from new.differences(base, path)
    elif isinstance(new, dict) and isinstance(base, dict):
        yield from table_differences(new, base, path)
    else:
        kinds = getattr(new, "kind", None), getattr(base, "kind", None)
        texts = kinds if None not in kinds else (value_text(new), value_text(base))
        yield f"{words(path)} {_change(*texts)}"


def table_differences(new: dict[str, Any], base: dict[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    """Yield the differences of all entries of two tables; arguments as of ``differences``."""
    for name in dict.fromkeys((*base, *new)):
        yield from differences(new.get(name), base.get(name), (*path, name))


def changed_caption(summary: str, base: str, changed: list[str]) -> str:
    """Return a summary with what was changed, in place of the summary of the base that it begins with."""
    texts = (
        *changed[:_MOST_CHANGES],
        *[f"{len(changed) - _MOST_CHANGES} more"][: len(changed) > _MOST_CHANGES],
    )
    addition = summary.removeprefix(base).removeprefix("; ")
    return "; ".join((*[addition][: bool(addition)], f"changed: {'; '.join(texts)}"))


def _change(new: str, base: str) -> str:
    if not new:
        return "removed" if base else "added"
    if max(len(new), len(base)) > _LONGEST:
        return "changed"
    return f"{base} → {new}" if base and "(" not in new else new


def words(path: tuple[str, ...]) -> str:
    """Return the path of a field as words."""
    return " ".join(name.replace("_", " ") for name in path if name not in _CONTAINERS) or path[-1]


def value_text(value: Any) -> str:
    """Return a value as text, without entries that are empty or a default; "" for none."""
    if isinstance(value, BaseModel):
        value = ({"kind": value.kind} if hasattr(value, "kind") else {}) | stated(value)
    if isinstance(value, dict):
        rest = table_text({name: entry for name, entry in value.items() if name != "kind"})
        return f"{value.get('kind', '')} {f'({rest})' if rest else ''}".strip()
    if isinstance(value, list | tuple):
        return f"({', '.join(map(value_text, value))})" if value else ""
    return f"{value:g}" if isinstance(value, float) else "" if value is None else str(value)


def stated(value: BaseModel) -> dict[str, Any]:
    """Return the fields of a value that are not their defaults, by name."""
    usual = {
        name: field.get_default(call_default_factory=True) for name, field in type(value).model_fields.items()
    }
    return {name: part for name, part in value if part != usual[name]}


def table_text(table: dict[str, Any]) -> str:
    """Return the entries of a table as text, without those that are empty."""
    texts = {name: value_text(value) for name, value in table.items() if value not in ({}, (), None)}
    return ", ".join(f"{name.replace('_', ' ')} {text}" for name, text in texts.items())
