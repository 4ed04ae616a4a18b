"""Poses as 4x4 homogeneous matrices, pose errors, and the transformation of wrenches and twists."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, shaped
from coop_pin.base.errors import WrongTypeError
from coop_pin.base.spatial.generic_numbers import atan2, sqrt, where

_SMALL = 1e-9
"""Length of a quaternion's vector, of a factor of 2 to 4, below which atan2(length, w) is length / w."""


def rotation_from_rpy(rpy: ArrayLike) -> Array:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll), the URDF convention.

    By the quaternion (x, y, z, w), in the order of scipy's operations: the same bits without its import.

    Args:
        rpy: roll, pitch, yaw about fixed axes, rad, shape (3,).
    """
    halves = [0.5 * angle for angle in as_array("rpy", rpy, 3).tolist()]
    (sr, sp, sy), (cr, cp, cy) = map(math.sin, halves), map(math.cos, halves)
    x, y, z, w = cp * sr, cr * sp, -(sp * sr), cp * cr  # pitch after roll
    return np.array(_rotation_rows(cy * x - sy * y, cy * y + sy * x, cy * z + w * sy, cy * w - sy * z))


def rotations(quaternion: Array) -> Array:
    """Return the rotation matrices of unit quaternions x, y, z, w, shape (..., 3, 3).

    Args:
        quaternion: unit quaternions, shape (..., 4).

    Raises:
        ShapeError: the shape differs.
    """
    rows = _rotation_rows(*np.moveaxis(shaped("quaternion", quaternion, 4), -1, 0))
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _rotation_rows(x: Any, y: Any, z: Any, w: Any) -> tuple[tuple[Any, ...], ...]:
    """Return the rows of the rotation matrix of a unit quaternion: of floats, or of arrays."""
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    xy, xz, yz, xw, yw, zw = x * y, x * z, y * z, x * w, y * w, z * w
    return (
        (xx - yy - zz + ww, 2 * (xy - zw), 2 * (xz + yw)),
        (2 * (xy + zw), -xx + yy - zz + ww, 2 * (yz - xw)),
        (2 * (xz - yw), 2 * (yz + xw), -xx - yy + zz + ww),
    )


def quaternions(R: Array) -> Array:
    """Return the unit quaternions x, y, z, w of rotation matrices, shape (..., 4).

    A matrix gives four multiples of its quaternion; that of the largest entry is accurate.

    Args:
        R: rotation matrices, shape (..., 3, 3).

    Raises:
        ShapeError: the shape differs.
    """
    R = shaped("R", R, 3, 3)
    trace = np.trace(R, axis1=-2, axis2=-1)
    multiples = np.empty((*R.shape[:-2], 4, 4))
    multiples[..., :3, :3] = R + np.swapaxes(R, -1, -2)
    multiples[..., range(3), range(3)] = (1.0 - trace)[..., None] + 2.0 * R[..., range(3), range(3)]
    multiples[..., 3, :3] = multiples[..., :3, 3] = (
        R[..., (2, 0, 1), (1, 2, 0)] - R[..., (1, 2, 0), (2, 0, 1)]
    )
    multiples[..., 3, 3] = 1.0 + trace
    sizes = np.concatenate((R[..., range(3), range(3)], trace[..., None]), axis=-1)
    q = np.take_along_axis(multiples, sizes.argmax(axis=-1)[..., None, None], axis=-2)[..., 0, :]
    return q / np.sqrt((q * q).sum(axis=-1, keepdims=True))


def rpy_from_rotation(rotation: ArrayLike) -> Array:
    """Return roll, pitch, yaw (rad) of a rotation matrix, shape (3, 3), in the URDF convention.

    Yaw first, then the rest from R' = Rz(-yaw) R = Ry(pitch) Rx(roll), which is also accurate at a pitch of
    +-pi/2, common for grasps.
    """
    R = as_array("rotation", rotation, 3, 3)
    yaw = np.arctan2(R[1, 0], R[0, 0])
    cos, sin = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], cos * R[0, 0] + sin * R[1, 0])
    roll = np.arctan2(sin * R[0, 2] - cos * R[1, 2], cos * R[1, 1] - sin * R[0, 1])
    return np.array((roll, pitch, yaw))


def make_pose(translation: ArrayLike = (0.0, 0.0, 0.0), rpy: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Return X_AB of a frame B displaced by translation (m) and turned by rpy (rad) in A, shape (4, 4)."""
    X_AB = np.eye(4)
    X_AB[:3, :3] = rotation_from_rpy(rpy)
    X_AB[:3, 3] = as_array("translation", translation, 3)
    return X_AB


def inverse_pose(X_AB: Array) -> Array:
    """Return X_BA = X_AB^-1, shape (4, 4)."""
    X_AB = shaped("X_AB", X_AB, 4, 4)
    R_BA = X_AB[:3, :3].T
    X_BA = np.zeros_like(X_AB)
    X_BA[:3, :3] = R_BA
    X_BA[:3, 3] = -R_BA @ X_AB[:3, 3]
    X_BA[3, 3] = 1.0
    return X_BA


def pose_error(X_WP: Array, X_WP_d: Array) -> Array:
    """Return the pose error, actual minus desired, in world axes.

    ``[p_WP - p_WP_d, log(R_WP R_WP_d^T)]``, m and rad, shape (6,).

    Args:
        X_WP: the pose, shape (4, 4).
        X_WP_d: the desired pose, shape (4, 4).
    """
    X_WP, X_WP_d = shaped("X_WP", X_WP, 4, 4), shaped("X_WP_d", X_WP_d, 4, 4)
    return np.concatenate((X_WP[:3, 3] - X_WP_d[:3, 3], _log3(X_WP[:3, :3] @ X_WP_d[:3, :3].T)))


def log3(R: Array) -> Array:
    """Return the rotation vectors of rotation matrices, of length 0 to pi, rad, shape (..., 3).

    From the quaternion (w, x, y, z) of the largest of its four entries, which is accurate at all angles:
    ``2 atan2(|(x, y, z)|, w)`` along (x, y, z), with w >= 0.

    Args:
        R: rotation matrices, shape (..., 3, 3).

    Raises:
        ShapeError: the shape differs.
    """
    return _log3(shaped("R", R, 3, 3))


def _log3(R: Array) -> Array:
    """Return ``log3`` of rotation matrices that have the shape."""
    entries = R.tolist() if R.ndim == 2 else np.ascontiguousarray(np.moveaxis(R, (-2, -1), (0, 1)))
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = entries
    # Four multiples of the quaternion; the factor of each is its own diagonal entry.
    w, x, y, z = by_w = (1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy)
    trace = xx + yy + zz
    if R.ndim == 2:
        are_small = isinstance(trace, float) and trace > max(xx, yy, zz)
    else:
        are_small = R.dtype != object and (trace > R.diagonal(0, -2, -1).max(axis=-1)).all()
    if not are_small:  # most are turns below 120 degrees
        by_x = (zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx)
        by_y = (xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy)
        by_z = (yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz)
        largest = where(yy > xx, (yy, *by_y), (xx, *by_x))
        largest = where(zz > largest[0], (zz, *by_z), largest)
        w, x, y, z = where(trace > largest[0], by_w, largest[1:])
    sign = where(w < 0.0, -1.0, 1.0)
    w = sign * w
    length = sqrt(x * x + y * y + z * z)
    is_small = length < _SMALL
    # Both quotients are formed, and neither may divide by zero.
    by_w_only, by_angle = 2.0 / where(is_small, w, 1.0), 2.0 * atan2(length, w) / where(is_small, 1.0, length)
    factor = sign * where(is_small, by_w_only, by_angle)
    vector = np.array((factor * x, factor * y, factor * z))
    return vector if vector.ndim == 1 else np.moveaxis(vector, 0, -1)


def exp3(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector, shape (3, 3): the inverse of ``log3``.

    ``R = cos(a) I + sinc(a) [r]x + (1 - cos a) / a^2 r r^T`` with ``a = |r|``, where (1 - cos a) / a^2 is
    sinc(a / 2)^2 / 2.

    Args:
        vector: r, rad, shape (3,).

    Raises:
        ShapeError: the shape differs.
    """
    x, y, z = shaped("vector", vector, 3).tolist()
    angle = sqrt(x * x + y * y + z * z)
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    along = np.array(((x * x, x * y, x * z), (x * y, y * y, y * z), (x * z, y * z, z * z)))
    return np.cos(angle) * np.eye(3) + _sinc(angle) * cross + 0.5 * _sinc(angle / 2.0) ** 2 * along


def _sinc(angle: float) -> float:
    """Return sin(a) / a, 1 at a = 0."""
    is_small = angle < _SMALL
    return where(is_small, 1.0, np.sin(angle) / where(is_small, 1.0, angle))


def shift_wrench(F_EA: Array, p_BA: Array) -> Array:
    """Return the same wrench with its moment taken about another point.

    ``F_EB = [f, n + p_BA x f]``

    Args:
        F_EA: wrench with its moment about A, N and N m, shape (..., 6).
        p_BA: position of A seen from B, in the axes of the wrench, m, shape (..., 3).
    """
    F_EA, p_BA = shaped("F_EA", F_EA, 6), shaped("p_BA", p_BA, 3)
    force, moment = F_EA[..., :3], F_EA[..., 3:]
    return np.concatenate((force, moment + np.cross(p_BA, force)), axis=-1)


def weight_wrench(mass: float, gravity: ArrayLike) -> Array:
    """Return the weight of a body about its centre of mass in world axes, [m g, 0], N and N m, shape (6,).

    Args:
        mass: kg.
        gravity: g, m/s^2, shape (3,).

    Raises:
        ShapeError: the shape differs.
        WrongTypeError: the mass is no number, traced or not.
    """
    return np.concatenate((_times(mass, as_array("gravity", gravity, 3)), np.zeros(3)))


def _times(mass: float, values: Array) -> Array:
    """Return a mass, traced or not, times numbers; raises WrongTypeError."""
    with contextlib.suppress(TypeError, ValueError, OverflowError):  # an array of another shape, 10**400
        if (product := mass * values).shape == values.shape:
            return product
    raise WrongTypeError("mass", type(mass).__name__, "float")


def spatial_inertia(mass: float, inertia: Array, R_WP: Array) -> Array:
    """Return M_0 of eq. (5), the inertia of the payload about P in world axes, kg and kg m^2, shape (6, 6).

    Args:
        mass: Mass of the payload, kg.
        inertia: Inertia about P in the axes of P, kg m^2, shape (3, 3).
        R_WP: Orientation of the payload, shape (3, 3).

    Raises:
        ShapeError: a shape differs.
        WrongTypeError: the mass is no number, traced or not.
    """
    inertia, R_WP = shaped("inertia", inertia, 3, 3), shaped("R_WP", R_WP, 3, 3)
    M_0 = np.zeros((6, 6))
    M_0[:3, :3], M_0[3:, 3:] = _times(mass, np.eye(3)), R_WP @ inertia @ R_WP.T
    return M_0


def rotate_vector6(R_AB: Array, vector_B: Array) -> Array:
    """Return a twist or wrench given in axes B, expressed in axes A, about the same point.

    Args:
        R_AB: rotation matrix, shape (..., 3, 3).
        vector_B: six-vector, shape (..., 6).
    """
    R_AB, vector_B = shaped("R_AB", R_AB, 3, 3), shaped("vector_B", vector_B, 6)
    halves = vector_B.reshape(*vector_B.shape[:-1], 2, 3)
    turned = halves.dot(R_AB.T) if R_AB.ndim == 2 else halves @ np.swapaxes(R_AB, -1, -2)
    return turned.reshape(vector_B.shape)


def norms6(vectors: Array) -> tuple[Array, Array]:
    """Return the norms of the linear and of the angular parts of six-vectors, shape (..., 6)."""
    x, y, z, rx, ry, rz = np.moveaxis(shaped("vectors", vectors, 6), -1, 0)
    return np.sqrt(x * x + y * y + z * z), np.sqrt(rx * rx + ry * ry + rz * rz)
