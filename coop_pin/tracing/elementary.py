"""Elementary functions of traced scalars, from correctly rounded operations: the same bits everywhere.

Sine, cosine and exponential reduce their argument by a multiple of pi / 2 or log 2, in parts with trailing
zeros (Cody and Waite), and evaluate a polynomial; the arc tangent is Cephes' rational function (Moshier). All
are within two units in the last place of correct.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .comparisons import both, either, equal, less, less_equal, maximum, minimum, opposite, select
from .tape import Number, Traced, UntraceableError, apply

_ROUNDER = 6755399441055744.0
"""1.5 2^52: x + _ROUNDER - _ROUNDER is x rounded to a whole number, for abs(x) < 2^51."""
_LARGEST = float(np.finfo(np.float64).max)
_HALF_PI = (1.57079632673412561417e00, 6.077100506506192e-11)
_LOG_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_SINE = (
    1.58962301576546568060e-10,
    -2.50507477628578072866e-8,
    2.75573136213857245213e-6,
    -1.98412698295895385996e-4,
    8.33333333332211858878e-3,
    -1.66666666666666307295e-1,
)
_COSINE = (
    -1.13585365213876817300e-11,
    2.08757008419747316778e-9,
    -2.75573141792967388112e-7,
    2.48015872888517045348e-5,
    -1.38888888888730564116e-3,
    4.16666666666665929218e-2,
    -0.5,
)
_HYPERBOLIC_COTANGENT = (
    4.13813679705723846039e-08,
    -1.65339022054652515390e-06,
    6.61375632143793436117e-05,
    -2.77777777770155933842e-03,
    1.66666666666666019037e-01,
    2.0,
)
"""Coefficients of r coth(r / 2) in r^2, for abs(r) <= log(2) / 2 (fdlibm's exp)."""
_LARGEST_TANH = 40.0
"""Twice an argument from which 1 - tanh is less than the rounding of 1."""
_EXPONENTIAL = tuple(1.0 / math.factorial(n) for n in range(13, -1, -1))
_INVERSE_TANGENT = tuple(1.0 / (2 * n + 1) for n in range(10, -1, -1))
"""Coefficients of atanh(s) / s in s^2, for s up to 0.172."""
_BINARY_PLACES = (512, 256, 128, 64, 32, 16, 8, 4, 2, 1)
_ARC_TANGENT_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ARC_TANGENT_Q = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
_SMALLEST_EXPONENT, _LARGEST_EXPONENT = -700.0, 709.0
_ZERO_EXPONENT, _INFINITE_EXPONENT = -746.0, 709.8
"""Of e, below which the exponential is 0 and from which on it is inf."""
_LARGEST_ANGLE, _LARGEST_ROUNDED = 1e5, 2.0**51
"""Arguments of sine and cosine, and of the rounding to whole numbers."""
_SMALLEST_NORMAL = 2.0**-1022
_CUBIC_TANH = 1e-5
"""Argument below which tanh x is x - x^3 / 3."""
_LARGEST_CONDITION = 1e6
"""Of a matrix whose inverse is numpy's within the agreement of a batch and single runs."""


def _refuse_where(x: Number, is_beyond: Callable[[Any], Number]) -> None:
    """Note, of exact code, that a run is not valid where the function of x is not as accurate as numpy's."""
    if isinstance(x, Traced) and x.tape.is_exact:
        x.tape.guards.append(opposite(is_beyond(x)))


def sqrt(x: Number) -> Number:
    """Return the square root."""
    return apply("sqrt", x)


def power(x: Number, exponent: Number) -> Number:
    """Return x to the power of 2, 1/2 or 1/4."""
    if exponent == 2:
        return x * x
    if exponent not in (0.5, 0.25):
        raise UntraceableError(f"raises to the power {exponent!r}; 2, 1/2 and 1/4 can be traced")
    return sqrt(x) if exponent == 0.5 else sqrt(sqrt(x))


def sin(x: Number) -> Number:
    """Return the sine, for abs(x) up to 1e5."""
    return _sine_and_cosine(x)[0] if isinstance(x, Traced) else math.sin(x)


def cos(x: Number) -> Number:
    """Return the cosine, for abs(x) up to 1e5."""
    return _sine_and_cosine(x)[1] if isinstance(x, Traced) else math.cos(x)


def exp(x: Number) -> Number:
    """Return e^x; inf for x > 709, 0 for x < -746, and e^-700 for x in between and -700."""
    if not isinstance(x, Traced):
        return math.exp(x)
    _refuse_where(x, lambda x: both(less_equal(_ZERO_EXPONENT, x), less(x, _SMALLEST_EXPONENT)))
    _refuse_where(x, lambda x: both(less(_LARGEST_EXPONENT, x), less(x, _INFINITE_EXPONENT)))
    r, power = _exponent(x)
    return polynomial(r, _EXPONENTIAL) * power


def expm1(x: Number) -> Number:
    """Return e^x - 1; no finite number for x > 709."""
    if not isinstance(x, Traced):
        return math.expm1(x)
    _refuse_where(x, lambda x: less(_LARGEST_EXPONENT, x))
    r, power = _exponent(x)
    return r * polynomial(r, _EXPONENTIAL[:-1]) * power + (power - 1.0)


def log(x: Number) -> Number:
    """Return the natural logarithm of x = m 2^n, by the series of atanh (m - 1) / (m + 1); NaN for x < 0.

    For x below 2^-1022 it is not accurate.
    """
    if not isinstance(x, Traced):
        return math.log(x)
    _refuse_where(x, lambda x: both(less(0.0, x), less(x, _SMALLEST_NORMAL)))
    m: Number = x
    n: Number = 0.0
    for k in _BINARY_PLACES:  # until 1 <= m < 2
        for is_beyond, shift in ((less(m, 2.0 ** (1 - k)), k), (less(2.0**k, m), -k)):
            m, n = select(is_beyond, m * 2.0**shift, m), select(is_beyond, n - shift, n)
    is_far = less(math.sqrt(2.0), m)
    m, n = select(is_far, 0.5 * m, m), select(is_far, n + 1.0, n)
    s = (m - 1.0) / (m + 1.0)
    small = 2.0 * s * polynomial(s * s, _INVERSE_TANGENT) + n * _LOG_2[1]
    positive = select(less(x, math.inf), n * _LOG_2[0] + small, x)
    return select(less(0.0, x), positive, select(equal(x, 0.0), -math.inf, math.nan))


def tanh(x: Number) -> Number:
    """Return (e - 1) / (e + 1) with e = exp(2 x) = 2^n (R + r) / (R - r), R = r coth(r / 2); error 4e-16.

    In exact code, the relative error of small values is as small as numpy's for any use that they have.
    """
    if not isinstance(x, Traced):
        return math.tanh(x)
    z = minimum(maximum(2.0 * x, -_LARGEST_TANH), _LARGEST_TANH)
    n = _rounded(z * (1.0 / math.log(2.0)))
    r = z - n * math.log(2.0)
    R = polynomial(r * r, _HYPERBOLIC_COTANGENT)
    above, below = apply("power_of_two", n) * (R + r), R - r
    value = (above - below) / (above + below)
    return select(less(abs(x), _CUBIC_TANH), x - x * x * x / 3.0, value) if x.tape.is_exact else value


def atan2(y: Number, x: Number) -> Number:
    """Return the angle of (x, y), in [-pi, pi]; in exact code, zeros have signs as in numpy."""
    if not isinstance(x, Traced) and not isinstance(y, Traced):
        return math.atan2(y, x)
    is_steep = less(abs(x), abs(y))
    longer, shorter = select(is_steep, abs(y), abs(x)), select(is_steep, abs(x), abs(y))
    ratio = shorter / select(less_equal(longer, 0.0), 1.0, longer)
    if next(one for one in (x, y) if isinstance(one, Traced)).tape.is_exact:
        both = select(less(_LARGEST, longer), less(_LARGEST, shorter), 0.0)
        ratio = select(both, 1.0, ratio)  # inf / inf
    first = _arc_tangent(ratio)
    octants = select(is_steep, 0.5 * math.pi - first, first)
    half = select(_has_minus(x), math.pi - octants, octants)
    return select(_has_minus(y), -half, half)


def _has_minus(x: Number) -> Number:
    """Return whether x is negative, as a mask; in exact code, -0 is."""
    is_negative = less(x, 0.0)
    if not isinstance(x, Traced) or not x.tape.is_exact:
        return is_negative
    return either(is_negative, less(apply("div", 1.0, x), 0.0))


def inverse(A: NDArray[Any]) -> NDArray[Any]:
    """Return A^-1 by Gaussian elimination with partial pivoting; the row swaps are choices by masks.

    Exact code is not valid for a condition number over 1e6, by Frobenius norms: its rounding is not numpy's.

    Args:
        A: Matrix of numbers, shape (n, n).
    """
    size = len(A)
    rows = [[*row, *unit] for row, unit in zip(A.tolist(), np.eye(size).tolist(), strict=True)]
    for k in range(size):
        for i in range(k + 1, size):
            swap = less(abs(rows[k][k]), abs(rows[i][k]))
            pairs = [(select(swap, b, a), select(swap, a, b)) for a, b in zip(rows[k], rows[i], strict=True)]
            rows[k], rows[i] = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
        pivot = 1.0 / rows[k][k]
        for i in range(k + 1, size):
            factor = rows[i][k] * pivot
            rows[i] = [0.0] * (k + 1) + [
                b - factor * a for a, b in zip(rows[k][k + 1 :], rows[i][k + 1 :], strict=True)
            ]
    for k in reversed(range(size)):
        right = rows[k][size:]
        for j in range(k + 1, size):
            right = [x - rows[k][j] * y for x, y in zip(right, rows[j][size:], strict=True)]
        pivot = 1.0 / rows[k][k]
        rows[k][size:] = [x * pivot for x in right]
    result = np.array([row[size:] for row in rows], dtype=object)
    for x in (x for x in A.flat if isinstance(x, Traced) and x.tape.is_exact):
        x.tape.guards.append(less((A * A).sum() * (result * result).sum(), _LARGEST_CONDITION**2))
        break
    return result


def polynomial(z: Any, coefficients: Sequence[float]) -> Any:
    """Return a polynomial by Horner's method; coefficients of the highest power first."""
    value: Any = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * z + coefficient
    return value


def rint(x: Number) -> Number:
    """Return the nearest whole number, of two the even one, for abs(x) < 2^51."""
    _refuse_where(x, lambda x: less_equal(_LARGEST_ROUNDED, abs(x)))
    return _rounded(x)


def _rounded(x: Number) -> Number:
    return (x + _ROUNDER) - _ROUNDER


def _reduced(x: Any, n: Number, parts: Sequence[float]) -> Number:
    for part in parts:
        x = x - n * part
    return x


def _sine_and_cosine(x: Number) -> tuple[Number, Number]:
    """Return sine and cosine of x = r + n pi / 2, by those of r and of m pi / 2, m = n - 4 round(n / 4)."""
    _refuse_where(x, lambda x: less(_LARGEST_ANGLE, abs(x)))
    n = _rounded(x * (2.0 / math.pi))
    r = _reduced(x, n, _HALF_PI)
    z = r * r
    sine: Number = r + r * z * polynomial(z, _SINE)
    cosine: Number = 1.0 + z * polynomial(z, _COSINE)
    m = n - 4.0 * _rounded(0.25 * n)
    cosine_m, sine_m = 1.0 - abs(m), m * (2.0 - abs(m))
    return sine * cosine_m + cosine * sine_m, cosine * cosine_m - sine * sine_m


def _exponent(x: Number) -> tuple[Number, Number]:
    """Return r and 2^n with e^x = e^r 2^n; 2^n is inf or 0 where e^x is beyond what doubles can hold."""
    bounded = minimum(maximum(x, _SMALLEST_EXPONENT), _LARGEST_EXPONENT)
    n = _rounded(bounded * (1.0 / math.log(2.0)))
    power = select(less(_LARGEST_EXPONENT, x), math.inf, apply("power_of_two", n))
    return _reduced(bounded, n, _LOG_2), select(less(x, _ZERO_EXPONENT), 0.0, power)


def _arc_tangent(x: Number) -> Number:
    """Return the arc tangent of x in [0, 1]."""
    is_far = less(0.66, x)
    y = select(is_far, (x - 1.0) / (x + 1.0), x)
    z = y * y
    angle = y + y * z * (polynomial(z, _ARC_TANGENT_P) / polynomial(z, _ARC_TANGENT_Q))
    return angle + select(is_far, 0.25 * math.pi, 0.0)
