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
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from coop_pin.errors import TracingError
from coop_pin.schema.base import Description
from coop_pin.tracing.tape import Subroutine, Tape, Traced, operands
from coop_pin.tracing.traced_array import inputs, scalar, traced

Tree = TypeVar("Tree")

_CONSTANTS = (bool, np.bool_, str, bytes, type(None), Enum, PurePath, slice)
"""Classes of values without numbers, which runs share."""
_KINDS_OF_NUMBERS = "iufO"
"""Kinds of numpy's numbers and of traced ones, by the letters of its dtypes."""


def leaves(tree: Any) -> list[Any]:
    """Return the numbers of a tree, in order; truth values and texts are no numbers.

    Raises:
        TracingError: A part of it is no tree.
    """
    if is_number(tree):
        return [tree]
    if isinstance(tree, np.ndarray):
        return list(tree.ravel().tolist()) if _has_numbers(tree) else []
    return [leaf for _, part in _parts(tree) for leaf in leaves(part)]


def rebuilt(tree: Tree, numbers: Iterator[Any]) -> Tree:
    """Return the same tree with other numbers."""
    kind: Any = type(tree)
    if is_number(tree):
        return next(numbers)
    if isinstance(tree, np.ndarray) and _has_numbers(tree):
        entries = np.empty(tree.size, dtype=object)
        for index in range(tree.size):
            entries[index] = next(numbers)
        return traced(entries.reshape(tree.shape))
    parts = {name: rebuilt(part, numbers) for name, part in _parts(tree)}
    if not parts:
        return tree
    if isinstance(tree, Mapping):
        return kind(dict(zip(tree, parts.values(), strict=True)))
    if isinstance(tree, tuple | list):
        return kind(*parts.values()) if hasattr(tree, "_fields") else kind(parts.values())
    if isinstance(tree, Description):
        return tree.model_copy(update=parts)
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        return dataclasses.replace(tree, **parts)
    instance: Tree = object.__new__(kind)
    vars(instance).update(parts)
    return instance


def structure(tree: Any) -> Hashable:
    """Return what two trees must share to differ in their numbers only; raises as leaves."""
    if is_number(tree):
        return float
    if isinstance(tree, np.ndarray):
        return tree.shape if _has_numbers(tree) else (tree.shape, tree.tobytes())
    if isinstance(tree, _CONSTANTS):
        return type(tree), repr(tree)
    return (type(tree), *((name, structure(part)) for name, part in _parts(tree)))


def is_number(value: Any) -> bool:
    """Return whether a value is a number, traced or not, but no truth value."""
    return isinstance(value, (float, Traced, int, np.floating, np.integer)) and not isinstance(value, bool)


def require_state(tree: Any) -> None:
    """Refuse a law's state that is or holds an object other than the trees of this module.

    Raises:
        TracingError: It does.
    """
    kind: Any = type(tree)
    read = _reader(kind)
    if read is None or read is _attributes:
        kinds = "numbers, arrays, texts, tuples, lists, mappings and dataclasses"
        raise TracingError(f"keeps a {_name(tree)} in its state, which may consist of {kinds}")
    for _, part in read(tree):
        require_state(part)


def _has_numbers(array: NDArray[Any]) -> bool:
    return array.dtype.kind in _KINDS_OF_NUMBERS


def _parts(tree: Any) -> Iterable[tuple[str, Any]]:
    """Return the parts of a tree by name; none of a value without parts."""
    kind: Any = type(tree)
    read = _reader(kind)
    parts = list(read(tree)) if read else [("itself", tree)]
    for name, part in parts:
        kind = type(part)
        if _reader(kind) is None:
            raise TracingError(
                f"attribute {name!r} of {_name(tree)} is a {_name(part)}, which cannot be traced: it is no"
                " number, array, text, tuple, list, mapping, dataclass, or object of such attributes"
            )
    return parts


@functools.cache  # the checks of classes cost more than the rest
def _reader(kind: Any) -> Callable[[Any], Iterable[tuple[str, Any]]] | None:
    """Return the function that returns the parts of the values of a class; None if they are no trees."""
    if issubclass(kind, (float, int, np.number, Traced, np.ndarray, *_CONSTANTS)):
        return lambda _: ()
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    names = kind.model_fields if issubclass(kind, Description) else [field.name for field in fields]
    if names:
        return lambda tree: [(name, getattr(tree, name)) for name in names]
    if issubclass(kind, Mapping):
        return lambda tree: [(str(name), part) for name, part in tree.items()]
    if issubclass(kind, tuple | list):
        return lambda tree: zip(getattr(kind, "_fields", map(str, range(len(tree)))), tree, strict=True)
    members = {name for base in kind.__mro__ for name in vars(base)}
    has_slots = any(vars(base).get("__slots__") for base in kind.__mro__)
    has_state = kind.__new__ is not object.__new__ or "__dict__" not in members or has_slots
    return None if has_state or "__call__" in members else _attributes


def _attributes(instance: object) -> Iterable[tuple[str, Any]]:
    """Return the attributes of an ordinary object, such as a controller; no other function reads them."""
    return vars(instance).items()


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
        numbers = leaves(constants)
        folded = [None if isinstance(number, Traced) else float(number) for number in numbers]
        # Equal robots in one Pinocchio tree differ by rounding.
        rounded = tuple(None if number is None else f"{number:.13e}" for number in folded)
        key = (function, structure(constants), structure(arguments), rounded)
        if key not in self._traced:
            inner = Tape()
            constants = rebuilt(constants, (inputs(inner) if number is None else number for number in folded))
            result = function(constants, rebuilt(arguments, (inputs(inner) for _ in itertools.count())))
            name = f"{function.__name__}_{len(self._traced)}"
            self._traced[key] = Subroutine(name, inner, operands(inner, leaves(result))), result
        subroutine, result = self._traced[key]
        traced_ones = [number for number in numbers if isinstance(number, Traced)]
        outputs = tape.call(subroutine, operands(tape, [*traced_ones, *leaves(arguments)]))
        return rebuilt(result, (scalar(tape, output) for output in outputs))
