"""What an arm's URDF allows its joints, and its drives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.arrays import Array, Mask
from coop_pin.description.arm import Arm
from coop_pin.errors import FieldError
from coop_pin.model.arm_model import load_arm_model
from coop_pin.model.joint_angles import JointAngles


class JointLimits(NamedTuple):
    """Limits of an arm, infinite where there are none.

    Attributes:
        lower: joint angles, rad or m, shape (k,).
        upper: likewise.
        velocity: joint rates, rad/s or m/s, shape (k,).
        torque: drive torques at which the actuation saturates, N m, shape (k,).
    """

    lower: Array
    upper: Array
    velocity: Array
    torque: Array


def joint_limits(arm: Arm, name: str = "arm") -> JointLimits:
    """Return the limits of an arm.

    A velocity or effort of zero is taken for "not stated", as many files mean it: no limit. Efforts of the
    URDF are drive torques only where the drives turn the joints one by one; with a drive matrix they set no
    limit.

    Args:
        arm: the description.
        name: the arm, for messages.

    Raises:
        FieldError: the torque limits do not fit the arm.
    """
    model = load_arm_model(arm)
    angles = JointAngles(model)
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    bounded = ~angles.continuous
    entries = angles.entry[bounded]
    lower[bounded], upper[bounded] = model.lowerPositionLimit[entries], model.upperPositionLimit[entries]
    return JointLimits(lower, upper, _stated(model.upperVelocityLimit), _torque_limits(arm, model, name))


def _stated(limits: Array) -> Array:
    return np.where(limits > 0.0, limits, np.inf)


def _torque_limits(arm: Arm, model: pin.Model, name: str) -> Array:
    nothing = np.full(model.nv, np.inf)
    if arm.torque_limits == "none":
        return nothing
    if arm.torque_limits == "urdf":
        one_by_one = np.array_equal(arm.drive_matrix(model.nv), np.eye(model.nv))
        return _stated(model.upperEffortLimit) if one_by_one else nothing
    return per_joint(np.array(arm.torque_limits, dtype=float), model.nv, f"cell.arms.{name}.torque_limits")


def per_joint(values: Array, joints: int, path: str) -> Array:
    """Return one value for each joint; a single one stands for all.

    Raises:
        FieldError: there are more or fewer values than joints.
    """
    if values.ndim and values.shape != (joints,):
        raise FieldError(f"has {len(values)} entries; the arm has {joints} joints", path)
    return np.full(joints, values) if values.ndim == 0 else values


_WHOLE_TURN = 2.0 * math.pi
_ROUND_OFF = 1e-9
_AT_LIMIT = 1e-7
_SCATTER = 0.5


class JointRanges:
    """The position limits of an arm's joints.

    Continuous joints have none. A revolute joint stands the same after a whole turn: when its range is a
    whole turn or more, every pose can be unwound into it, and only narrower joints can stop an arm.

    Attributes:
        names: the joints.
        units: "rad" or "m" for each.
        lower: rad or m, shape (nv,); minus infinity without a limit.
        upper: likewise.
        narrow: joints whose limits can stop the arm, shape (nv,).
    """

    def __init__(self, model: pin.Model) -> None:
        joints = JointAngles(model)
        self._model, self._joints = model, joints
        self.names = tuple(name.removeprefix("arm/") for name in joints.names)
        self.units = tuple(np.where(joints.revolute | joints.continuous, "rad", "m").tolist())
        self.lower = np.where(joints.continuous, -np.inf, model.lowerPositionLimit[joints.entry])
        self.upper = np.where(joints.continuous, np.inf, model.upperPositionLimit[joints.entry])
        is_wide = joints.revolute & (self.upper - self.lower >= _WHOLE_TURN - _ROUND_OFF)
        self.narrow: Mask = ~(joints.continuous | is_wide)
        self._narrow_entries = joints.entry[self.narrow]

    def values(self, q: Array) -> Array:
        """Return the angle or length of every joint, rad or m, shape (nv,)."""
        return self._joints.of(q)

    def beyond(self, q: Array) -> Array:
        """Return how far every joint stands beyond its limits, signed, rad or m, shape (nv,); zero within."""
        values = self.values(q)
        beyond = values - np.clip(values, self.lower, self.upper)
        return np.where(np.abs(beyond) > _ROUND_OFF, beyond, 0.0)

    def hold(self, q: Array) -> Array:
        """Return q with the narrow joints brought to their nearest limit where they stand beyond it, shape (nq,)."""
        held = q.copy()
        held[self._narrow_entries] = np.clip(
            q[self._narrow_entries], self.lower[self.narrow], self.upper[self.narrow]
        )
        return held

    def stopped(self, q: Array, direction: Array) -> Mask:
        """Return which narrow joints stand at a limit that a direction of v leads beyond, shape (nv,)."""
        values = self.values(q)
        at_lower, at_upper = values <= self.lower + _AT_LIMIT, values >= self.upper - _AT_LIMIT
        return self.narrow & ((at_lower & (direction < 0.0)) | (at_upper & (direction > 0.0)))

    def unwound(self, q: Array, near: Array) -> Array:
        """Return the same pose with every revolute joint within its limits, and as near to another configuration as they allow.

        A joint that cannot stand within its limits is left where it is least beyond them.
        """
        unwound = q.copy()
        for joint in np.flatnonzero(self._joints.revolute):
            entry = self._joints.entry[joint]
            angle = near[entry] + math.remainder(q[entry] - near[entry], _WHOLE_TURN)
            unwound[entry] = angle + _WHOLE_TURN * _turns(angle, self.lower[joint], self.upper[joint])
        return unwound

    def spread(self, count: int) -> list[Array]:
        """Return configurations spread over the ranges, the same at every call."""
        generator = np.random.default_rng(0)
        lower = np.where(self.narrow & np.isfinite(self.lower), self.lower, -math.pi)
        upper = np.where(self.narrow & np.isfinite(self.upper), self.upper, math.pi)
        upper = np.maximum(lower, upper)
        return [self._joints.configuration(generator.uniform(lower, upper)) for _ in range(count)]

    def around(self, q: Array, count: int) -> list[Array]:
        """Return configurations scattered around one, half a radian in each joint, the same at every call."""
        generator = np.random.default_rng(0)
        return [
            self.hold(pin.integrate(self._model, q, generator.normal(scale=_SCATTER, size=self._model.nv)))
            for _ in range(count)
        ]


def _turns(angle: float, lower: float, upper: float) -> int:
    """Return the fewest whole turns that bring an angle within limits, or nearest to them."""
    if lower - _ROUND_OFF <= angle <= upper + _ROUND_OFF:
        return 0
    up, down = (
        math.ceil((lower - angle - _ROUND_OFF) / _WHOLE_TURN),
        math.floor((upper - angle + _ROUND_OFF) / _WHOLE_TURN),
    )
    if up <= down:
        return min(max(0, up), down)
    return up if (angle + up * _WHOLE_TURN) - upper < lower - (angle + down * _WHOLE_TURN) else down
