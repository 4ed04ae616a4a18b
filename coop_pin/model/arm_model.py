"""One arm alone: mass matrix, forward and inverse dynamics, payload kinematics, from Pinocchio."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coop_pin.arrays import Array, as_array
from coop_pin.description.arm import Arm
from coop_pin.description.urdf import UrdfFile, load_checked
from coop_pin.description.urdf.robot import Robot
from coop_pin.errors import MimicJointError, UrdfError
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.pinocchio_model import (
    add_frame,
    append_arm,
    empty_model,
    frame_id,
    joint_id,
    model_from_text,
    symmetric,
)
from coop_pin.spatial import inverse_pose

_SLACK = 1e-9
_DRIVEN = ("revolute", "continuous", "prismatic")


class UnreducedArm(NamedTuple):
    """An arm before its joints are locked.

    Attributes:
        model: all joints of the URDF.
        text: the URDF.
        locked: indices of the joints to lock.
        configuration: at which they are locked, shape (nq,).
    """

    model: pin.Model
    text: str
    locked: list[int]
    configuration: Array


def load_arm_model(arm: Arm) -> pin.Model:
    """Return the model of an arm by itself, with its base at the origin: a copy, which the caller may change.

    Models are built several times for a run; the file is read again only when it has changed.

    Raises:
        UrdfError: the URDF does not exist; it has structural defects; a locked joint is out of its limits, or
            none is left; MimicJointError: joints mimic others and ``mimic`` refuses them; a joint is planar
            or floating.
        NameNotFoundError: a locked joint does not exist.
    """
    file = arm.file
    version = file.path.stat()
    return _reduced(
        file, (version.st_mtime_ns, version.st_size), tuple(arm.locked.items()), arm.mimic == "ignore"
    ).copy()


def load_unreduced_arm(arm: Arm) -> UnreducedArm:
    """Return the model of an arm with all its joints, and which of them are locked where; raises as load_arm_model."""
    return _whole(arm.file, arm.locked, arm.mimic == "ignore")


@lru_cache(maxsize=64)
def _reduced(
    file: UrdfFile, version: tuple[int, int], locked: tuple[tuple[str, float], ...], ignore_mimic: bool
) -> pin.Model:  # noqa: ARG001
    whole = _whole(file, dict(locked), ignore_mimic)
    return (
        pin.buildReducedModel(whole.model, whole.locked, whole.configuration) if whole.locked else whole.model
    )


def _whole(file: UrdfFile, locked: Mapping[str, float], ignore_mimic: bool) -> UnreducedArm:
    text = load_checked(file)
    robot, model = Robot(text), model_from_text(text, file.path.name)
    angles = robot.locked(locked)
    q = pin.neutral(model)
    for joint, angle in angles.items():
        _lock(model, q, joint, angle)
    moving = robot.unlocked(locked)
    if not moving:
        raise UrdfError(f"locks every joint of {file.path.name}; an arm must have one that moves", "locked")
    for joint in moving:
        if robot.joints[joint] not in _DRIVEN:
            raise UrdfError(
                f"{file.path.name!r} has joint {joint!r} of type {robot.joints[joint]};"
                " arms have revolute, continuous, prismatic and fixed joints",
                "urdf",
                [joint],
            )
    followers = [joint for joint in moving if joint in robot.mimics]
    if followers and not ignore_mimic:
        raise MimicJointError(file.path.name, followers, "mimic")
    return UnreducedArm(model, text, [joint_id(model, joint) for joint in angles], q)


def _lock(model: pin.Model, q: Array, joint: str, angle: float) -> None:
    index = joint_id(model, joint)
    first, size = int(model.idx_qs[index]), int(model.nqs[index])
    if size == 2:
        q[first : first + 2] = np.cos(angle), np.sin(angle)
    elif size > 2:
        raise UrdfError(
            "has more than one degree of freedom; only joints with one angle can be locked", f"locked.{joint}"
        )
    else:
        lower, upper = float(model.lowerPositionLimit[first]), float(model.upperPositionLimit[first])
        if not lower - _SLACK <= angle <= upper + _SLACK:
            raise UrdfError(
                f"is {angle:g}; the joint moves between {lower:g} and {upper:g}", f"locked.{joint}"
            )
        q[first] = angle


class ArmModel:
    """Dynamics and kinematics of one arm standing in the world, in joint coordinates q, v, tau.

    Friction is not part of it. The payload frame P is rigidly attached to the tip: X_EP.

    Attributes:
        model: the Pinocchio model.
        nq: size of q.
        nv: size of v.
        drive: drive matrix T with q_drive = T q, shape (nv, nv).
    """

    def __init__(
        self, arm: Arm, X_PE: ArrayLike | None = None, gravity: ArrayLike = (0.0, 0.0, -9.81)
    ) -> None:
        """Build the model.

        Args:
            arm: the description.
            X_PE: pose of the tip in the payload frame, shape (4, 4); identity when omitted.
            gravity: m/s^2, in world axes.

        Raises:
            UrdfError: the URDF is missing or defective.
            NameNotFoundError: the tip is not in the URDF.
        """
        alone = load_arm_model(arm)
        tip = alone.frames[frame_id(alone, arm.tip)]
        self.model = append_arm(empty_model(as_array("gravity", gravity, 3)), alone, "arm", arm.base.matrix)
        X_EP = pin.SE3(inverse_pose(np.eye(4) if X_PE is None else as_array("X_PE", X_PE, 4, 4)))
        self._tip = add_frame(self.model, "tip", tip.parentJoint, tip.placement)
        self._payload = add_frame(self.model, "payload", tip.parentJoint, tip.placement * X_EP)
        self._data = self.model.createData()
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        self.drive = arm.drive_matrix(self.nv)
        self._angles = JointAngles(self.model)

    def configuration(self, angles: ArrayLike) -> Array:
        """Return q at joint angles (one for each joint, continuous ones included), rad or m, shape (nq,)."""
        return self._angles.configuration(self._v("angles", angles))

    def joint_angles(self, q: ArrayLike) -> Array:
        """Return the joint angles of a configuration, those of continuous joints between -pi and pi, shape (nv,)."""
        return self._angles.of(self._q(q))

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q) by CRBA, kg m^2, shape (nv, nv), symmetric."""
        return symmetric(pin.crba(self.model, self._data, self._q(q)))

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return h(q, v): Coriolis, centrifugal and gravity torques, N m, shape (nv,)."""
        return np.array(pin.nonLinearEffects(self.model, self._data, self._q(q), self._v("v", v)))

    def forward_dynamics(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, F_EP_W: ArrayLike = (0.0,) * 6
    ) -> Array:
        """Return a = M^-1 (tau - h + J_WP^T F_EP_W) by ABA, rad/s^2, shape (nv,): eq. (4) of Gueaieb et al. (2007).

        Args:
            q: joint angles, shape (nq,).
            v: joint rates, shape (nv,).
            tau: joint torques, shape (nv,).
            F_EP_W: wrench on the arm about P in world axes, N and N m, shape (6,).
        """
        torque = self._v("tau", tau) + self.payload_jacobian(q).T @ as_array("F_EP_W", F_EP_W, 6)
        return np.array(pin.aba(self.model, self._data, self._q(q), self._v("v", v), torque))

    def inverse_dynamics(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, F_EP_W: ArrayLike = (0.0,) * 6
    ) -> Array:
        """Return tau = M a + h - J_WP^T F_EP_W by RNEA, N m, shape (nv,)."""
        torque = np.array(pin.rnea(self.model, self._data, self._q(q), self._v("v", v), self._v("a", a)))
        return torque - self.payload_jacobian(q).T @ as_array("F_EP_W", F_EP_W, 6)

    def tip_pose(self, q: ArrayLike) -> Array:
        """Return X_WE, shape (4, 4)."""
        return self._frame_pose(q, self._tip)

    def payload_pose(self, q: ArrayLike) -> Array:
        """Return X_WP through this arm: phi_i(q_i) of eq. (1), shape (4, 4)."""
        return self._frame_pose(q, self._payload)

    def payload_jacobian(self, q: ArrayLike) -> Array:
        """Return J_WP with V_WP = J_WP v: J_phi_i of eq. (2), in world axes, shape (6, nv)."""
        return np.array(
            pin.computeFrameJacobian(
                self.model, self._data, self._q(q), self._payload, pin.LOCAL_WORLD_ALIGNED
            )
        )

    def payload_acceleration_bias(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return Jdot v, the part of d/dt V_WP that needs no joint acceleration (eq. (3)), shape (6,)."""
        pin.forwardKinematics(self.model, self._data, self._q(q), self._v("v", v), np.zeros(self.nv))
        return pin.getFrameClassicalAcceleration(
            self.model, self._data, self._payload, pin.LOCAL_WORLD_ALIGNED
        ).vector.copy()

    def _frame_pose(self, q: ArrayLike, frame: int) -> Array:
        pin.framesForwardKinematics(self.model, self._data, self._q(q))
        return np.array(self._data.oMf[frame].homogeneous)

    def _q(self, q: ArrayLike) -> Array:
        return as_array("q", q, self.nq)

    def _v(self, name: str, v: ArrayLike) -> Array:
        return as_array(name, v, self.nv)
