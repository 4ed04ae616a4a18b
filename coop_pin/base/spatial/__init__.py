"""Spatial algebra and notation of coop_pin: frames, poses, twists, wrenches and task rows.

Open first: ``pose`` (matrices, pose errors, wrenches about another point), ``internal_wrench`` (the split of
interaction wrenches into load and internal ones), ``task_rows``. ``limit_surface`` has friction of a patch,
``generic_numbers`` functions for numbers and traced scalars alike.

**Frames.** W world, B arm base, E end effector (the grasping tip of an arm), P payload, with its origin at
the payload's centre of mass. Arms have names ("left", "right"), not numbers.

**Poses.** ``X_AB`` is the pose of frame B in frame A: a 4x4 homogeneous matrix, so that ``p_A = X_AB @ p_B``
and ``X_AC = X_AB @ X_BC``. Lengths in metres.

**Six-vectors** are linear first, angular second. ``V_WP`` is the twist of P in W expressed in world axes at
the origin of P (Pinocchio's LOCAL_WORLD_ALIGNED), m/s and rad/s. ``F_EP_W`` is the wrench on body E, moment
taken about the origin of P, expressed in world axes, N and N m. ``J_WP`` is the Jacobian with ``V_WP = J_WP @
v``.

**Desired and error.** A suffix ``_d`` is desired; ``_error`` is actual minus desired. The orientation error
is the rotation vector (log) of ``R_WP @ R_WP_d.T``, expressed in the world.

**Joints.** q, v, a, tau as in Pinocchio. *Drive coordinates* are the coordinates of the motors:
``q_drive = T @ q`` and ``tau = T.T @ tau_drive`` with the arm's constant drive matrix T (identity unless
stated).

**Internal wrench.** The interaction wrench ``F_i`` acts on arm i by the payload, about P. With load shares
c_i that sum to one, ``f_i = F_i - c_i sum_j F_j`` is the internal wrench and ``sum_i f_i = 0`` (Gueaieb et
al. (2007), eqs. (7)-(12)).

**Task rows.** A cell controls k_0 of the six rows: all of them ("full"), x, y and the rotation about z
("planar"), or x, y, z ("positional").
"""

from coop_pin.base.spatial.internal_wrench import internal_wrenches, load_wrenches
from coop_pin.base.spatial.pose import (
    exp3,
    inverse_pose,
    log3,
    make_pose,
    norms6,
    pose_error,
    quaternions,
    rotate_vector6,
    rotation_from_rpy,
    rotations,
    rpy_from_rotation,
    shift_wrench,
    spatial_inertia,
    weight_wrench,
)
from coop_pin.base.spatial.task_rows import FullRows, PlanarRows, PositionalRows, TaskRows, task_rows

__all__ = [
    "FullRows",
    "PlanarRows",
    "PositionalRows",
    "TaskRows",
    "exp3",
    "internal_wrenches",
    "inverse_pose",
    "load_wrenches",
    "log3",
    "make_pose",
    "norms6",
    "pose_error",
    "quaternions",
    "rotate_vector6",
    "rotation_from_rpy",
    "rotations",
    "rpy_from_rotation",
    "shift_wrench",
    "spatial_inertia",
    "task_rows",
    "weight_wrench",
]
