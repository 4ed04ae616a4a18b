"""The damping of a sliding-mode cell against the inertia of its coordinates."""

from __future__ import annotations

import numpy as np

from coop_pin.model import CellArm
from coop_pin.model.inverse_kinematics import solve_ik


def damping_and_inertia(cell, X, damping_gains):
    """B = sum_i J_i^-T K_d_i J_i^-1 and A = M_0 + sum_i J_i^-T M_i J_i^-1 in the task rows."""
    rows, world_inertia = cell.task_rows, np.zeros((6, 6))
    world_inertia[:3, :3] = cell.payload.mass * np.eye(3)
    world_inertia[3:, 3:] = X[:3, :3] @ cell.payload.inertia_matrix @ X[:3, :3].T
    inertia = rows.select(rows.select(world_inertia).T)
    damping = np.zeros_like(inertia)
    for name, arm in cell.arms.items():
        model = CellArm(cell, name)
        q = solve_ik(model, X, posture=arm.posture)
        to_drive = np.linalg.inv(model.drive)
        J_inverse = np.linalg.inv(rows.select(model.payload_jacobian(q)) @ to_drive)
        inertia = inertia + J_inverse.T @ to_drive.T @ model.mass_matrix(q) @ to_drive @ J_inverse
        damping = damping + J_inverse.T @ damping_gains[name] @ J_inverse
    return damping, inertia
