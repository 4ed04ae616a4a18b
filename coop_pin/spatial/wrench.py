"""Moving wrenches between points and axes."""

from __future__ import annotations

import numpy as np

from coop_pin.arrays import Array


def shift_wrench(F_EA: Array, p_BA: Array) -> Array:
    """Return the same wrench with its moment taken about another point.

    ``F_EB = [f, n + p_BA x f]``

    Args:
        F_EA: wrench with its moment about A, N and N m, shape (..., 6).
        p_BA: position of A seen from B, in the axes of the wrench, m, shape (..., 3).
    """
    force, moment = F_EA[..., :3], F_EA[..., 3:]
    return np.concatenate((force, moment + np.cross(p_BA, force)), axis=-1)


def rotate_vector6(R_AB: Array, vector_B: Array) -> Array:
    """Return a twist or wrench given in axes B, expressed in axes A, about the same point.

    Args:
        R_AB: rotation matrix, shape (..., 3, 3).
        vector_B: six-vector, shape (..., 6).
    """
    halves = vector_B.reshape(*vector_B.shape[:-1], 2, 3)
    turned = halves @ np.swapaxes(R_AB, -1, -2)
    return turned.reshape(vector_B.shape)
