"""The inverse of a payload Jacobian, refused near singular poses."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg.lapack import dgesv

from coop_pin.arrays import Array, frozen
from coop_pin.errors import SingularJacobianError

CONDITION_LIMIT = 1e6


def jacobian_inverse(J: Array, time: float) -> Array:
    """Return J^-1 of a square payload Jacobian.

    The condition number is measured in the Frobenius norm, ``|J| |J^-1|``: an upper bound of the usual one, at a tenth of its cost.
    LAPACK is called directly: numpy's wrapper around it costs three times the solution.

    Args:
        J: shape (k_0, k_0).
        time: for the message, s.

    Raises:
        SingularJacobianError: the condition number exceeds 1e6 (Assumption 2 of the paper, eq. (22), fails).
    """
    J_inverse: Array
    _, _, J_inverse, zero_pivot = dgesv(J, _identity(len(J)))
    if zero_pivot:
        raise SingularJacobianError(float("inf"), time, CONDITION_LIMIT)
    condition = float(np.vdot(J, J) * np.vdot(J_inverse, J_inverse)) ** 0.5
    if not condition < CONDITION_LIMIT:
        raise SingularJacobianError(condition, time, CONDITION_LIMIT)
    return J_inverse


@cache
def _identity(size: int) -> Array:
    return frozen(np.eye(size))


def right_inverse(J: Array, time: float, damping: float = 0.0) -> Array:
    """Return J^+ = J^T (J J^T + damping^2 I)^-1 of a payload Jacobian with at least as many columns as rows.

    Args:
        J: shape (k_0, k).
        time: for the message, s.
        damping: in the unit of J's singular values; with it J J^+ is not the identity.

    Raises:
        SingularJacobianError: J J^T + damping^2 I has a condition number beyond 1e12 (of J: 1e6).
    """
    gram = J.dot(J.T)
    gram_inverse: Array
    _, _, gram_inverse, zero_pivot = dgesv(gram + damping**2 * _identity(len(J)), _identity(len(J)))
    condition = float(np.vdot(gram, gram) * np.vdot(gram_inverse, gram_inverse)) ** 0.25 if not zero_pivot else float("inf")
    if not condition < CONDITION_LIMIT:
        raise SingularJacobianError(condition, time, CONDITION_LIMIT)
    return J.T.dot(gram_inverse)
