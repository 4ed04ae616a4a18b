"""Arrays of traced scalars: numpy's functions on them (NEP 13 and NEP 18) record operations."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_pin.errors import TracingError
from coop_pin.tracing import elementary
from coop_pin.tracing.tape import Number, Operand, Tape, Traced


class Recording:
    """Base of what records numpy's ufuncs and functions."""

    __slots__ = ()

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return _ufunc(ufunc, method, inputs, options)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return _function(func, args, kwargs)


class TracedScalar(Recording, Traced):
    """Traced scalar that records numpy's ufuncs and functions."""

    __slots__ = ()


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
        constants = array.astype(np.float64)
        return constants if constants.ndim else float(constants)
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

_ENTRYWISE: dict[np.ufunc, Callable[..., Number]] = {
    np.add: partial(elementary.apply, "add"),
    np.subtract: partial(elementary.apply, "sub"),
    np.multiply: partial(elementary.apply, "mul"),
    np.divide: partial(elementary.apply, "div"),
    np.negative: partial(elementary.apply, "neg"),
    np.absolute: partial(elementary.apply, "abs"),
    np.square: lambda x: x * x,
    np.power: elementary.power,
    np.sqrt: elementary.sqrt,
    np.exp: elementary.exp,
    np.expm1: elementary.expm1,
    np.log: elementary.log,
    np.rint: elementary.rounded,
    np.sin: elementary.sin,
    np.cos: elementary.cos,
    np.tanh: elementary.tanh,
    np.arctan2: elementary.atan2,
    np.sign: elementary.sign,
    np.minimum: elementary.minimum,
    np.maximum: elementary.maximum,
    np.less: elementary.less,
    np.greater: lambda a, b: elementary.less(b, a),
    np.less_equal: lambda a, b: 1.0 - elementary.less(b, a),
    np.greater_equal: lambda a, b: 1.0 - elementary.less(a, b),
    np.not_equal: elementary.differs,
    np.equal: lambda a, b: 1.0 - elementary.differs(a, b),
    np.invert: lambda mask: 1.0 - mask,
    np.logical_not: lambda mask: 1.0 - mask,
    np.bitwise_and: lambda a, b: a * b,
    np.logical_and: lambda a, b: a * b,
    np.bitwise_or: elementary.maximum,
    np.logical_or: elementary.maximum,
}


def _ufunc(ufunc: np.ufunc, method: str, arguments: Sequence[Any], options: Mapping[str, Any]) -> Any:
    """Return the result of a ufunc; matmul and sums are numpy's own, by Python's operators on the entries."""
    if method == "__call__" and ufunc in _ENTRYWISE and not options:
        if all(isinstance(argument, Traced | float) for argument in arguments):
            return _ENTRYWISE[ufunc](*arguments)
        arrays = [plain(argument) for argument in arguments]
        return traced(np.frompyfunc(_ENTRYWISE[ufunc], len(arrays), 1)(*arrays))
    if method == "reduce" and ufunc is np.logical_or:
        return _any(arguments[0])
    is_sum = method == "reduce" and ufunc in (np.add, np.multiply)
    if (is_sum or ufunc is np.matmul) and "out" not in options:
        return traced(getattr(ufunc, method)(*map(plain, arguments), **options))
    raise TracingError(f"calls numpy.{ufunc.__name__} ({method}), which cannot be traced")


def _any(masks: Any) -> Number:
    result: Number = 0.0
    for mask in plain(masks).flat:
        result = elementary.maximum(result, mask)
    return result


def _where(mask: Any, a: Any, b: Any) -> Any:
    return traced(np.frompyfunc(elementary.select, 3, 1)(plain(mask), plain(a), plain(b)))


def _vdot(a: Any, b: Any) -> Number:
    total: Number = 0.0
    for x, y in zip(plain(a).flat, plain(b).flat, strict=True):
        total = total + x * y
    return total


def _clip(a: Any, low: Any, high: Any) -> Any:
    return np.minimum(np.maximum(traced(a), low), high)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.vdot: _vdot,
    np.any: _any,
    np.clip: _clip,
    np.round: lambda x: np.rint(traced(x)),
    np.linalg.inv: lambda A: traced(elementary.inverse(plain(A))),
    np.zeros_like: lambda a: traced(np.zeros(np.shape(a))).astype(object).view(TracedArray),
    np.shape: lambda a: plain(a).shape,
    np.ndim: lambda a: plain(a).ndim,
}

_REARRANGING = {
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


def _function(func: Any, args: Any, kwargs: Any) -> Any:
    if func in _FUNCTIONS and not kwargs:
        return _FUNCTIONS[func](*args)
    if func in _REARRANGING:
        result = func(*_plainly(args), **kwargs)
        return [traced(part) for part in result] if isinstance(result, list) else traced(result)
    raise TracingError(f"calls numpy.{func.__name__}, which cannot be traced")


def _plainly(args: Any) -> Iterator[Any]:
    for arg in args:
        if isinstance(arg, (list, tuple)) and any(hasattr(part, "__array_function__") for part in arg):
            yield [plain(part) for part in arg]
        else:
            yield plain(arg) if isinstance(arg, (TracedArray, Traced)) else arg
