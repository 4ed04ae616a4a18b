"""Joint, velocity and effort limits of an arm."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.errors import FieldError
from coop_pin.description.cell.arm import Arm
from coop_pin.model.joint_angles import JointAngles
from coop_pin.model.pinocchio_model import model_key, shared_arm_model

_WHOLE_TURN = 2.0 * math.pi
_ROUND_OFF = 1e-9
_AT_LIMIT = 1e-7
_PERTURBATION = 0.5
PASSIVE = 1e-9
"""Torque limit of a passive joint, N m or N: no torque, and parts of limits are numbers."""


class JointLimits:
    """Joint, velocity and effort limits of an arm, infinite if there is none.

    A velocity of zero in the URDF means "not stated", as in many files: no limit. So do efforts if all are
    zero; beside others an effort of zero is that of a passive joint: its torque is limited to zero. Efforts
    limit the drive torques only if each drive moves one joint; with a drive matrix they set no limit.

    Continuous joints have no position limits. A revolute joint reaches the same pose again after a whole
    turn: if its range is a whole turn or more, every angle can be wrapped into it. Only narrower joints limit
    the workspace.

    Attributes:
        joints: names and units of the joints, and their positions in a configuration.
        lower: smallest joint positions, rad or m, shape (k,).
        upper: largest joint positions, rad or m, shape (k,).
        velocity: largest joint speeds, rad/s or m/s, shape (k,).
        torque: drive torques at which the actuators saturate, N m, shape (k,).
        limited: joints whose position limits restrict the workspace, shape (k,).
    """

    def __init__(self, arm: Arm, name: str = "arm") -> None:
        """Read the limits of an arm from its description and URDF.

        Args:
            arm: the description.
            name: arm name in the cell, for the path in error messages.

        Raises:
            FieldError: the number of torque limits differs from the number of joints.
            UrdfError: the URDF is missing or defective.
        """
        self._model = model = shared_arm_model(model_key(arm))
        self.joints = joints = JointAngles(model)
        self.lower = np.where(joints.continuous, -np.inf, model.lowerPositionLimit[joints.entry])
        self.upper = np.where(joints.continuous, np.inf, model.upperPositionLimit[joints.entry])
        self.velocity = _stated(model.upperVelocityLimit)
        self.torque = _torque_limits(arm, model, name)
        is_wide = joints.revolute & (self.upper - self.lower >= _WHOLE_TURN - _ROUND_OFF)
        self.limited: Mask = ~(joints.continuous | is_wide)
        self._least, self._most = np.full((2, model.nq), ((-np.inf,), (np.inf,)))
        self._least[joints.entry] = np.where(self.limited, self.lower, -np.inf)
        self._most[joints.entry] = np.where(self.limited, self.upper, np.inf)
        self._at_least = self._least[joints.entry] + _AT_LIMIT
        self._at_most = self._most[joints.entry] - _AT_LIMIT

    def violation(self, q: Array) -> Array:
        """Return by how much each joint exceeds its limits (signed; zero within), rad or m, shape (k,)."""
        positions = self.joints.of(q)
        violation = positions - np.clip(positions, self.lower, self.upper)
        return np.where(np.abs(violation) > _ROUND_OFF, violation, 0.0)

    def margin(self, q: Array) -> float:
        """Return the least distance to a position limit over half of the range.

        Args:
            q: configurations, shape (n, nq), or one of them; only joints that limit the workspace count.
        """
        positions = self.joints.of(q)
        gap = np.minimum(positions - self.lower, self.upper - positions)
        with np.errstate(invalid="ignore"):  # of joints without limits
            part = gap / (0.5 * np.minimum(self.upper - self.lower, 2.0 * np.pi))
        return float(np.where(self.limited, part, 1.0).min())

    def clip(self, q: Array) -> Array:
        """Return q with the limited joints clipped to their limits, shape (nq,)."""
        return np.minimum(np.maximum(q, self._least), self._most)

    def at_limit(self, q: Array, direction: Array) -> Mask:
        """Return which limited joints are at a limit that a direction of v would exceed, shape (k,)."""
        entries = q[self.joints.entry]  # of a continuous joint its cosine, within no limits
        at_lower, at_upper = entries <= self._at_least, entries >= self._at_most
        return (at_lower & (direction < 0.0)) | (at_upper & (direction > 0.0))

    def wrap_near(self, q: Array, near: Array) -> Array:
        """Return the same pose with revolute joints wrapped into their limits, near another configuration.

        A joint that cannot be wrapped into its limits gets the angle with the least violation.
        """
        wrapped = q.copy()
        for joint in np.flatnonzero(self.joints.revolute):
            entry = self.joints.entry[joint]
            angle = near[entry] + math.remainder(q[entry] - near[entry], _WHOLE_TURN)
            wrapped[entry] = angle + _WHOLE_TURN * _turns(angle, self.lower[joint], self.upper[joint])
        return wrapped

    def random_configurations(self, count: int) -> list[Array]:
        """Return uniformly distributed configurations within the limits; the seed is fixed."""
        generator = np.random.default_rng(0)
        lower = np.where(self.limited & np.isfinite(self.lower), self.lower, -math.pi)
        upper = np.where(self.limited & np.isfinite(self.upper), self.upper, math.pi)
        upper = np.maximum(lower, upper)
        return [self.joints.configuration(generator.uniform(lower, upper)) for _ in range(count)]

    def perturb(self, q: Array, count: int) -> list[Array]:
        """Return q with normally distributed perturbations, 0.5 rad or m, clipped; the seed is fixed."""
        generator = np.random.default_rng(0)
        scale, size = _PERTURBATION, self._model.nv
        return [
            self.clip(pin.integrate(self._model, q, generator.normal(scale=scale, size=size)))
            for _ in range(count)
        ]


def _stated(limits: Array) -> Array:
    return np.where(limits > 0.0, limits, np.inf)


def _torque_limits(arm: Arm, model: pin.Model, name: str) -> Array:
    unlimited = np.full(model.nv, np.inf)
    if arm.torque_limits == "none":
        return unlimited
    if arm.torque_limits == "urdf":
        one_by_one = np.array_equal(arm.drive_matrix(model.nv), np.eye(model.nv))
        efforts = np.array(model.upperEffortLimit)
        stated = efforts[arm.base_joints :]
        if not (np.isfinite(stated) & (stated > 0.0)).any():
            stated[:] = np.inf
        return np.maximum(efforts, PASSIVE) if one_by_one else unlimited
    return per_joint(np.array(arm.torque_limits, dtype=float), model.nv, f"cell.arms.{name}.torque_limits")


def per_joint(values: Array, joints: int, path: str) -> Array:
    """Return one value for each joint, shape (joints,), from as many values or a single one.

    Raises:
        FieldError: there are more or fewer values than joints.
    """
    if values.ndim and values.shape != (joints,):
        raise FieldError(f"has {len(values)} entries; the arm has {joints} joints", path)
    return np.full(joints, values) if values.ndim == 0 else values


def _turns(angle: float, lower: float, upper: float) -> int:
    """Return the fewest whole turns that bring an angle within limits, or nearest to them."""
    if lower - _ROUND_OFF <= angle <= upper + _ROUND_OFF:
        return 0
    up = math.ceil((lower - angle - _ROUND_OFF) / _WHOLE_TURN)
    down = math.floor((upper - angle + _ROUND_OFF) / _WHOLE_TURN)
    if up <= down:
        return min(max(0, up), down)
    return up if (angle + up * _WHOLE_TURN) - upper < lower - (angle + down * _WHOLE_TURN) else down


def limit_table(limits: Sequence[JointLimits], joints: int) -> Array:
    """Return lower, upper, velocity and torque limits of arms, shape (4, m, k); NaN where there is none."""
    table = np.full((4, len(limits), joints), np.nan)
    for index, of_arm in enumerate(limits):
        columns = (of_arm.lower, of_arm.upper, of_arm.velocity, of_arm.torque)
        for row, values in zip(table, columns, strict=True):
            row[index, : len(values)] = np.where(np.isfinite(values), values, np.nan)
    return table
