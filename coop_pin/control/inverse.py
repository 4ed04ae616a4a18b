"""The inverse of a payload Jacobian, refused near singular poses."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array
from coop_pin.errors import SingularJacobianError

CONDITION_LIMIT = 1e6


def jacobian_inverse(J: Array, time: float) -> Array:
    """Return J^-1 of a square payload Jacobian.

    The condition number is measured in the Frobenius norm, ``|J| |J^-1|``: an upper bound of the usual one, at a tenth of its cost.

    Args:
        J: shape (k_0, k_0).
        time: for the message, s.

    Raises:
        SingularJacobianError: the condition number exceeds 1e6 (Assumption 2 of the paper, eq. (22), fails).
    """
    try:
        J_inverse: Array = np.asarray(np.linalg.inv(J), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise SingularJacobianError(float("inf"), time, CONDITION_LIMIT) from None
    condition = float(np.vdot(J, J) * np.vdot(J_inverse, J_inverse)) ** 0.5
    if not condition < CONDITION_LIMIT:
        raise SingularJacobianError(condition, time, CONDITION_LIMIT)
    return J_inverse
