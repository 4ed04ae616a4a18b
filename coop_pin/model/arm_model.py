"""Dynamics and kinematics of one arm with Pinocchio; payload kinematics without dynamics for controllers."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.base.arrays import Array, as_array, as_pose, require_finite, require_type
from coop_pin.base.spatial import TaskRows, inverse_pose
from coop_pin.description.cell.arm import Arm
from coop_pin.description.cell.miscalibration import Miscalibration
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.joint_limits import JointLimits, per_joint
from coop_pin.model.pinocchio_model import (
    ModelKey,
    add_frame,
    append_arm,
    empty_model,
    frame_id,
    jacobian_matrix,
    model_key,
    shared_arm_model,
    symmetric,
    without_inertia,
)


class ArmModel:
    """Dynamics and kinematics of one arm fixed in the world, in coordinates q, v, tau, without friction.

    The payload frame P is rigidly attached to the tip E.

    Attributes:
        name: arm name in error messages.
        model: the Pinocchio model, with frames "tip" (E) and "payload" (P); all other names begin with
            "arm/".
        key: values on which its kinematics depend.
        nq: size of q.
        nv: size of v.
        base_joints: number of its first joints, which move its mobile base.
        drive: Drive matrix (transmission) T with q_drive = T q, shape (nv, nv).
        from_drive: Inverse transmission T^-1, with v = T^-1 qdot, shape (nv, nv).
        to_held_rows: map of a gap in tip axes to the rows that a joint holds, shape (6, 6), where inverse
            kinematics leave the others free; None where they hold all.
    """

    to_held_rows: Array | None = None

    def __init__(
        self,
        arm: Arm,
        X_PE: ArrayLike | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        *,
        name: str = "arm",
    ) -> None:
        """Build the model.

        Args:
            arm: the description.
            X_PE: pose of the tip in the payload frame, shape (4, 4); identity when omitted.
            gravity: m/s^2, in world axes, shape (3,).
            name: arm name in error messages.

        Raises:
            UrdfError: the URDF is missing or defective.
            NameNotFoundError: the tip is not in the URDF.
        """
        require_type("arm", arm, Arm)
        require_type("name", name, str)
        self.name, self._arm = name, arm
        grasp, g = np.eye(4) if X_PE is None else as_pose("X_PE", X_PE), as_array("gravity", gravity, 3)
        self.key = (model_key(arm), arm.tip, arm.base.matrix.tobytes(), grasp.tobytes())
        tree = _arm_tree(*self.key, g.tobytes(), f"{arm.urdf!r}, the tip of arm {name!r}")
        self.model, self._tip, self._payload, self._angles = tree._replace(model=tree.model.copy())
        self._data = self.model.createData()
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        self.base_joints = arm.base_joints
        self.drive = arm.drive_matrix(self.nv)
        self.from_drive = np.asarray(np.linalg.inv(self.drive), dtype=np.float64)

    @cached_property
    def limits(self) -> JointLimits:
        """Joint, velocity and effort limits.

        Raises:
            FieldError: the number of torque limits differs from the number of joints.
        """
        return JointLimits(self._arm, self.name)

    def configuration(self, angles: ArrayLike) -> Array:
        """Return q at joint angles, one for each joint (also for continuous ones), rad or m, shape (nq,)."""
        return self._angles.configuration(self._v("angles", angles))

    def posture(self, posture: ArrayLike | None) -> Array:
        """Return the configuration of a posture, shape (nq,).

        Args:
            posture: joint angles, shape (nv,), or a configuration, shape (nq,); all angles zero when None.
        """
        if posture is None:
            return np.array(pin.neutral(self.model))
        argument = f"posture of arm {self.name!r}"
        if np.shape(posture) == (self.nv,):
            return self._angles.configuration(as_array(argument, posture, self.nv))
        return np.array(pin.normalize(self.model, as_array(argument, posture, self.nq)))

    def joint_angles(self, q: ArrayLike) -> Array:
        """Return the joint angles of q, rad or m, of continuous joints between -pi and pi, shape (nv,)."""
        return self._angles.of(self._q(q))

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q) by CRBA, kg m^2, shape (nv, nv), symmetric."""
        return require_finite("M", symmetric(pin.crba(self.model, self._data, self._q(q))))

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return h(q, v): Coriolis, centrifugal and gravity torques, N m, shape (nv,)."""
        h = np.array(pin.nonLinearEffects(self.model, self._data, self._q(q), self._v("v", v)))
        return require_finite("h", h)

    def forward_dynamics(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, F_EP_W: ArrayLike = (0.0,) * 6
    ) -> Array:
        """Return a = M^-1 (tau - h + J_WP^T F_EP_W) by ABA, rad/s^2, shape (nv,).

        Gueaieb et al. (2007), eq. (4).

        Args:
            q: joint angles, shape (nq,).
            v: joint rates, shape (nv,).
            tau: joint torques, shape (nv,).
            F_EP_W: wrench on the arm about P in world axes, N and N m, shape (6,).
        """
        torque = self._v("tau", tau) + self.payload_jacobian(q).T @ as_array("F_EP_W", F_EP_W, 6)
        a = np.array(pin.aba(self.model, self._data, self._q(q), self._v("v", v), torque))
        return require_finite("a", a)

    def inverse_dynamics(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, F_EP_W: ArrayLike = (0.0,) * 6
    ) -> Array:
        """Return tau = M a + h - J_WP^T F_EP_W by RNEA, N m, shape (nv,)."""
        torque = np.array(pin.rnea(self.model, self._data, self._q(q), self._v("v", v), self._v("a", a)))
        return require_finite("tau", torque - self.payload_jacobian(q).T @ as_array("F_EP_W", F_EP_W, 6))

    def tip_pose(self, q: ArrayLike) -> Array:
        """Return X_WE, shape (4, 4)."""
        return self._frame_pose(q, self._tip)

    def payload_pose(self, q: ArrayLike) -> Array:
        """Return X_WP from the kinematics of this arm: phi_i(q_i) of eq. (1), shape (4, 4)."""
        return self._frame_pose(q, self._payload)

    def payload_jacobian(self, q: ArrayLike) -> Array:
        """Return J_WP with V_WP = J_WP v: J_phi_i of eq. (2), in world axes, shape (6, nv)."""
        J = pin.computeFrameJacobian(
            self.model, self._data, self._q(q), self._payload, pin.LOCAL_WORLD_ALIGNED
        )
        return require_finite("J_WP", jacobian_matrix(np.array(J)))

    def payload_acceleration_bias(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return Jdot v, the part of d/dt V_WP without joint accelerations (eq. (3)), shape (6,)."""
        pin.forwardKinematics(self.model, self._data, self._q(q), self._v("v", v), np.zeros(self.nv))
        bias = pin.getFrameClassicalAcceleration(
            self.model, self._data, self._payload, pin.LOCAL_WORLD_ALIGNED
        )
        return require_finite("Jdot v", bias.vector.copy())

    def _frame_pose(self, q: ArrayLike, frame: int) -> Array:
        pin.framesForwardKinematics(self.model, self._data, self._q(q))
        return require_finite("the pose", np.array(self._data.oMf[frame].homogeneous))

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.nv)


class _ArmTree(NamedTuple):
    """Pinocchio model of an arm fixed in the world, which the callers share.

    Attributes:
        model: model with the frames "tip" and "payload".
        tip: index of the frame "tip".
        payload: index of the frame "payload".
        angles: conversion between its joint angles and q.
    """

    model: pin.Model
    tip: int
    payload: int
    angles: JointAngles


@lru_cache(maxsize=64)
def _arm_tree(key: ModelKey, tip: str, X_WB: bytes, X_PE: bytes, gravity: bytes, container: str) -> _ArmTree:
    """Return the model of an arm by the values of ArmModel; messages name a container of the tip."""
    alone = shared_arm_model(key)
    frame = alone.frames[frame_id(alone, tip, container)]
    model = append_arm(empty_model(np.frombuffer(gravity)), alone, "arm", np.frombuffer(X_WB).reshape(4, 4))
    X_EP = pin.SE3(inverse_pose(np.frombuffer(X_PE).reshape(4, 4)))
    tip_index = add_frame(model, "tip", frame.parentJoint, frame.placement)
    payload = add_frame(model, "payload", frame.parentJoint, frame.placement * X_EP)
    return _ArmTree(model, tip_index, payload, JointAngles(model))


class PayloadKinematics(NamedTuple):
    """Pose and Jacobian of the payload from the kinematics of one arm.

    Attributes:
        pose: X_WP, shape (4, 4).
        jacobian: J_phi with V_WP = J_phi v_drive, task rows, shape (k_0, nv).
        carried: J_s v_s, the part of V_WP by shared joints under the arm, shape (k_0,); None without any.
    """

    pose: Array
    jacobian: Array
    carried: Array | None = None


class ArmKinematics:
    """Forward kinematics and payload Jacobian of one arm, from a copy of its model without inertias.

    The copy has the arm's calibration error, which the arm does not know of.

    Attributes:
        model: the copy, with the frame "payload".
    """

    def __init__(self, arm: Arm, X_PE: Array, rows: TaskRows) -> None:
        arm_model = ArmModel(arm, X_PE @ inverse_pose(arm.calibration_error.tip.matrix))
        self.model = without_inertia(arm_model.model)
        _miscalibrate(self.model, arm)
        self._data = self.model.createData()
        self._payload = frame_id(self.model, "payload")
        self._rows = rows
        self._to_joint_rates = arm_model.from_drive

    def view(self, q: Array) -> PayloadKinematics:
        """Return the payload pose and Jacobian at q, shape (nq,)."""
        J = jacobian_matrix(
            pin.computeFrameJacobian(self.model, self._data, q, self._payload, pin.LOCAL_WORLD_ALIGNED)
        )
        pose = pin.updateFramePlacement(self.model, self._data, self._payload).homogeneous
        return PayloadKinematics(pose, self._rows.select(J).dot(self._to_joint_rates))


def _miscalibrate(model: pin.Model, arm: Arm) -> None:
    """Put an arm's errors of link lengths, joint offsets and base into the placements of a model.

    A joint's motion commutes with its offset, so that the offset is one of the joint's placement.

    Raises:
        FieldError: the number of joint offsets or link lengths differs from that of the joints.
    """
    error, X_WB = arm.calibration_error, arm.base.matrix
    offset, stretch = (
        per_joint(np.array(value), int(model.nv), f"calibration_error.{name}")
        for name, value in (("joint_offset", error.joint_offset), ("link_length", error.link_length))
    )
    if stretch.any():
        for joint in range(1, model.njoints):
            parent = int(model.parents[joint])
            if parent > 0:
                model.jointPlacements[joint].translation *= 1.0 + stretch[parent - 1]
        joint = model.frames[frame_id(model, "tip")].parentJoint
        p_E = model.frames[frame_id(model, "tip")].placement.translation.copy()
        model.frames[frame_id(model, "payload")].placement.translation += stretch[joint - 1] * p_E
    if offset.any():
        data = model.createData()
        pin.forwardKinematics(model, data, pin.integrate(model, pin.neutral(model), offset))
        for joint in range(1, model.njoints):
            model.jointPlacements[joint] = data.liMi[joint]
    if error.base != Miscalibration().base:
        moved = pin.SE3(X_WB @ error.base.matrix @ inverse_pose(X_WB))
        for joint in range(1, model.njoints):
            if model.parents[joint] == 0:
                model.jointPlacements[joint] = moved * model.jointPlacements[joint]
