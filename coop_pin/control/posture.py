"""Posture of the spare joints: a spring and damper in the null space of the payload Jacobian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Description, NotNegative, Vector
from coop_pin.control.gains import gain_vector
from coop_pin.control.measurement import ArmMeasurement, ControlledArm
from coop_pin.control.terms import right_inverse


def null_space_part(torque: Array, J: Array, J_plus: Array) -> Array:
    """Return N^T torque with N = I - J^+ J: the part that does no work on the payload, shape (k,)."""
    return torque - J.T.dot(J_plus.T.dot(torque))


@dataclass(frozen=True, eq=False)
class Posture:
    """A spring and damper in the null space of the payload Jacobian.

    ``tau = N^T (-stiffness (q - angles) - damping v)`` with ``N = I - J^+ J``: tau does no work on the
    payload's motion ``v = J^+ V_WP``. Damping alone would let an arm sink through its limits under gravity.

    Attributes:
        angles: drive angles to return to, rad, shape (k,).
        stiffness: N m/rad, shape (k,).
        damping: N m s/rad, shape (k,).
    """

    angles: Array
    stiffness: Array
    damping: Array

    def pull(self, q: Array, v: Array) -> Array:
        """Return -stiffness (q - angles) - damping v, N m, shape (k,)."""
        return -self.stiffness * (q - self.angles) - self.damping * v

    def torque(self, q: Array, v: Array, J: Array, J_plus: Array) -> Array:
        """Return the drive torque of the spare joints, N m, shape (k,).

        Args:
            q: drive angles, rad, shape (k,).
            v: drive rates, rad/s, shape (k,).
            J: payload Jacobian, shape (k_0, k).
            J_plus: right inverse of J, shape (k, k_0).
        """
        return null_space_part(self.pull(q, v), J, J_plus)


def spare_torque(measurement: ArmMeasurement, start: Array, gains: tuple[float, float]) -> Array:
    """Return the torque that brings the spare joints back to where they started, N m, shape (k,).

    Args:
        measurement: measurement of the arm; zero for an arm without spare joints.
        start: drive angles at t_0, rad, shape (k,).
        gains: stiffness, N m/rad, and damping, N m s/rad, of all joints.

    Raises:
        SingularJacobianError: the payload Jacobian of a redundant arm loses rank.
    """
    J, q, v = measurement.payload_jacobian, measurement.q, measurement.v
    if J.shape[0] == J.shape[1]:
        return np.zeros_like(q)
    spring = Posture(start, np.full(q.size, gains[0]), np.full(q.size, gains[1]))
    return spring.torque(q, v, J, right_inverse(J, measurement.time))


class PostureGains(Description):
    """Null-space spring towards the arm's posture, and damper, of the spare joints of redundant arms.

    One value acts on the arm's own joints, not on those of a mobile base, so that the base follows the arm.

    Attributes:
        stiffness: N m/rad, one value for all joints or one for each.
        damping: N m s/rad, likewise.
    """

    stiffness: NotNegative | Vector = 40.0
    damping: NotNegative | Vector = 8.0

    def term(self, arm: ControlledArm) -> Posture:
        """Return the posture term of an arm: a spring towards its posture, and a damper.

        Raises:
            FieldError: the arm has continuous joints, or a gain does not fit it.
        """
        if arm.posture is None:
            raise FieldError(
                f"needs angles, but arm {arm.name!r} has continuous joints; lock them or give them limits",
                "controller.posture",
            )
        return Posture(arm.posture, *self.of_drives(arm.drives, arm.base_drives))

    def of_drives(self, drives: int, base_drives: int = 0) -> tuple[Array, Array]:
        """Return stiffness and damping of every drive, shape (k,).

        Args:
            drives: Number k of drives of the arm.
            base_drives: Number of its first drives that move a mobile base.

        Raises:
            FieldError: a gain has a wrong number of entries.
        """
        is_of_arm = np.arange(drives) >= base_drives
        stiffness, damping = (
            gain_vector(gain, drives, f"controller.posture.{name}")
            * (is_of_arm if np.ndim(gain) == 0 else 1.0)
            for name, gain in self
        )
        return stiffness, damping
