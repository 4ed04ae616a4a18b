"""Generic numbers: functions that take floats and traced scalars alike, for laws and spatial algebra.

Laws are also traced (coop_pin.compiled): they then compute with scalars that record operations, not values.
Such code uses numpy arithmetic, numpy's ufuncs and the functions below; it has no branch on a value, and
neither ``math`` nor scipy. Traced scalars and arrays answer numpy's functions themselves (NEP 13 and NEP 18),
so that this module needs no knowledge of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Self, TypeVar

import numpy as np

from coop_pin.base.arrays import Array, frozen

Value = TypeVar("Value")


class Traceable:
    """Base of objects of traced code: their attributes are constants or inputs of the code."""

    def __tree__(self) -> tuple[dict[str, Any], Callable[[dict[str, Any]], Self]]:
        """Return the attributes, and a function that makes a copy with others; see coop_pin.tracing.tree."""

        def like(attributes: dict[str, Any]) -> Any:
            copy = object.__new__(type(self))
            vars(copy).update(attributes)
            return copy

        return vars(self), like


def exp(x: float) -> float:
    """Return e^x."""
    return math.exp(x) if isinstance(x, float) else np.exp(x)


def sqrt(x: float) -> float:
    """Return the square root of x >= 0."""
    return math.sqrt(x) if isinstance(x, float) else np.sqrt(x)


def atan2(y: float, x: float) -> float:
    """Return the angle of (x, y), in (-pi, pi]."""
    return math.atan2(y, x) if isinstance(y, float) and isinstance(x, float) else np.arctan2(y, x)


def where(condition: bool, a: Value, b: Value) -> Value:
    """Return a where the condition holds, otherwise b; both are numbers, or tuples of the same size."""
    if isinstance(condition, bool):
        return a if condition else b
    return np.where(condition, a, b)


def known(condition: bool) -> bool:
    """Return whether a condition is known to hold: of a traced one nobody knows.

    For a short cut to the same result, which traced code does not take.
    """
    return isinstance(condition, bool | np.bool_) and bool(condition)


def require_less(value: float, limit: float, error: Callable[[float], Exception]) -> None:
    """Raise an error for a value that is not less than a limit, NaN included; traced code notes it."""
    if not isinstance(value, float):
        value.require_less(limit)
    elif not value < limit:
        raise error(float(value))


def inverse(A: Array) -> tuple[Array, float]:
    """Return A^-1 of a square matrix and its condition number ``|A| |A^-1|``; inf for both if it is singular.

    The Frobenius norm gives an upper bound of the usual condition number, at a tenth of its cost. LAPACK is
    called directly: numpy's wrapper around it costs three times the solution.

    Args:
        A: matrix, shape (n, n).
    """
    A_inverse: Array
    if type(A) is not np.ndarray:
        A_inverse = np.linalg.inv(A)  # type: ignore[assignment]
    else:
        _, _, A_inverse, zero_pivot = _solve()(A, identity(len(A)))
        if zero_pivot:
            return np.full(A.shape, np.inf), np.inf
    condition: Any = (np.vdot(A, A) * np.vdot(A_inverse, A_inverse)) ** 0.5
    return A_inverse, condition


@cache
def _solve() -> Any:
    """Return LAPACK's solver of linear equations."""
    from scipy.linalg.lapack import dgesv  # slow to load

    return dgesv


@cache
def identity(size: int) -> Array:
    """Return the identity matrix, read-only, shape (size, size)."""
    return frozen(np.eye(size))
