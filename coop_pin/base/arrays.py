"""Arrays: validation of arguments by name (type, shape, finiteness, sign, pose), and means."""

from __future__ import annotations

import errno
import functools
import inspect
import math
import numbers
import os
import sys
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_pin.base.errors import (
    ArgumentError,
    NameNotFoundError,
    OutOfRangeError,
    ShapeError,
    WrongTypeError,
)
from coop_pin.base.memory import require_memory

Array: TypeAlias = NDArray[np.float64]
"""A float64 array."""

Entry = TypeVar("Entry", bound=np.generic)

Mask: TypeAlias = NDArray[np.bool_]
"""A boolean array."""

Function = TypeVar("Function", bound=Callable[..., Any])

_NUMBERS: dict[Any, Any] = {float: numbers.Real, int: numbers.Integral}

POSE_ALLOWED = 1e-6
"""Largest accepted entry of R^T R - I: poses typed to seven digits pass."""


def as_array(name: str, value: ArrayLike, *shape: int | str) -> Array:
    """Return value as a new float64 array of a stated shape with finite entries.

    Args:
        name: the argument's name, for the error message.
        value: anything numpy can convert.
        shape: the expected sizes; a string accepts any size and documents it.

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite.
        ArgumentError: entries are texts, truth values, complex or masked.
    """
    try:
        array = real_numbers(name, value, "fiuO").astype(np.float64)
    except OverflowError:
        raise OutOfRangeError(name, math.inf, "a finite number") from None
    except ArgumentError:
        raise
    except (ValueError, TypeError):
        if (actual := np.shape(np.array(value, dtype=object))) == shape:
            kind = f"an object of type {type(value).__name__}"
            raise ArgumentError(f"{name} is or contains {kind}; it must be real numbers") from None
        raise ShapeError(name, actual, shape) from None
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(isinstance(size, int) and size != have for have, size in zip(array.shape, shape, strict=True))
    ):
        raise ShapeError(name, array.shape, shape)
    if not math.isfinite(np.vdot(array, array)) and not (finite := np.isfinite(array)).all():
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise OutOfRangeError(name, float(array[index]), "a finite number", index)
    return array


def real_numbers(name: str, value: object, kinds: str = "fiu") -> NDArray[Any]:
    """Return value as an array of numbers that are real.

    Args:
        name: the argument's name, for the error message.
        value: anything numpy can convert.
        kinds: kinds of entries that are accepted, as in numpy's ``dtype.kind``.

    Raises:
        ArgumentError: entries are texts, truth values, complex or masked.
    """
    array = np.asarray(value)
    is_masked = isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value)
    if is_masked or array.dtype.kind not in kinds:
        kind = "masked" if is_masked else f"of type {array.dtype}"
        raise ArgumentError(f"{name} has entries {kind}; they must be real numbers")
    return array


def as_positive(name: str, value: ArrayLike) -> float:
    """Return value as a finite float greater than zero.

    Raises:
        ShapeError: it is not a single number.
        OutOfRangeError: it is NaN or infinite; it is zero or less.
    """
    number = as_number(name, value)
    if number <= 0.0:
        raise OutOfRangeError(name, number)
    return number


def as_pose(name: str, value: ArrayLike) -> Array:
    """Return value as a new pose, a 4x4 homogeneous matrix.

    Raises:
        ShapeError: the shape differs.
        OutOfRangeError: an entry is NaN or infinite, the 3x3 block no rotation, or the last row not 0 0 0 1.
    """
    X = as_array(name, value, 4, 4)
    R, last_row = X[:3, :3], np.array((0.0, 0.0, 0.0, 1.0))
    deviation = float(max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(X[3] - last_row).max()))
    name, deviation = (f"{name} (a mirror image)", 2.0) if np.linalg.det(R) < 0.0 else (name, deviation)
    if deviation > POSE_ALLOWED:
        allowed = f"at most {POSE_ALLOWED:.3g}: build it with cp.spatial.make_pose"
        raise OutOfRangeError(f"the deviation of {name} from a pose", deviation, allowed)
    return X


def require_type(name: str, value: object, *kinds: type) -> None:
    """Refuse an argument of a wrong class.

    Args:
        name: the argument's name, for the error message.
        value: the argument.
        kinds: the accepted classes.

    Raises:
        WrongTypeError: it is an instance of none of them.
    """
    if not isinstance(value, kinds):
        raise WrongTypeError(name, type(value).__name__, " or ".join(kind.__name__ for kind in kinds))


def typed(function: Function) -> Function:
    """Return a function that refuses arguments of other classes than it states.

    For public functions that take objects of the package and texts. Entries of collections and the sizes of
    arrays and numbers are the function's to check.

    Args:
        function: function with annotations; of callables and arrays, anything passes.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        for name, value in signature.bind(*args, **options).arguments.items():
            kinds, parameter = _kinds(function, name), signature.parameters[name]
            for one in value if parameter.kind is parameter.VAR_POSITIONAL else (value,):
                if kinds and not isinstance(one, kinds):
                    stated = str(parameter.annotation).replace(" | ", " or ")
                    raise WrongTypeError(name, type(one).__name__, stated)
        return function(*args, **options)

    return cast(Function, call)


@functools.cache
def _kinds(function: Callable[..., Any], name: str) -> tuple[type, ...]:
    """Return the classes of an argument; none if any value passes."""
    kinds = [*_classes(typing.get_type_hints(function)[name])]
    return tuple(filter(None, kinds)) if all(kinds) else ()


def _classes(annotation: Any) -> Iterator[type | None]:
    """Yield the classes of an annotation, None for one that has none."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (typing.Union, types.UnionType):
        for part in parts:
            yield from _classes(part)
    elif origin is typing.Literal:
        yield from map(type, parts)
    else:
        kind = origin or annotation
        is_class = isinstance(kind, type) and kind not in (np.ndarray, type, object)
        yield _NUMBERS.get(kind, kind) if is_class and not getattr(kind, "_is_protocol", False) else None


def require_known(kind: str, name: object, known: Sequence[str], container: str) -> None:
    """Refuse a name that is none of the known ones.

    Raises:
        NameNotFoundError: it is none, or no text.
    """
    if not isinstance(name, str) or name not in known:
        raise NameNotFoundError(kind, cast(str, name), known, container)


def require_path(name: str, value: object) -> None:
    """Refuse an argument that no file system can take as a path.

    Raises:
        WrongTypeError: it is neither a text nor a path.
        ArgumentError: it has a NUL character, or one that cannot be encoded, or is too long.
    """
    require_type(name, value, str, os.PathLike)
    try:
        Path(cast("str | os.PathLike[str]", value)).stat()
    except (ValueError, TypeError):
        raise ArgumentError(
            f"{name} is {value!r}, which no file can be called; remove the special characters"
        ) from None
    except OSError as error:  # most have a meaning for whoever opens the file: it may yet be written
        if error.errno == errno.ENAMETOOLONG:
            raise ArgumentError(f"{name} is longer than the name of a file can be; shorten it") from None


def as_count(name: str, value: object, least: int = 0) -> int:
    """Return value as a whole number.

    Raises:
        WrongTypeError: it is not a whole number, or a truth value.
        OutOfRangeError: it is smaller than ``least``.
    """
    if isinstance(value, bool):
        raise WrongTypeError(name, "bool", "int")
    require_type(name, value, int, np.integer)
    count = int(value)  # type: ignore[call-overload]
    if count < least:
        raise OutOfRangeError(name, max(count, -sys.maxsize), f"at least {least}")
    return count


def as_fitting_count(name: str, value: object, least: int, size: float) -> int:
    """Return value as a whole number of things that fit into the free memory.

    Args:
        name: name of the argument.
        value: the number.
        least: smallest number that is allowed.
        size: size of one of the things, bytes.

    Raises:
        WrongTypeError: it is not a whole number, or a truth value.
        OutOfRangeError: it is smaller than ``least``.
        NotEnoughMemoryError: they do not fit.
    """
    count = as_count(name, value, least)
    require_memory(f"{name} = {min(count, sys.maxsize):.3g}", size * min(count, sys.maxsize), f"lower {name}")
    return count


def as_number(name: str, value: ArrayLike) -> float:
    """Return value as a finite float.

    Raises:
        ShapeError: it is not a single number.
        OutOfRangeError: it is NaN or infinite.
    """
    return float(as_array(name, value))


def require_finite(name: str, values: Array) -> Array:
    """Return a computed array if it is finite.

    Raises:
        OutOfRangeError: an entry is NaN or infinite, because the arguments are beyond what doubles can hold.
    """
    if not math.isfinite(np.vdot(values, values)) and not np.isfinite(values).all():
        raise OutOfRangeError(name, math.nan, "finite; the state, the forces or the masses are too large")
    return values


def shaped(name: str, value: ArrayLike, *trailing: int) -> Array:
    """Return value as an array whose last sizes are stated; its entries are not checked.

    Subclasses of ndarray, such as arrays of traced scalars, answer for their entries themselves.

    Raises:
        ShapeError: the last sizes differ.
    """
    if isinstance(value, np.ndarray):
        array = value
    else:
        array = as_array(name, value, *("..." for _ in np.shape(np.array(value, dtype=object))))
    if array.shape[-len(trailing) :] != trailing or (
        array.dtype.kind not in "fiu" and type(array) is np.ndarray
    ):
        raise ShapeError(name, array.shape, ("...", *trailing))
    return array


def rms(values: Array) -> Array:
    """Return the root of the mean square along the last axis; NaN when it is empty."""
    return np.sqrt(mean(np.square(values)))


def mean(values: Array) -> Array:
    """Return the mean along the last axis; NaN when it is empty."""
    return np.mean(values, axis=-1) if values.shape[-1] else np.full(values.shape[:-1], np.nan)


def frozen(array: NDArray[Entry]) -> NDArray[Entry]:
    """Return the array itself, made read-only."""
    # A third of the time of array.flags.writeable = False; a tick does it twenty times.
    array.setflags(False)  # type: ignore[call-arg]
    return array
