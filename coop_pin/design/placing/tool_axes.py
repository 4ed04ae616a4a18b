"""Direction of a tool by its arm, and rotations that turn it onto another one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.model.arm_model import ArmModel
from coop_pin.model.pinocchio_model import frame_id

_FLUSH, _ACROSS = 1e-3, 0.4
"""Length below which the way from a joint does not tell where the tool points, m; cosine below which the
last joint's axis is across the tool."""


def tool_axis(model: ArmModel, q: Array) -> Array:
    """Return the direction of the tool in tip axes: the last joint's axis, away from the wrist.

    Where this axis is across the way from the nearest joint to the tip, as in a wrist that bends last, it is
    that way.
    """
    data = model.model.createData()
    pin.forwardKinematics(model.model, data, q)
    X_BE, last = model.tip_pose(q), model.model.frames[frame_id(model.model, "tip")].parentJoint
    column = model.payload_jacobian(q)[:, model.model.joints[last].idx_v]
    axis = column[3:] if column[3:].any() else column[:3]
    axis /= np.linalg.norm(axis)
    joint = last
    while joint and np.linalg.norm(X_BE[:3, 3] - data.oMi[joint].translation) < _FLUSH:
        joint = model.model.parents[joint]
    way = X_BE[:3, 3] - data.oMi[joint].translation if joint else axis
    along = float(axis @ way) / float(np.linalg.norm(way))
    bends = abs(along) < _ACROSS and bool(column[3:].any())
    return X_BE[:3, :3].T @ (way / np.linalg.norm(way) if bends else np.copysign(axis, axis * along))


def triad(first: Array, second: Array) -> Array:
    """Return the rotation whose columns are a unit vector, another one's part across it, their product."""
    across = second - first * (first @ second)
    across /= np.linalg.norm(across)
    return np.column_stack((first, across, np.cross(first, across)))
