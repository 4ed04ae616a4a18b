"""Terms shared by the laws: inverses of the payload Jacobian, its null space, force term, posture term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError, SingularJacobianError
from coop_pin.base.schema.base import Description, NotNegative, Vector
from coop_pin.base.schema.parts import fields_of, refilled
from coop_pin.base.spatial import weight_wrench
from coop_pin.base.spatial.generic_numbers import identity, inverse, require_less
from coop_pin.base.spatial.task_rows import TaskRows, joint_shortage
from coop_pin.control.gains import Gains, gain_vector
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm

CONDITION_LIMIT = 1e6
"""Payload Jacobians with a larger condition number count as singular."""
_ROUNDING = 1e-6
G = TypeVar("G", bound=Gains)


def jacobian_inverse(J: Array, time: float) -> Array:
    """Return J^-1 of a square payload Jacobian.

    Args:
        J: shape (k_0, k_0).
        time: time for the message, s.

    Raises:
        ArgumentError: J is not square.
        SingularJacobianError: the condition number exceeds 1e6 (Assumption 2 of the paper, eq. (22), fails).
    """
    if J.shape[0] != J.shape[1]:
        raise ArgumentError(
            f"the payload Jacobian has {J.shape[1]} columns (joints) and {J.shape[0]} rows; it must be"
            " square: choose other rows, or a law for redundant arms"
        )
    J_inverse, condition = inverse(J)
    require_less(condition, CONDITION_LIMIT, partial(_singular, J, time))
    return J_inverse


def right_inverse(J: Array, time: float, damping: float | None = None) -> Array:
    """Return J^+ = J^T (J J^T + damping^2 I)^-1 of a payload Jacobian with at least as many columns as rows.

    Args:
        J: shape (k_0, k).
        time: time for the message, s.
        damping: damping, in the unit of J's singular values; with it J J^+ is not the identity. None for
            none.

    Raises:
        ArgumentError: J has fewer columns (joints) than rows.
        SingularJacobianError: J J^T + damping^2 I has a condition number beyond 1e12 (of J: 1e6).
    """
    gram = J.dot(J.T)
    gram_inverse, condition = inverse(gram if damping is None else gram + damping**2 * identity(len(J)))
    require_less(condition**0.5, CONDITION_LIMIT, partial(_singular, J, time))
    return J.T.dot(gram_inverse)


def full_rank_inverse(J: Array, time: float) -> Array:
    """Return J^+ of a payload Jacobian; with fewer columns than rows (J^T J)^-1 J^T.

    J J^+ is then the part of a wrench that the drives feel; the arm's structure bears the rest.

    Args:
        J: shape (k_0, k).
        time: time for the message, s.

    Raises:
        SingularJacobianError: J loses rank, as of ``right_inverse``.
    """
    return right_inverse(J.T, time).T if J.shape[1] < J.shape[0] else right_inverse(J, time)


def _singular(J: Array, time: float, condition: float) -> Exception:
    """Return the error of a payload Jacobian that has no right inverse."""
    if J.shape[1] < J.shape[0]:
        return ArgumentError(f"the payload Jacobian has {joint_shortage(J.shape[1], J.shape[0])}")
    return SingularJacobianError(condition, time, CONDITION_LIMIT)


class GainAxes(NamedTuple):
    """Axes of a gain matrix: of the world, or of the payload, with which it turns as an arm measures it.

    Attributes:
        rows: the k_0 task rows.
        turns: whether they are those of the payload.
    """

    rows: TaskRows
    turns: bool = False

    def product(self, matrix: Array, X_WP: Array, values: Array) -> Array:
        """Return M x, or R M R^T x, in world axes, shape (k_0,)."""
        if not self.turns:
            return matrix.dot(values)
        return self.rows.turn(X_WP, matrix.dot(self.rows.turn(X_WP.T, values)))


def force_term(
    rows: TaskRows, force_gain: float, measurement: ArmMeasurement, reference: ArmReference
) -> Array:
    """Return f_d - K_f ftilde in world axes, or f_d where no internal wrench is measured, shape (k_0,).

    f_d turns with the payload pose that this arm sees. Gueaieb et al. (2007), eq. (23).
    """
    f_d = rows.turn(measurement.payload_pose, reference.internal_wrench)
    if measurement.internal_wrench is None:
        return f_d
    return f_d - force_gain * (measurement.internal_wrench - f_d)


@dataclass(frozen=True, eq=False)
class InternalForceIntegral:
    """Integral control of the internal wrench: ``f_r = f_d + Z``, ``Z <- Z - g (f_m - f_d)``.

    Z moves once for each new measurement, before the torque; without any, f_r = f_d.

    Attributes:
        rows: the k_0 task rows.
        gain: g, stable below ``anchor_gain_bound``.
    """

    rows: TaskRows
    gain: float

    def start(self) -> tuple[Array, float]:
        """Return Z = 0, shape (k_0,), and the age of no measurement."""
        return np.zeros(self.rows.size), np.inf

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: tuple[Array, float]
    ) -> tuple[Array, tuple[Array, float]]:
        """Return f_r in world axes, shape (k_0,), and the next state."""
        f_d = self.rows.turn(measurement.payload_pose, reference.internal_wrench)
        if measurement.internal_wrench is None:
            return f_d, state
        (Z, last), age = state, measurement.internal_wrench_age
        Z = Z - is_new(age, last) * self.gain * (measurement.internal_wrench - f_d)
        return f_d + Z, (Z, age)


def is_new(age: float, last: float) -> bool:
    """Return whether a measurement of this age, ticks, was taken since the tick at which it was ``last``.

    Ages count ticks; one that was rounded, as by other controllers than ours, still counts as grown by one.
    """
    return age < last + 1.0 - _ROUNDING


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
            FieldError: a gain does not fit it.
        """
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


def with_payload_weight(gains: G, arm: ControlledArm, scenario: Any) -> G:
    """Return sized gains with a ``payload_weight``: where none is stated, that of the payload."""
    if fields_of(gains)["payload_weight"] is not None:
        return gains
    weight = arm.rows.select(weight_wrench(scenario.cell.payload.total_mass, arm.gravity))
    return refilled(gains, {"payload_weight": weight})
