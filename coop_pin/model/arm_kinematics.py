"""What an arm's own encoders and kinematics say about the payload, in drive coordinates, without any dynamics."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array
from coop_pin.description.arm import Arm
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.pinocchio_model import frame_id, without_inertia
from coop_pin.spatial import inverse_pose
from coop_pin.spatial.task_rows import TaskRows


class PayloadKinematics(NamedTuple):
    """The payload as an arm sees it.

    Attributes:
        pose: X_WP, shape (4, 4).
        jacobian: J_phi with V_WP = J_phi v_drive, task rows, shape (k_0, nv).
    """

    pose: Array
    jacobian: Array


class ArmKinematics:
    """Forward kinematics and payload Jacobian of one arm, from a copy of its model whose inertias are zero.

    The arm believes in its calibration error: its payload frame sits at X_EP displaced by it.
    """

    def __init__(self, arm: Arm, X_PE: Array, rows: TaskRows) -> None:
        believed_X_PE = X_PE @ inverse_pose(arm.calibration_error.matrix)
        arm_model = ArmModel(arm, believed_X_PE)
        self._model = without_inertia(arm_model.model)
        self._data = self._model.createData()
        self._payload = frame_id(self._model, "payload")
        self._rows = rows
        self._to_joint_rates = np.linalg.inv(arm_model.drive)

    def view(self, q: Array) -> PayloadKinematics:
        """Return the payload pose and Jacobian at joint angles q."""
        J = pin.computeFrameJacobian(self._model, self._data, q, self._payload, pin.LOCAL_WORLD_ALIGNED)
        pose = pin.updateFramePlacement(self._model, self._data, self._payload).homogeneous
        return PayloadKinematics(pose, self._rows.select(J).dot(self._to_joint_rates))
