"""Derivatives by central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from coop_pin.arrays import Array

OFFSETS: tuple[float, ...] = (-2.0, -1.0, 1.0, 2.0)
FIRST: Array = np.array((1.0, -8.0, 8.0, -1.0)) / 12.0
SECOND: Array = np.array((-1.0, 16.0, 16.0, -1.0)) / 12.0


def displacements(pose_function: Callable[[float], Array], time: float, step: float) -> Array:
    """Return ``[p(t + o h) - p(t), log(R(t + o h) R(t)^T)]`` for the offsets o, world axes, shape (4, 6).

    Args:
        pose_function: time in s -> pose, shape (4, 4).
        time: t, s.
        step: h, s.
    """
    X = pose_function(time)
    around = np.stack([pose_function(time + offset * step) for offset in OFFSETS])
    turns = Rotation.from_matrix(around[:, :3, :3] @ X[:3, :3].T).as_rotvec()
    return np.hstack((around[:, :3, 3] - X[:3, 3], np.reshape(turns, (-1, 3))))


def twist_from(displaced: Array, step: float) -> Array:
    """Return the twist in world axes, shape (6,), from displacements: omega is the rate of the log at the identity."""
    twist: Array = FIRST @ displaced / step
    return twist


def acceleration_from(displaced: Array, step: float) -> Array:
    """Return the derivative of the twist, shape (6,), from displacements.

    ``alpha = d/dt (J(r) rdot) = rddot`` where r = 0: the derivative of the left Jacobian J there gives rdot x rdot / 2 = 0.
    """
    acceleration: Array = SECOND @ displaced / step**2
    return acceleration


def rate_of(function: Callable[[float], Array], time: float, step: float) -> Array:
    """Return the derivative of a function of time, of its own shape."""
    around = np.stack([function(time + offset * step) for offset in OFFSETS])
    rate: Array = np.tensordot(FIRST, around, axes=1) / step
    return rate
