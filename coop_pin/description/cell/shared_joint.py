"""Shared joint: lift, torso turn or pedestal under several arms of one robot, with a drive of its own."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, field_validator

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError, suggestion
from coop_pin.base.schema.base import Description, NotNegative, Positive
from coop_pin.base.spatial import exp3, inverse_pose, log3, rotate_vector6
from coop_pin.description.cell.arm import Arm
from coop_pin.reference.pose_reference import PoseTarget
from coop_pin.reference.quintic import quintic

_TILTED = 1e-9
"""Part of an axis across gravity from which on a turn about it tilts the arms."""


class Stroke(Description):
    """Stated motion of a shared joint: from where it starts to a distance away, by the quintic.

    Attributes:
        distance: way from the start, m or rad.
        duration: time from rest to rest, s.
        start_time: s.
    """

    distance: float
    duration: Positive
    start_time: NotNegative = 0.0


def _stroke_or_name(value: object) -> object:
    if isinstance(value, str) and value not in ("hold", "payload"):
        raise FieldError(f"is {value!r}; it must be 'hold', 'payload', or a table of distance and duration")
    return value


class SharedJoint(Description):
    """Drive and servo of a joint that moves several arms of one robot: a lift, torso turn or pedestal.

    Sampled at the control ticks, with the position q and velocity v of the joint and its reference r::

        tau = clip(tau_0 - I (w^2 (q - r) + 2 zeta w (v - r')), -limit, limit)

    tau_0 holds robot and payload at rest at the start, and I is the inertia that the joint moves there. The
    reference begins at the angle at which the arms lock the joint; following the payload it goes the way of
    the desired payload along a lift's axis, or turns as the payload does about a turn's.

    Attributes:
        follow: reference: "hold" the start, follow the desired "payload", or a stated stroke.
        drive: kind of the drive: "own", a servo of the joint.
        bandwidth: w, rad/s.
        damping_ratio: zeta.
        limit: largest force or torque, N or N m: a number, "none", or "urdf", the effort of the joint.
    """

    follow: Annotated[Literal["hold", "payload"] | Stroke, BeforeValidator(_stroke_or_name)] = "hold"
    drive: Literal["own"] = "own"
    bandwidth: Positive = 50.0
    damping_ratio: Positive = 0.8
    limit: Literal["urdf", "none"] | Positive = "urdf"

    @field_validator("drive", mode="before")
    @classmethod
    def _one_drive(cls, drive: object) -> object:
        if drive != "own":
            raise FieldError(
                f"is {drive!r}; it must be 'own'. Arms that drive it together, tau = sum_i J_s,i^T F_i, must"
                " split its holding force inside their integrals: otherwise they press the payload with 70 to"
                " 200 N, which an arm without a wrist sensor does not measure. Give the joint a servo: 'own'"
            )
        return drive

    def reference(self, time: float, start: float, axis: Array, way: PoseTarget, begin: Array) -> Array:
        """Return r and its rate, m or rad, shape (2,).

        Args:
            time: s.
            start: position at the start, m or rad.
            axis: screw of the joint in world axes, linear first, shape (6,).
            way: desired motion of the payload.
            begin: desired pose of the payload at the start, shape (4, 4).
        """
        if self.follow == "hold":
            return np.array((start, 0.0))
        if isinstance(self.follow, Stroke):
            s = quintic(time, self.follow.start_time, self.follow.duration)
            return np.array((start + self.follow.distance * s.value, self.follow.distance * s.rate))
        turns = bool(axis[3:].any())
        gone = log3(way.X_WP_d[:3, :3] @ begin[:3, :3].T) if turns else way.X_WP_d[:3, 3] - begin[:3, 3]
        e, rate = (axis[3:], way.V_WP_d[3:]) if turns else (axis[:3], way.V_WP_d[:3])
        return np.array((start + e @ gone, e @ rate))


class SharedJoints(NamedTuple):
    """Shared joints of a robot, from its root on, or those of the rolling base of an arm.

    Attributes:
        joints: names of the joints in its URDF; ``<arm>.base_x``, ``base_y`` and ``base_yaw`` of a base.
        arms: names of the arms that they carry.
        start: angles at which these lock them, m or rad, shape (n,).
        screws: axis of each at the start about the world's origin in world axes, linear first, shape (n, 6).
    """

    joints: tuple[str, ...]
    arms: tuple[str, ...]
    start: Array
    screws: Array

    @classmethod
    def of(cls, joints: Mapping[str, SharedJoint], arms: Mapping[str, Arm]) -> SharedJoints | None:
        """Return the carrier of the arms of a cell; None without shared joints."""
        names = tuple(name for name, arm in arms.items() if {*joints} & {*arm.robot.movers(arm.tip)})
        if not names:
            return None
        first = arms[names[0]]
        locked = first.robot.locked(first.locked)
        order = tuple(joint for joint in first.robot.movers(first.tip) if joint in joints)
        screws = np.array([_screw(first, joint, locked) for joint in order])
        return cls(order, names, np.array([locked[joint] for joint in order]), screws)

    @classmethod
    def of_wheels(cls, name: str, arm: Arm) -> SharedJoints:
        """Return the carrier of an arm whose base rolls: x and y along axes of B, and yaw about the axle."""
        R, p = arm.base.matrix[:3, :3], arm.base.matrix[:3, 3]
        screws = np.zeros((3, 6))
        screws[:2, :3] = R.T[:2]
        screws[2] = np.concatenate((np.cross(p, R[:, 2]), R[:, 2]))
        return cls(tuple(f"{name}.base_{axis}" for axis in ("x", "y", "yaw")), (name,), np.zeros(3), screws)

    def displacement(self, angles: Array) -> Array:
        """Return D with which the joints move what they carry from its pose at the start, shape (4, 4).

        D = prod_k exp(S_k dq_k), from the root on.

        Args:
            angles: positions of the joints, m or rad, shape (n,).
        """
        return self.moved(angles, np.zeros(len(angles)))[0]

    def moved(self, angles: Array, rates: Array) -> tuple[Array, Array]:
        """Return D, and the twist of what the joints carry about the world's origin, shape (6,).

        V = sum_k Ad(prod_(j<k) exp(S_j dq_j)) S_k v_k.

        Args:
            angles: positions of the joints, m or rad, shape (n,).
            rates: their rates, m/s or rad/s, shape (n,).
        """
        D, V = np.eye(4), np.zeros(6)
        for S, dq, v in zip(self.screws, angles - self.start, rates, strict=True):
            turned = rotate_vector6(D[:3, :3], S)
            V += v * np.concatenate((turned[:3] + np.cross(D[:3, 3], turned[3:]), turned[3:]))
            step, e = np.eye(4), S[3:]
            step[:3, :3] = exp3(dq * e)
            step[:3, 3] = (np.eye(3) - step[:3, :3]) @ np.cross(e, S[:3]) if e.any() else dq * S[:3]
            D = D @ step
        return D, V


def about(p: Array, twist: Array) -> Array:
    """Return twists about a point, of those about the world's origin, shape (..., 6)."""
    linear, angular = twist[..., :3], twist[..., 3:]
    return np.concatenate((linear + np.cross(angular, p), angular), axis=-1)


def _screw(arm: Arm, joint: str, locked: Mapping[str, float]) -> Array:
    """Return the axis of a locked joint about the world's origin in world axes, linear first, shape (6,)."""
    X_WJ, X = (
        arm.base.matrix @ arm.robot.pose(joint, {**locked, joint: locked[joint] + step})
        for step in (0.0, 1.0)
    )
    moved = X @ inverse_pose(X_WJ)  # by one unit: exp of the screw
    e = log3(moved[:3, :3])
    return np.concatenate((np.cross(X_WJ[:3, 3], e) if e.any() else moved[:3, 3], e))


def shared_problems(
    joints: Mapping[str, SharedJoint], arms: Mapping[str, Arm], gravity: Array, is_planar: bool
) -> Iterator[FieldError]:
    """Yield what is wrong with the shared joints of a cell, the first mistake of each.

    Args:
        joints: Shared joints by name.
        arms: Arms of the cell.
        gravity: Gravity, m/s^2, shape (3,).
        is_planar: Whether the task rows are those of a plane.
    """
    moved = {joint: [n for n, arm in arms.items() if joint in arm.robot.movers(arm.tip)] for joint in joints}
    for joint, names in moved.items():
        if len(names) < 2:
            known = [each for arm in arms.values() for each in arm.robot.movers(arm.tip)]
            reason = f"moves {len(names)} arms of the cell; a shared joint moves several of one robot"
            yield FieldError(f"{reason}; {suggestion(joint, [*dict.fromkeys(known)])}", joint)
        elif strange := [n for n in names[1:] if not arms[names[0]].is_sibling(arms[n])]:
            yield FieldError(f"moves {names[0]!r} and {strange[0]!r}, which are arms of two robots", joint)
        elif names != (all_names := next(iter(moved.values()))):
            yield FieldError(f"moves {names}, and another one {all_names}; joints carry the same arms", joint)
        elif arms[names[0]].mobile_base is not None:
            yield FieldError(f"carries {names[0]!r}, whose mobile base is driven by that arm alone", joint)
        elif free := [n for n in names if joint not in arms[n].locked]:
            where = f"cell.arms.{free[0]}.locked.{joint}"
            yield FieldError(f"starts where its arms lock it: set {where}, the same in each", joint)
        else:
            yield from _axis_problems(arms[names[0]], joint, gravity, is_planar)
            yield from _angle_problems(joint, {name: arms[name] for name in names})


def wheel_problems(
    arms: Mapping[str, Arm], shared: Collection[str], gravity: Array, is_planar: bool
) -> Iterator[FieldError]:
    """Yield what is wrong with the rolling bases of a cell, the first mistake of each.

    Args:
        arms: Arms of the cell.
        shared: Names of its shared joints.
        gravity: Gravity, m/s^2, shape (3,).
        is_planar: Whether the task rows are those of a plane.
    """
    for name, arm in arms.items():
        if arm.wheels is None:
            continue
        up = arm.base.matrix[:3, 2]
        siblings = [other for other in arms if arm.is_sibling(arms[other])]
        is_tilted = np.linalg.norm(np.cross(up, gravity)) > _TILTED * max(1.0, float(np.linalg.norm(gravity)))
        if siblings:
            detail = f"carries {siblings}, too, which are arms of the same robot; it carries one arm: park it"
            yield FieldError(f"{detail}, follow = 'parked'", f"{name}.mobile_base")
        elif shared:
            detail = f"rolls beside the shared joints {[*shared]}; a cell has one or the other: park it"
            yield FieldError(f"{detail}, follow = 'parked'", f"{name}.mobile_base")
        elif is_tilted or up @ gravity > 0.0 or (is_planar and abs(up[2]) < 1.0 - _TILTED):
            yield FieldError("stands on wheels, and its z axis is not upright", f"{name}.base")


def _axis_problems(arm: Arm, joint: str, gravity: Array, is_planar: bool) -> Iterator[FieldError]:
    """Yield an axis that tilts the arms against gravity, or leaves the plane of the cell."""
    screw = _screw(arm, joint, arm.robot.locked(arm.locked))
    across = np.cross(screw[3:], gravity)
    if np.linalg.norm(across) > _TILTED * max(1.0, float(np.linalg.norm(gravity))):
        detail = "turns about an axis that is not along gravity: robots compensate an upright weight only"
        yield FieldError(f"{detail}; lock it and leave it out, or set cell.gravity", joint)
    if is_planar and max(abs(screw[2]), *np.abs(screw[3:5])) > _TILTED:
        yield FieldError("leaves the plane of the cell's rows; choose rows = 'full'", joint)


def _angle_problems(joint: str, arms: Mapping[str, Arm]) -> Iterator[FieldError]:
    """Yield joints of the robot that its arms lock at different angles."""
    (first, arm), *others = arms.items()
    for name, other in others:
        for each in {*arm.locked} & {*other.locked}:
            if arm.locked[each] != other.locked[each]:
                detail = f"carries {each!r}, which {first!r} locks at {arm.locked[each]:g} and {name!r} at"
                yield FieldError(f"{detail} {other.locked[each]:g}; it is one joint", joint)
                return


def require_own_joints(name: str, arm: Arm, other: str, sibling: Arm) -> None:
    """Raise an error if a joint moves two arms of one robot, or is locked at two angles.

    Raises:
        FieldError: with the joint, and what to lock.
    """
    robot = arm.robot
    shared = [joint for joint in robot.movers(arm.tip) if joint in robot.movers(sibling.tip)]
    angles = robot.locked(arm.locked), robot.locked(sibling.locked)
    moving = [joint for joint in shared if not all(joint in locked for locked in angles)]
    if moving:
        raise FieldError(
            f"moves {name!r} and {other!r}, arms of one robot: arms of a cell are chains of their own"
            " and share no joint; lock it in both, at the same angle, and drive it by cell.shared_joints",
            f"{other}.locked.{moving[0]}",
        )
    for joint in shared:
        first, second = (locked[joint] for locked in angles)
        if first != second:
            raise FieldError(
                f"is {second:g}, but arm {name!r} of the same robot has {first:g}; it is one joint",
                f"{other}.locked.{joint}",
            )
