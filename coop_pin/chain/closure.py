"""Error kinematics of a loop closure: its error, and the coefficients of the error's second derivative."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.cell.closure import Closure, RowMask


class ClosureKinematics(NamedTuple):
    """Error of a closure with k rows, and the coefficients of its second derivative.

    With the spatial accelerations a_a and a_b of its frames, e'' = A_a a_a + A_b a_b + drift.

    Attributes:
        position: e, m and rad, shape (k,).
        A_a: map of the acceleration a_a, shape (k, 6).
        A_b: map of the acceleration a_b, shape (k, 6).
        drift: part of e'' by the twists alone, shape (k,).
    """

    position: Array
    A_a: Array
    A_b: Array
    drift: Array


ErrorFunction = Callable[[pin.SE3, pin.Motion, pin.Motion], ClosureKinematics]


def error_function(closure: Closure) -> ErrorFunction:
    """Return the function (X_ab, V_a, V_b) -> ClosureKinematics of a closure."""
    mask = closure.mask
    if all(mask):
        return _weld
    if mask == (True, True, True, False, False, False):
        return _point
    return lambda X_ab, V_a, V_b: _masked(X_ab, V_a, V_b, mask)


def _weld(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion) -> ClosureKinematics:
    """Return the kinematics of e = -log6(X_ab), e' = V_a - Ad(X_ab) V_b, as pinocchio.constraintDynamics."""
    V_b_in_a = X_ab.act(V_b)
    drift = (V_a - V_b_in_a).cross(V_b_in_a).vector
    return ClosureKinematics(-pin.log6(X_ab).vector, np.eye(6), -X_ab.toActionMatrix(), drift)


def _point(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion) -> ClosureKinematics:
    """Return the kinematics of e = R_Wa^T (p_a - p_b).

    The derivatives are taken in the world, so that e decays along a straight line.
    """
    R_ab = X_ab.rotation
    A_a, A_b = np.zeros((3, 6)), np.zeros((3, 6))
    A_a[:, :3], A_b[:, :3] = np.eye(3), -R_ab
    drift = _cross(V_a.angular, V_a.linear) - R_ab @ _cross(V_b.angular, V_b.linear)
    return ClosureKinematics(-X_ab.translation, A_a, A_b, drift)


def _masked(X_ab: pin.SE3, V_a: pin.Motion, V_b: pin.Motion, mask: RowMask) -> ClosureKinematics:
    """Return the held rows of [p_a - p_b, rotation error], in the rotating axes of a."""
    R_ab, p_ab = X_ab.rotation, X_ab.translation
    w_a, w_b, v_b = V_a.angular, R_ab @ V_b.angular, R_ab @ V_b.linear
    rotation = _rotation_error(R_ab, w_b - w_a, mask[3:])
    A_a, A_b = np.eye(6), np.zeros((6, 6))
    A_a[:3, 3:], A_a[3:, 3:] = -pin.skew(p_ab), rotation.G
    A_b[:3, :3], A_b[3:, 3:] = -R_ab, -rotation.G @ R_ab
    p_ab_rate = v_b - V_a.linear - _cross(w_a, p_ab)
    linear = _cross(w_a, p_ab_rate) + _cross(w_a, v_b) - R_ab @ _cross(V_b.angular, V_b.linear)
    angular = rotation.G @ _cross(w_a, w_b) - rotation.G_rate @ (w_b - w_a)
    rows = np.array(mask)
    position = np.concatenate((-p_ab, rotation.position))
    return ClosureKinematics(position[rows], A_a[rows], A_b[rows], np.concatenate((linear, angular))[rows])


class _RotationError(NamedTuple):
    """Rotation rows of a closure: e' = -G Omega, with Omega the angular velocity of b in a, in axes of a."""

    position: Array
    G: Array
    G_rate: Array


def _rotation_error(R_ab: Array, Omega: Array, held: tuple[bool, ...]) -> _RotationError:
    """Return the rotation error for the number of held rotations; the log would depend on the free angles.

    With k the only axis that is free or held, u its unit vector, z = R_ab u and c = u . z:

    - two held, a hinge: e = z x u, the misalignment of the axes; G = c I - z u^T.
    - one held, as by a universal joint: e = -(twist of R_ab about u); row k of G is (u + z)^T / (1 + c).
    - three held: e = -log(R_ab) and G = I, its derivative at small errors, as for a weld.
    """
    if sum(held) not in (1, 2):
        return _RotationError(-pin.log3(R_ab), np.eye(3), np.zeros((3, 3)))
    k = held.index(sum(held) == 1)
    u, z, c = np.eye(3)[k], R_ab[:, k], R_ab[k, k]
    z_rate = _cross(Omega, z)
    if sum(held) == 2:
        return _RotationError(
            _cross(z, u), c * np.eye(3) - np.outer(z, u), z_rate[k] * np.eye(3) - np.outer(z_rate, u)
        )
    i, j = (k + 1) % 3, (k + 2) % 3
    twist = math.atan2(R_ab[j, i] - R_ab[i, j], R_ab[i, i] + R_ab[j, j])
    n = (u + z) / (1.0 + c)
    return _RotationError(-twist * u, np.outer(u, n), np.outer(u, (z_rate - n * z_rate[k]) / (1.0 + c)))


def _cross(a: Array, b: Array) -> Array:
    """Return a x b; np.cross takes twenty times as long."""
    return pin.skew(a).dot(b)
