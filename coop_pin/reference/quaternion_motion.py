"""Orientation, angular rate and angular acceleration of a quaternion that moves and need not have length one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array


class TurningMotion(NamedTuple):
    """An orientation and how it changes, in world axes."""

    R: Array
    """Rotation matrix, shape (3, 3)."""

    omega: Array
    """Angular rate, rad/s, shape (3,)."""

    alpha: Array
    """Its derivative, rad/s^2, shape (3,)."""


def turning_motion(motion: Array) -> TurningMotion:
    """Return the rotation of q / |q| and its rates.

    With ``w = qdot q^-1 = (w_0, w_v)``: ``omega = 2 w_v``, ``alpha = 2 (vector part of qddot q^-1) - 4 w_0 w_v``.
    The length of q drops out: scaling q adds only to the scalar part w_0.

    ``E a`` below is the vector part of the product a conj(q), ``G a`` that of conj(q) a; R = E G^T / |q|^2.

    Args:
        motion: rows q, qdot, qddot, each (x, y, z, w), shape (3, 4).
    """
    x, y, z, w = motion[0].tolist()
    square = x * x + y * y + z * z + w * w
    E = np.array(((w, -z, y, -x), (z, w, -x, -y), (-y, x, w, -z)))
    G = np.array(((w, z, -y, -x), (-z, w, x, -y), (y, -x, w, -z)))
    omega, alpha = motion[1:] @ E.T * (2.0 / square)
    w_0 = float(motion[0] @ motion[1]) / square
    return TurningMotion(E @ G.T / square, omega, alpha - 2.0 * w_0 * omega)
