"""What a reference says: the desired payload pose, twist and acceleration at a time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array, frozen


class PoseTarget(NamedTuple):
    """The desired motion of the payload at one time; read-only arrays."""

    X_WP_d: Array
    """Desired pose of the payload frame P in the world W, m, shape (4, 4)."""

    V_WP_d: Array
    """Desired twist of P in world axes at the origin of P, linear first, m/s and rad/s, shape (6,)."""

    A_WP_d: Array
    """Time derivative of V_WP_d: acceleration of the origin of P and angular acceleration, m/s^2 and rad/s^2, shape (6,)."""


class PoseReference(ABC):
    """A desired payload motion, defined at every time; the pose is continuous and its twist is V_WP_d."""

    @abstractmethod
    def at(self, time: float) -> PoseTarget:
        """Return the target at a time in s."""


NO_VECTOR: Array = frozen(np.zeros(3))
"""A vector of zeros, read-only."""


def make_target(
    R: Array, p: Array, v: Array = NO_VECTOR, omega: Array = NO_VECTOR, a: Array = NO_VECTOR, alpha: Array = NO_VECTOR
) -> PoseTarget:
    """Return the target of a motion given in parts, all in world axes.

    Args:
        R: rotation matrix of P in W, shape (3, 3).
        p: position of P, m, shape (3,).
        v: its rate, m/s, shape (3,).
        omega: angular rate, rad/s, shape (3,).
        a: rate of v, m/s^2, shape (3,).
        alpha: rate of omega, rad/s^2, shape (3,).
    """
    X_WP_d = np.zeros((4, 4))
    X_WP_d[:3, :3] = R
    X_WP_d[:3, 3] = p
    X_WP_d[3, 3] = 1.0
    V_WP_d = np.concatenate((v, omega))
    A_WP_d = np.concatenate((a, alpha))
    return PoseTarget(frozen(X_WP_d), frozen(V_WP_d), frozen(A_WP_d))
