"""Arrays of traced scalars: numpy's functions on them (NEP 13 and NEP 18) record operations."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import comparisons, elementary
from .tape import Number, Operand, Tape, Traced, UntraceableError, apply


class Recording:
    """Base of what records numpy's ufuncs and functions."""

    __slots__ = ()

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        with _refusals(inputs):
            return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        with _refusals(args):
            return _function(func, args, kwargs)


@contextlib.contextmanager
def _refusals(values: Any) -> Iterator[None]:
    """Note errors on the tapes of traced scalars among values: the code that is traced may catch them."""
    try:
        if {"raise", "call"} & {*np.geterr().values()} and any(tape.is_exact for tape in _tapes(values)):
            raise UntraceableError("computes where numpy.errstate raises or calls, unlike compiled code")
        yield
    except Exception as error:
        for tape in _tapes(values):
            tape.refusals.append(error)
        raise


def _tapes(values: Any) -> Iterator[Tape]:
    if isinstance(values, Traced):
        yield values.tape
    elif isinstance(values, list | tuple | np.ndarray):
        for value in values.ravel().tolist() if isinstance(values, np.ndarray) else values:
            yield from _tapes(value)


class TracedScalar(Recording, Traced):
    """Traced scalar that records numpy's ufuncs and functions."""

    __slots__ = ()


class TracedMask(TracedScalar):
    """Traced truth value, 0 or 1: a number together with others; among themselves, only logic is defined."""

    __slots__ = ()

    def apply(self, name: str, *numbers: Number) -> Number:
        """Return the result of an operation of FOLD, which is a number."""
        return TracedScalar(self.tape, self.index).apply(name, *numbers)


class TracedArray(Recording, np.ndarray[Any, np.dtype[np.object_]]):
    """Array of traced scalars and constants.

    Arithmetic, dot and matmul are numpy's own, on objects; ufuncs that decide by values are those below.
    """

    __array_priority__ = 100.0


def scalar(tape: Tape, operand: Operand) -> Number:
    """Return an operand of a tape as a number."""
    return operand if isinstance(operand, float) else TracedScalar(tape, operand)


def traced(values: ArrayLike) -> Any:
    """Return numbers as a TracedArray, or as a float array if all are constants, or as the number itself."""
    array = plain(values)
    if not any(isinstance(value, Traced) for value in array.flat):
        constants = array.astype(bool if array.size and all(map(is_truth, array.flat)) else np.float64)
        return constants if constants.ndim else constants.item()
    return array.view(TracedArray) if array.ndim else array[()]


def plain(values: Any) -> NDArray[Any]:
    """Return numbers as an object array of numpy itself."""
    if isinstance(
        values, Traced | np.floating
    ):  # of numpy's scalars, numpy would ask for the operation again
        scalar = np.empty((), dtype=object)
        scalar[()] = values if isinstance(values, Traced) else float(values)
        return scalar
    return np.asarray(values, dtype=object).view(np.ndarray)


def is_truth(value: Any) -> bool:
    """Return whether a value is a truth value, traced or not."""
    return isinstance(value, TracedMask | bool | np.bool_)


def as_truth(value: Number) -> Any:
    """Return a number that is 0 or 1 as a truth value."""
    return TracedMask(value.tape, value.index) if isinstance(value, Traced) else bool(value)


def masks(values: Any) -> Any:
    """Return numbers that are 0 or 1 as truth values."""
    return traced(np.frompyfunc(as_truth, 1, 1)(plain(values)))


def parts(values: Any, sizes: Sequence[int]) -> list[Any]:
    """Return consecutive parts of numbers, of the given sizes."""
    return [traced(part) for part in np.split(np.asarray(values, dtype=object), np.cumsum(sizes)[:-1])]


def inputs(tape: Tape, *shape: int) -> Any:
    """Return new inputs of a tape as a TracedArray, or as a scalar for the shape ()."""
    array = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        array[index] = scalar(tape, tape.input())
    return traced(array)


# ---------------------------------------------------------------- numpy's ufuncs and functions

_ARITHMETIC: dict[np.ufunc, Callable[..., Number]] = {
    np.add: partial(apply, "add"),
    np.subtract: partial(apply, "sub"),
    np.multiply: partial(apply, "mul"),
    np.divide: partial(apply, "div"),
    np.negative: partial(apply, "neg"),
    np.absolute: partial(apply, "abs"),
    np.square: lambda x: x * x,
    np.power: elementary.power,
    np.sqrt: elementary.sqrt,
    np.exp: elementary.exp,
    np.expm1: elementary.expm1,
    np.log: elementary.log,
    np.rint: elementary.rint,
    np.sin: elementary.sin,
    np.cos: elementary.cos,
    np.tanh: elementary.tanh,
    np.arctan2: elementary.atan2,
    np.sign: comparisons.sign,
    np.minimum: comparisons.minimum,
    np.maximum: comparisons.maximum,
}
_COMPARISONS: dict[np.ufunc, Callable[..., Number]] = {
    np.less: comparisons.less,
    np.greater: lambda a, b: comparisons.less(b, a),
    np.less_equal: comparisons.less_equal,
    np.greater_equal: lambda a, b: comparisons.less_equal(b, a),
    np.not_equal: lambda a, b: comparisons.opposite(comparisons.equal(a, b)),
    np.equal: comparisons.equal,
}
_LOGIC: dict[np.ufunc, Callable[..., Number]] = {
    np.invert: comparisons.opposite,
    np.logical_not: comparisons.opposite,
    np.bitwise_and: comparisons.both,
    np.logical_and: comparisons.both,
    np.bitwise_or: comparisons.either,
    np.logical_or: comparisons.either,
}

UFUNCS = {*_ARITHMETIC, *_COMPARISONS, *_LOGIC}
"""Ufuncs of numpy that can be traced."""


def _entrywise(ufunc: np.ufunc, *values: Any) -> Any:
    """Return the result of a ufunc for scalars."""
    if ufunc in _COMPARISONS:
        return as_truth(_COMPARISONS[ufunc](*values))
    are_truths = all(map(is_truth, values))
    if ufunc in _LOGIC:
        if not are_truths:
            raise UntraceableError(f"calls numpy.{ufunc.__name__} with numbers; give it comparisons")
        return as_truth(_LOGIC[ufunc](*values))
    if not are_truths:
        return _ARITHMETIC[ufunc](*values)
    if ufunc is np.multiply:
        return as_truth(comparisons.both(*values))
    raise UntraceableError(
        f"calls numpy.{ufunc.__name__} with truth values only; write & | numpy.logical_not, or"
        " where(condition, 1.0, 0.0) for a number"
    )


def _of_scalars(ufunc: np.ufunc, *values: Any) -> Any:
    """Return the result of a ufunc for scalars that may be Python's, which differ from those of arrays."""
    if ufunc is np.invert:
        raise UntraceableError(
            "writes ~ before a single truth value, -2 of Python's True; call numpy.logical_not"
        )
    if ufunc is np.divide and isinstance(values[1], Traced) and values[1].tape.is_exact:
        values[1].tape.guards.append(comparisons.opposite(comparisons.equal(values[1], 0.0)))
    return _entrywise(ufunc, *values)


def _ufunc(ufunc: np.ufunc, method: str, arguments: Sequence[Any], options: Mapping[str, Any]) -> Any:
    """Return the result of a ufunc; matmul and sums are numpy's own, by Python's operators on the entries."""
    if method == "__call__" and ufunc in UFUNCS and not options:
        if all(isinstance(argument, Traced | float | int | np.bool_) for argument in arguments):
            return _of_scalars(ufunc, *arguments)
        arrays = [plain(argument) for argument in arguments]
        return traced(np.frompyfunc(partial(_entrywise, ufunc), len(arrays), 1)(*arrays))
    if method == "reduce" and ufunc is np.logical_or:
        return _any(arguments[0])
    is_sum = method == "reduce" and ufunc in (np.add, np.multiply)
    if (is_sum or ufunc is np.matmul) and "out" not in options:
        return traced(getattr(ufunc, method)(*map(plain, arguments), **options))
    raise UntraceableError(f"calls numpy.{ufunc.__name__} ({method}), which cannot be traced")


def _any(masks: Any) -> Any:
    return reduce(partial(_entrywise, np.logical_or), plain(masks).flat, False)


def _chosen(mask: Number, a: Number, b: Number) -> Any:
    if not is_truth(mask):
        mask = comparisons.opposite(comparisons.equal(mask, 0.0))
    value = comparisons.select(mask, a, b)
    return as_truth(value) if is_truth(a) and is_truth(b) else value


def _vdot(a: Any, b: Any) -> Number:
    pairs = zip(plain(a).flat, plain(b).flat, strict=True)
    return reduce(lambda total, pair: total + pair[0] * pair[1], pairs, 0.0)


FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: lambda mask, a, b: traced(np.frompyfunc(_chosen, 3, 1)(*map(plain, (mask, a, b)))),
    np.vdot: _vdot,
    np.any: _any,
    np.clip: lambda a, low, high: np.minimum(np.maximum(traced(a), low), high),
    np.round: lambda x: np.rint(traced(x)),
    np.linalg.inv: lambda A: traced(elementary.inverse(plain(A))),
    np.zeros_like: lambda a: traced(np.zeros(np.shape(a))).astype(object).view(TracedArray),
    np.array: traced,  # by np.array(values, like=a)
    np.shape: lambda a: plain(a).shape,
    np.ndim: lambda a: plain(a).ndim,
}
"""Functions of numpy by what records them."""

REARRANGING = {
    np.concatenate,
    np.stack,
    np.vstack,
    np.hstack,
    np.swapaxes,
    np.transpose,
    np.reshape,
    np.ravel,
    np.split,
    np.array_split,
    np.diag,
    np.diagonal,
    np.outer,
    np.cross,
    np.dot,
    np.sum,
    np.trace,
    np.broadcast_to,
    np.append,
    np.atleast_1d,
    np.block,
    np.linalg.multi_dot,
}
"""Functions that move entries, or add and multiply them: numpy's own work on objects."""


def _norm(x: Any, axis: int = -1, keepdims: bool = False) -> Any:
    return np.sqrt(traced((plain(x) ** 2).sum(axis=axis, keepdims=keepdims)))


INEXACT: dict[Any, Callable[..., Any]] = {
    np.einsum: lambda subscripts, *arrays: traced(np.einsum(subscripts, *map(plain, arrays))),
    np.linalg.norm: _norm,
    np.nan_to_num: lambda x: traced(
        [y if isinstance(y, Traced) else np.nan_to_num(y) for y in plain(x).flat]
    ).reshape(x.shape),
}
"""Functions whose rounding, or values at NaN, are not numpy's: not for code that must be exact."""


def _function(func: Any, args: Any, kwargs: Any) -> Any:
    if func in FUNCTIONS and not kwargs:
        return FUNCTIONS[func](*args)
    if func in INEXACT and not any(tape.is_exact for tape in _tapes(args)):
        return INEXACT[func](*args, **kwargs)
    if func in REARRANGING:
        result = func(*_plainly(args), **kwargs)
        return [traced(part) for part in result] if isinstance(result, list) else traced(result)
    raise UntraceableError(f"calls numpy.{func.__name__}, which cannot be traced")


def _plainly(args: Any) -> Iterator[Any]:
    for arg in args:
        if isinstance(arg, (list, tuple)) and any(hasattr(part, "__array_function__") for part in arg):
            yield [plain(part) for part in arg]
        else:
            yield plain(arg) if isinstance(arg, (TracedArray, Traced)) else arg
