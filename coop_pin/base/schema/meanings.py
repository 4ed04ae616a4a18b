"""Meanings of the fields of configuration classes, read from their docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel


def described(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the configuration classes that a type contains, in its order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from described(inner)


def kinds(annotation: Any) -> tuple[str, ...]:
    """Return the kinds among which the ``kind`` of a field selects; none for a field of one class."""
    classes = [one for one in described(annotation) if "kind" in one.model_fields]
    names = dict.fromkeys(str(one.model_fields["kind"].default) for one in classes)
    return tuple(names) if len(classes) > 1 else ()


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
