"""Trees of numbers: nested tuples, dataclasses, descriptions and objects whose leaves are numbers.

What differs between runs is found leaf by leaf and becomes an input; the rest is constant and folds.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import itertools
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from types import ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from coop_pin.schema.base import Description
from coop_pin.tracing.tape import Function, Tape, Traced
from coop_pin.tracing.traced_array import traced

Tree = TypeVar("Tree")


def leaves(tree: Any) -> list[Any]:
    """Return the numbers of a tree, in order; truth values, texts and other objects are no numbers."""
    if is_number(tree):
        return [tree]
    if isinstance(tree, np.ndarray) and tree.dtype != bool:
        return list(tree.ravel().tolist())
    return [leaf for _, part in _parts(tree) for leaf in leaves(part)]


def rebuilt(tree: Tree, numbers: Iterator[Any]) -> Tree:
    """Return the same tree with other numbers."""
    if is_number(tree):
        return next(numbers)
    if isinstance(tree, np.ndarray) and tree.dtype != bool:
        entries = np.empty(tree.size, dtype=object)
        for index in range(tree.size):
            entries[index] = next(numbers)
        return traced(entries.reshape(tree.shape))
    parts = {name: rebuilt(part, numbers) for name, part in _parts(tree)}
    if not parts:
        return tree
    if isinstance(tree, Description):
        return tree.model_copy(update=parts)
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return dataclasses.replace(tree, **parts)
    if not isinstance(tree, Mapping | tuple | list):
        made_of = copy.copy(tree)
        vars(made_of).update(parts)
        return made_of
    values: Any = parts.values()
    if isinstance(tree, Mapping):
        values = zip(tree, values, strict=True)
    made: Any = type(tree)
    return made(*values) if hasattr(tree, "_fields") else made(values)


def structure(tree: Any) -> Hashable:
    """Return what two trees must share to differ in their numbers only."""
    if is_number(tree):
        return float
    if isinstance(tree, np.ndarray) and tree.dtype != bool:
        return tree.shape
    parts = list(_parts(tree))
    if isinstance(tree, tuple | list | Mapping) or parts:
        return (type(tree), *((name, structure(part)) for name, part in parts))
    return tree.tobytes() if isinstance(tree, np.ndarray) else tree


def is_number(value: Any) -> bool:
    """Return whether a value is a number, traced or not, but no truth value."""
    return isinstance(value, (float, Traced, int, np.floating)) and not isinstance(value, bool)


def _parts(tree: Any) -> Iterable[tuple[str, Any]]:
    """Return the parts of a tree by name; none for a value without numbers."""
    return _reader(cast(Any, type(tree)))(tree)


@functools.cache  # the checks of classes cost more than the rest
def _reader(kind: Any) -> Callable[[Any], Iterable[tuple[str, Any]]]:
    """Return what gives the parts of the trees of a class."""
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    names = kind.model_fields if issubclass(kind, Description) else [field.name for field in fields]
    if names:
        return lambda tree: [(name, getattr(tree, name)) for name in names]
    if issubclass(kind, Mapping):
        return lambda tree: [(str(name), part) for name, part in tree.items()]
    if issubclass(kind, tuple | list):
        return lambda tree: zip(getattr(kind, "_fields", map(str, range(len(tree)))), tree, strict=True)
    is_other = issubclass(kind, np.ndarray | type | ModuleType) or kind.__dictoffset__ == 0
    if is_other or any("__call__" in vars(base) for base in kind.__mro__):
        return lambda _: ()
    return lambda tree: vars(tree).items()  # of an object with attributes, such as a controller


class SharedFunctions:
    """Functions of a module of code that are traced once and called for every arm of the same model."""

    def __init__(self) -> None:
        self._known: dict[Hashable, tuple[Function, Any]] = {}

    def call(self, tape: Tape, function: Callable[[Any, Any], Any], constants: Any, arguments: Any) -> Any:
        """Return ``function(constants, arguments)`` by a call of its traced code.

        Args:
            tape: on which to call it.
            function: from two trees to a tree.
            constants: fold into the code; those of them that are traced are arguments.
            arguments: always arguments.
        """
        numbers = leaves(constants)
        folded = [None if isinstance(number, Traced) else float(number) for number in numbers]
        # Equal robots in one Pinocchio tree differ by rounding.
        rounded = tuple(None if number is None else f"{number:.13e}" for number in folded)
        key = (function, structure(constants), structure(arguments), rounded)
        if key not in self._known:
            inner = Tape()
            inside = rebuilt(constants, (inner.input() if f is None else f for f in folded))
            result = function(inside, rebuilt(arguments, (inner.input() for _ in itertools.count())))
            name = f"{function.__name__}_{len(self._known)}"
            self._known[key] = Function(name, inner, leaves(result)), result
        code, result = self._known[key]
        given = [number for number in numbers if isinstance(number, Traced)]
        return rebuilt(result, iter(code(tape, [*given, *leaves(arguments)])))
