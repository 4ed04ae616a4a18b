"""Linearisation of a closed chain about a state, in minimal coordinates; continuous and sampled."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.linalg

from coop_pin.arrays import Array, as_positive

_STEP = 1e-3
"""Step of the differences, rad, m and their rates; five points leave errors of its fourth power."""
_STENCIL = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))


class Linearisation(NamedTuple):
    """Linear model ``x' = A x + B u, y = C x + D u`` of small deviations from a state.

    Attributes:
        A: shape (2 d, 2 d); x holds the deviations of the d independent joints (rad, m), then of their rates.
        B: shape (2 d, nv); u is the deviation of the generalised force, N m and N.
        C: shape (p, 2 d); y is said by the method that returns the model.
        joints: names of the independent joints, in the order of x.
        period: period of a sampled model ``x[k + 1] = A x[k] + B u[k]``, s; 0 for a continuous one.
    """

    A: Array
    B: Array
    C: Array
    joints: tuple[str, ...]
    period: float = 0.0

    def sampled(self, period: float) -> Linearisation:
        """Return the model sampled with u held over a period (zero-order hold), by the matrix exponential.

        exp([[A, B], [0, 0]] T) = [[A_T, B_T], [0, 1]]

        Args:
            period: T, s.

        Raises:
            OutOfRangeError: the period is not greater than zero.
        """
        n, T = len(self.A), as_positive("period", period)
        block = np.zeros((n + self.B.shape[1],) * 2)
        block[:n] = np.hstack((self.A, self.B))
        exponential = scipy.linalg.expm(T * block)[:n]
        return self._replace(A=exponential[:, :n], B=exponential[:, n:], period=T)


def difference_matrix(function: Callable[[Array], Array], size: int) -> Array:
    """Return the Jacobian of a function at zero by five-point central differences, shape (p, size).

    Args:
        function: f of a deviation, shape (size,), to values of shape (p,).
        size: number of deviations.
    """
    columns = [
        sum(weight * function(point * _STEP * unit) for point, weight in _STENCIL) / _STEP
        for unit in np.eye(size)
    ]
    return np.array(columns).T
