"""Trees of numbers: nested tuples, lists, mappings, dataclasses and Descriptions of numbers and arrays.

What differs between runs is found leaf by leaf and becomes an input; the rest is constant and folds. The
attributes of an ordinary object, such as a controller, are a tree, too; what is no tree is refused by name.
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
from numpy.typing import NDArray

from coop_pin.base.errors import TracingError
from coop_pin.base.schema.base import Description
from coop_pin.tracing.tape import Subroutine, Tape, Traced, operands
from coop_pin.tracing.traced_array import TracedMask, as_truth, inputs, is_truth, scalar, traced

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
        TracingError: A part of it is no tree.
    """
    numbers = list[Any]()
    return numbers, _flatten(tree, numbers, dict(known))


def _flatten(tree: Any, numbers: list[Any], known: dict[int, Flat]) -> Hashable:
    """Append the numbers of a tree to others, and return its structure."""
    if flat := known.get(id(tree)):
        numbers += flat[0]
        return flat[1]
    kind = _kind(tree.__class__)
    if kind is _NUMBER or kind is _MASK:
        numbers.append(tree)
        return float if kind is _NUMBER else "mask"
    if kind is _ARRAY:
        if not _has_numbers(tree):
            return tree.shape, tree.tobytes()
        numbers += tree.ravel().tolist()
        if tree.dtype.kind == "O" and any(truths := tuple(map(is_truth, tree.flat))):
            return tree.shape, truths
        return tree.shape
    if kind is _CONSTANT:
        return type(tree), repr(tree)
    first, parts = len(numbers), list[Any]((type(tree),))
    for name, part in kind.read(tree) if kind else _parts(tree):
        if _kind(part.__class__) is None:
            _parts(tree)  # tells which
        parts.append((name, _flatten(part, numbers, known)))
    structure = tuple(parts)
    if isinstance(tree, Description):
        known[id(tree)] = numbers[first:], structure  # arms share their gains
    return structure


def rebuilt(tree: Tree, numbers: Iterator[Any]) -> Tree:
    """Return the same tree with other numbers, which stand for truth values where those are leaves."""
    return _mapped(lambda leaf: as_truth(next(numbers)) if is_truth(leaf) else next(numbers), tree)


def valued(tree: Tree, numbers: Iterator[float]) -> Tree:
    """Return the same tree with values: floats, also for truth values, and arrays of them."""
    return _mapped(lambda _: next(numbers), tree)


def _mapped(function: Callable[[Any], Any], tree: Tree) -> Tree:
    """Return the same tree with a function of each of its leaves, in order."""
    kind = _kind(cast(Any, tree).__class__)
    if kind is _NUMBER or kind is _MASK:
        return cast(Tree, function(tree))
    if isinstance(tree, np.ndarray) and _has_numbers(tree):
        entries = np.empty(tree.size, dtype=object)
        for index, entry in enumerate(tree.ravel().tolist()):
            entries[index] = function(entry)
        return cast(Tree, traced(entries.reshape(tree.shape)))
    return cast(Tree, kind.make(tree, {name: _mapped(function, part) for name, part in _parts(tree)}))


def require_state(tree: Any) -> None:
    """Refuse a law's state that is or holds an object other than the trees of this module.

    Raises:
        TracingError: It does.
    """
    kind = _kind(tree.__class__)
    if kind is None or kind is _OBJECT:
        kinds = "numbers, arrays, texts, tuples, lists, mappings and dataclasses"
        raise TracingError(f"keeps a {_name(tree)} in its state, which may consist of {kinds}")
    for _, part in kind.read(tree):
        require_state(part)


def _has_numbers(array: NDArray[Any]) -> bool:
    return array.dtype.kind in _KINDS_OF_NUMBERS


def _parts(tree: Any) -> list[tuple[Any, Any]]:
    """Return the parts of a tree by name, which are trees; none of a value without parts."""
    kind = _kind(tree.__class__)
    parts = list(kind.read(tree)) if kind else [("itself", tree)]
    for name, part in parts:
        if _kind(part.__class__) is None:
            raise TracingError(
                f"attribute {name!r} of {_name(tree)} is a {_name(part)}, which cannot be traced: it is no"
                " number, array, text, tuple, list, mapping, dataclass, or object of such attributes"
            )
    return parts


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
    if issubclass(kind, Description):
        return _Kind(_fields(kind.model_fields), lambda tree, parts: tree.model_copy(update=parts))
    if dataclasses.is_dataclass(kind):
        names = [field.name for field in dataclasses.fields(kind)]
        return _Kind(_fields(names), lambda tree, parts: dataclasses.replace(tree, **parts))
    if issubclass(kind, Mapping):
        return _Kind(lambda tree: tree.items(), lambda _, parts: kind(parts))
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return _Kind(_fields(kind._fields), lambda _, parts: kind(**parts))
    if issubclass(kind, tuple | list):
        return _Kind(enumerate, lambda _, parts: kind(parts.values()))
    members = {name for base in kind.__mro__ for name in vars(base)}
    has_slots = any(vars(base).get("__slots__") for base in kind.__mro__)
    is_of_python = kind.__new__ is object.__new__ and "__dict__" in members
    return _OBJECT if is_of_python and not has_slots and "__call__" not in members else None


def _fields(names: Iterable[str]) -> Callable[[Any], Iterable[tuple[str, Any]]]:
    return lambda tree: [(name, getattr(tree, name)) for name in names]


def _with_attributes(instance: Any, attributes: dict[str, Any]) -> Any:
    """Return an object of the same class with these attributes; its constructor is not called."""
    made = object.__new__(type(instance))
    vars(made).update(attributes)
    return made


_OBJECT = _Kind(lambda instance: vars(instance).items(), _with_attributes)
"""Ordinary objects, such as controllers: the only place where the attributes of an object are read."""


def _name(value: Any) -> str:
    kind = type(value)
    return f"{kind.__module__}.{kind.__qualname__}".removeprefix("builtins.")


class SharedFunctions:
    """Functions of a module of code that are traced once and called for every arm of the same model."""

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
        # Equal robots in one Pinocchio tree differ by rounding.
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
