"""Trees of numbers: nested tuples, lists, mappings and dataclasses of numbers and arrays.

What differs between runs is an input, leaf by leaf; the rest is constant and folds. Any other class is a tree
by a method ``__tree__()``, which returns its parts by name and a function that returns the same object with
other parts. What is no tree is refused by name.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from enum import Enum
from pathlib import PurePath
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np

from .tape import Subroutine, Tape, Traced, UntraceableError, operands
from .traced_array import TracedMask, as_truth, inputs, is_truth, scalar, traced

Tree = TypeVar("Tree")

_NUMBERS = (float, int, np.floating, np.integer, Traced)
"""Classes of numbers; truth values are none."""
_CONSTANTS = (bool, np.bool_, str, bytes, type(None), Enum, PurePath, slice)
"""Classes of values without numbers, which runs share."""
_KINDS_OF_NUMBERS = "iufO"
"""Kinds of numpy's numbers and of traced ones, by the letters of its dtypes."""


class _Kind(NamedTuple):
    """How the trees of a class are read and made.

    Attributes:
        read: Function that returns the parts of a tree, by name.
        make: Function that returns a tree like one, with other parts.
    """

    read: Callable[[Any], Iterable[tuple[Any, Any]]]
    make: Callable[[Any, dict[Any, Any]], Any]


_NUMBER, _MASK, _ARRAY, _CONSTANT = (_Kind(lambda _: (), lambda tree, _: tree) for _ in range(4))
"""Values without parts."""


def leaves(tree: Any) -> list[Any]:
    """Return the numbers of a tree, in order; raises as flattened."""
    return flattened(tree)[0]


def structure(tree: Any) -> Hashable:
    """Return what two trees must share to differ in their numbers only; raises as flattened."""
    return flattened(tree)[1]


Flat: TypeAlias = tuple[list[Any], Hashable]
"""Numbers of a tree, in order, and its structure."""


def flattened(tree: Any, known: Mapping[int, Flat] = MappingProxyType({})) -> Flat:
    """Return the numbers of a tree, in order, and its structure; truth values and texts are no numbers.

    Args:
        tree: Tree.
        known: Parts of it that are flattened already, by ``id``.

    Raises:
        UntraceableError: A part of it is no tree.
    """
    numbers = list[Any]()
    return numbers, _flatten(tree, numbers, dict(known))


def _flatten(
    tree: Any, numbers: list[Any], known: dict[int, tuple[Any, ...]], owner: Any = None, name: object = ""
) -> Hashable:
    """Append the numbers of a tree, a part of an owner, to others, and return its structure."""
    if flat := known.get(id(tree)):
        numbers += flat[0]
        return flat[1]
    kind = _kind_of(tree, owner, name)
    if kind is _NUMBER or kind is _MASK:
        numbers.append(tree)
        return float if kind is _NUMBER else "mask"
    if kind is _ARRAY:
        if tree.dtype.kind not in _KINDS_OF_NUMBERS:
            return tree.shape, tree.tobytes()
        numbers += tree.ravel().tolist()
        if tree.dtype.kind == "O" and any(truths := tuple(map(is_truth, tree.flat))):
            return tree.shape, truths
        return tree.shape
    if kind is _CONSTANT:
        return type(tree), repr(tree)
    first, parts = len(numbers), list[Any]((type(tree),))
    for name, part in kind.read(tree):
        parts.append((name, _flatten(part, numbers, known, tree, name)))
    structure = tuple(parts)
    if hasattr(tree, "__tree__"):  # others may share it; what is gone may leave its id to another
        known[id(tree)] = numbers[first:], structure, tree
    return structure


def rebuilt(tree: Tree, numbers: Iterator[Any]) -> Tree:
    """Return the same tree with other numbers, which stand for truth values where those are leaves."""
    return _mapped(lambda leaf: as_truth(next(numbers)) if is_truth(leaf) else next(numbers), tree)


def valued(tree: Tree, numbers: Iterator[float]) -> Tree:
    """Return the same tree with values: floats, also for truth values, and arrays of them."""
    return _mapped(lambda _: next(numbers), tree)


def _mapped(function: Callable[[Any], Any], tree: Tree, owner: Any = None, name: object = "") -> Tree:
    """Return the same tree, a part of an owner, with a function of each of its leaves, in order."""
    kind = _kind_of(tree, owner, name)
    if kind is _NUMBER or kind is _MASK:
        return cast(Tree, function(tree))
    if isinstance(tree, np.ndarray) and tree.dtype.kind in _KINDS_OF_NUMBERS:
        entries = np.empty(tree.size, dtype=object)
        for index, entry in enumerate(tree.ravel().tolist()):
            entries[index] = function(entry)
        return cast(Tree, traced(entries.reshape(tree.shape)))
    parts = {name: _mapped(function, part, tree, name) for name, part in kind.read(tree)}
    return cast(Tree, kind.make(tree, parts))


def _kind_of(tree: Any, owner: Any = None, name: object = "") -> _Kind:
    """Return the kind of a tree, which is a part of an owner.

    Raises:
        UntraceableError: It is none.
    """
    kind = _kind(tree.__class__)
    if kind is None:
        role = "" if owner is None else f" as {name!r} of {_name(owner)}"
        raise UntraceableError(
            f"holds a {_name(tree)}{role}, which cannot be traced: it is no number, array, text, tuple,"
            " list, mapping, dataclass or object with a method __tree__"
        )
    return kind


@functools.cache  # the checks of classes cost more than the rest
def _kind(kind: Any) -> Any:
    """Return the _Kind of the values of a class; None if they are no trees."""
    if issubclass(kind, TracedMask):
        return _MASK
    if issubclass(kind, _NUMBERS) and not issubclass(kind, bool):
        return _NUMBER
    if issubclass(kind, np.ndarray):
        return _ARRAY
    if issubclass(kind, _CONSTANTS):
        return _CONSTANT
    if hasattr(kind, "__tree__"):
        return _Kind(lambda tree: tree.__tree__()[0].items(), lambda tree, parts: tree.__tree__()[1](parts))
    if dataclasses.is_dataclass(kind):
        names = [field.name for field in dataclasses.fields(kind)]
        return _Kind(_fields(names), lambda tree, parts: dataclasses.replace(tree, **parts))
    if issubclass(kind, Mapping):
        return _Kind(lambda tree: tree.items(), lambda _, parts: kind(parts))
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return _Kind(_fields(kind._fields), lambda _, parts: kind(**parts))
    if issubclass(kind, tuple | list):
        return _Kind(enumerate, lambda _, parts: kind(parts.values()))
    return None


def _fields(names: Iterable[str]) -> Callable[[Any], Iterable[tuple[str, Any]]]:
    return lambda tree: [(name, getattr(tree, name)) for name in names]


def _name(value: Any) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}".removeprefix("builtins.")


class SharedFunctions:
    """Functions of a module of code that are traced once and called wherever the same numbers fold."""

    def __init__(self) -> None:
        self._traced: dict[Hashable, tuple[Subroutine, Any]] = {}

    def call(self, tape: Tape, function: Callable[[Any, Any], Any], constants: Any, arguments: Any) -> Any:
        """Return ``function(constants, arguments)`` by a call of its traced code.

        Args:
            tape: Tape on which to call it.
            function: Function of two trees that returns a tree.
            constants: Tree whose numbers fold into the code; those of them that are traced are arguments.
            arguments: Tree whose numbers are arguments.
        """
        (numbers, kind), (entries, kind_given) = flattened(constants), flattened(arguments)
        folded = [None if isinstance(number, Traced) else float(number) for number in numbers]
        # What is equal but for rounding shares the code.
        rounded = tuple(None if number is None else f"{number:.13e}" for number in folded)
        key = (function, kind, kind_given, rounded)
        if key not in self._traced:
            inner = Tape()
            constants = rebuilt(constants, (inputs(inner) if number is None else number for number in folded))
            result = function(constants, rebuilt(arguments, (inputs(inner) for _ in itertools.count())))
            name = f"{function.__name__}_{len(self._traced)}"
            self._traced[key] = Subroutine(name, inner, operands(inner, leaves(result))), result
        subroutine, result = self._traced[key]
        traced_ones = [number for number in numbers if isinstance(number, Traced)]
        outputs = tape.call(subroutine, operands(tape, [*traced_ones, *entries]))
        return rebuilt(result, (scalar(tape, output) for output in outputs))
