"""Terms shared by the laws: inverses of the payload Jacobian, its null space, force term, posture term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import ArgumentError, SingularJacobianError
from coop_pin.base.spatial.generic_numbers import identity, inverse, require_less
from coop_pin.base.spatial.task_rows import TaskRows, joint_shortage
from coop_pin.control.measurement import ArmMeasurement, ArmReference

CONDITION_LIMIT = 1e6
"""Payload Jacobians with a larger condition number count as singular."""
_ROUNDING = 1e-6


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
