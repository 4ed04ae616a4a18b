"""Comparisons of traced scalars, logic of their masks (0.0 or 1.0), and choices by them, with numpy's NaN."""

from __future__ import annotations

import math

from .tape import Number, Traced, apply


def less(a: Number, b: Number) -> Number:
    """Return whether a < b, as a mask; false for NaN."""
    return apply("less", a, b)


def select(mask: Number, a: Number, b: Number) -> Number:
    """Return a where the mask holds, otherwise b."""
    return apply("select", mask, a, b)


def less_equal(a: Number, b: Number) -> Number:
    """Return whether a <= b, as a mask; false for NaN."""
    return apply("less_equal", a, b)


def equal(a: Number, b: Number) -> Number:
    """Return whether a == b, as a mask; false for NaN."""
    return both(less_equal(a, b), less_equal(b, a))


def both(a: Number, b: Number) -> Number:
    """Return whether two masks hold, as a mask."""
    return select(a, b, 0.0)


def either(a: Number, b: Number) -> Number:
    """Return whether one of two masks holds, as a mask."""
    return select(a, 1.0, b)


def opposite(mask: Number) -> Number:
    """Return whether a mask does not hold, as a mask."""
    return apply("sub", 1.0, mask)


def minimum(a: Number, b: Number) -> Number:
    """Return the lesser of two numbers, NaN if one of them is; of equal ones the first."""
    return _first_if(less_equal(a, b), less(b, a), a, b)


def maximum(a: Number, b: Number) -> Number:
    """Return the greater of two numbers, NaN if one of them is; of equal ones the first."""
    return _first_if(less_equal(b, a), less(a, b), a, b)


def _first_if(is_first: Number, is_second: Number, a: Number, b: Number) -> Number:
    """Return a or b by masks that both fail for NaN; one that is no NaN for sure saves operations."""
    if _is_number(b):
        return select(is_second, b, a)
    return select(is_first, a, b if _is_number(a) else select(is_second, b, a + b))


def _is_number(x: Number) -> bool:
    return not isinstance(x, Traced) and not math.isnan(x)


def sign(x: Number) -> Number:
    """Return -1, 0 or 1; NaN of NaN."""
    return select(less_equal(x, x), less(0.0, x) - less(x, 0.0), x)
