"""What a redundant arm does with its spare joints: hold a posture, without touching the payload."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coop_pin.arrays import Array


@dataclass(frozen=True, eq=False)
class Posture:
    """A spring and damper in the null space of the payload Jacobian.

    ``tau = N^T (-stiffness (q - angles) - damping v)`` with ``N = I - J^+ J``: tau does no work on the payload's motion
    ``v = J^+ V_WP``. Damping alone would let an arm sink through its limits under gravity.

    Attributes:
        angles: drive angles to return to, rad, shape (k,).
        stiffness: N m/rad, shape (k,).
        damping: N m s/rad, shape (k,).
    """

    angles: Array
    stiffness: Array
    damping: Array

    def torque(self, q: Array, v: Array, J: Array, J_plus: Array) -> Array:
        """Return the drive torque of the spare joints, N m, shape (k,).

        Args:
            q: drive angles, rad, shape (k,).
            v: drive rates, rad/s, shape (k,).
            J: payload Jacobian, shape (k_0, k).
            J_plus: its right inverse, shape (k, k_0).
        """
        pull = -self.stiffness * (q - self.angles) - self.damping * v
        return pull - J.T @ (J_plus.T @ pull)


def no_posture(joints: int) -> Posture:
    """Return the posture of an arm without spare joints: no spring, no damper."""
    return Posture(np.zeros(joints), np.zeros(joints), np.zeros(joints))
