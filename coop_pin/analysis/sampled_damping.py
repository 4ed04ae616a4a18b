"""How much joint damping a control rate can bear."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigvalsh

from coop_pin.arrays import Array, as_array
from coop_pin.chain.inverse_kinematics import solve_ik
from coop_pin.description.cell import Cell
from coop_pin.model.arm_model import ArmModel


def sampled_damping(cell: Cell, X_WP: ArrayLike, damping_gains: Mapping[str, Array], period: float) -> float:
    """Return T lambda_max(A^-1 B): the held damping torque is stable while this stays below 2.

    A = M_0 + sum_i J_i^-T M_i J_i^-1 is the inertia and B = sum_i J_i^-T K_d_i J_i^-1 the damping that the
    payload feels in the k_0 task rows. Held over a tick T, xdot[k+1] = (I - T A^-1 B) xdot[k].

    Args:
        cell: whose arms have as many joints as the cell has task rows.
        X_WP: payload pose, shape (4, 4).
        damping_gains: K_d of every arm in drive coordinates, N m s/rad, shape (k, k).
        period: T, s.

    Raises:
        UnreachablePoseError: an arm cannot hold the payload there.
    """
    X = as_array("X_WP", X_WP, 4, 4)
    rows = cell.task_rows
    world_inertia = np.zeros((6, 6))
    world_inertia[:3, :3] = cell.payload.mass * np.eye(3)
    world_inertia[3:, 3:] = X[:3, :3] @ cell.payload.inertia_matrix @ X[:3, :3].T
    inertia = rows.select(rows.select(world_inertia).T)
    damping = np.zeros_like(inertia)
    for name, arm in cell.arms.items():
        model = ArmModel(arm, cell.grasps[name].matrix)
        q = solve_ik(name, model, X, arm.posture)
        to_drive = np.linalg.inv(model.drive)
        J_inverse = np.linalg.inv(rows.select(model.payload_jacobian(q)) @ to_drive)
        drive_inertia = to_drive.T @ model.mass_matrix(q) @ to_drive
        inertia = inertia + J_inverse.T @ drive_inertia @ J_inverse
        damping = damping + J_inverse.T @ damping_gains[name] @ J_inverse
    return period * float(eigvalsh(damping, inertia)[-1])
