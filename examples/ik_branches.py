"""Inverse-kinematics branches: the eight configurations of a UR5 for one pose, with condition numbers."""

import numpy as np

import coop_pin as cp

arm = cp.Arm.from_urdf("ur5", tip="tool0", posture=(0.1, -1.2, 1.6, -1.0, -1.4, 0.2))
model = cp.model.ArmModel(arm, X_PE=cp.Pose(rpy=(0.0, np.pi / 2, 0.0)).matrix)
payload = cp.Pose(xyz=(0.45, 0.05, 0.4))

for q in cp.model.ik_branches(model, payload.matrix, posture=arm.posture):
    gap = np.abs(model.payload_pose(q) - payload.matrix).max()
    condition = np.linalg.cond(model.payload_jacobian(q))
    print(
        f"q = {np.array2string(q, precision=3, suppress_small=True, sign=' ')}"
        f"  condition {condition:5.1f}  gap {gap:.0e}"
    )
