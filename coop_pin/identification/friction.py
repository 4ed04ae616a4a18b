"""Friction of the drives, from their torques where the motion reverses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.description.cell.joint_friction import JointFriction
from coop_pin.identification.filtering import Filtered
from coop_pin.model.cell_arm import CellArm

WIDTH = JointFriction().coulomb_velocity
"""Speed within which Coulomb friction changes sign, rad/s."""
_REVERSES = 0.05
"""Part of the samples in which a drive must move the other way for its friction to be told from an offset."""


class DriveFriction(NamedTuple):
    """Friction of a drive.

    Attributes:
        arm: name of the arm.
        drive: number of the drive, from zero.
        viscous: N m s/rad.
        coulomb: N m.
        sd: their standard deviations, N m s/rad and N m; inf where they are not seen.
    """

    arm: str
    drive: int
    viscous: float
    coulomb: float
    sd: tuple[float, float]

    def __str__(self) -> str:
        """Return its size as text."""
        return f"{self.coulomb:.3g} N m and {self.viscous:.3g} N m s/rad"

    @property
    def is_seen(self) -> bool:
        """Whether the motion reversed."""
        return bool(np.isfinite(self.sd).all())


def friction_fit(arm: CellArm, samples: Filtered, zero: Array, sd: Array) -> list[DriveFriction]:
    """Return the friction of every drive: tau - M a - h + J^T F = viscous v + coulomb tanh(v / w) + const.

    Inertias are those of the URDF; a drive with gravity compensation of its own must log its whole torque.
    F is without the zero of the wrist, and what is not known of it is fitted beside the friction.

    Args:
        arm: the arm.
        samples: filtered samples of the drive.
        zero: zero of the wrist in axes of the tip, N and N m, shape (6,).
        sd: standard deviations, shape (6,).
    """
    if not np.isfinite(samples.tau).all() or not np.isfinite(samples.wrench).all():
        return []
    left, by_wrist = np.empty_like(samples.tau), np.empty((*samples.tau.shape, 6))
    to_P = pin.SE3(arm.X_PE).toDualActionMatrix()
    for k, (angles, v, a) in enumerate(zip(samples.q, samples.v, samples.a, strict=True)):
        q = arm.configuration(angles)
        W = np.kron(np.eye(2), arm.payload_pose(q)[:3, :3]) @ to_P
        left[k] = samples.tau[k] - arm.inverse_dynamics(q, v, a, W @ (samples.wrench[k] - zero))
        by_wrist[k] = arm.payload_jacobian(q).T @ W * sd
    at_drives, speeds = left @ arm.from_drive, samples.v @ arm.drive.T
    wrist = np.einsum("nij,ik->nkj", by_wrist, arm.from_drive)
    return [_fit(arm.name, d, at_drives[:, d], speeds[:, d], -wrist[:, d]) for d in range(arm.nv)]


def _fit(arm: str, drive: int, torque: Array, speed: Array, wrist: Array) -> DriveFriction:
    """Return the friction of a drive; the zeros of the wrist, in sds, have the torque's scatter as prior."""
    A = np.column_stack((speed, np.tanh(speed / WIDTH), np.ones(len(speed)), wrist))
    fast = np.abs(speed) > WIDTH
    backward = float((speed[fast] < 0.0).mean()) if fast.any() else 0.0
    if min(backward, 1.0 - backward) < _REVERSES:
        return DriveFriction(arm, drive, np.nan, np.nan, (np.inf, np.inf))
    weight, variance = np.diag([0.0] * 3 + [1.0] * wrist.shape[1]), float(np.diff(torque).var()) / 2.0
    for _ in range(3):  # the variance decides how much the prior counts
        H = np.linalg.inv(A.T @ A + variance * weight)
        residual = torque - A @ (x := H @ (A.T @ torque))
        variance = float(residual @ residual) / max(len(torque) - 3, 1)
    sd = np.sqrt(np.diag(H) * variance)
    return DriveFriction(arm, drive, float(x[0]), float(x[1]), (float(sd[0]), float(sd[1])))
