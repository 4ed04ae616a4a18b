"""Measurement and reference of one arm at a tick, and the numbers of arm and cell that a law may know."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from coop_pin.base.arrays import Array, Mask
from coop_pin.base.spatial.grasp_rows import GraspRows
from coop_pin.base.spatial.task_rows import TaskRows


class Message(NamedTuple):
    """Latest message that an arm has received from a neighbour.

    Attributes:
        numbers: numbers of the message, rounded as they were sent, shape (w,); zero before the first.
        age: ticks since it was sent; inf before the first.
    """

    numbers: Array
    age: float


Messages: TypeAlias = Mapping[str, Message]
"""Messages by sender."""


class SentIf(NamedTuple):
    """Message of a law that may have nothing to say, without a branch on values: batches have it, too.

    Attributes:
        numbers: numbers of the message, shape (w,).
        condition: whether it is sent.
    """

    numbers: Array
    condition: Any


class Sent(NamedTuple):
    """Messages that an arm has sent since the start, one for each arm that hears it.

    Attributes:
        messages: their number.
        bytes: bytes of their numbers, as doubles.
    """

    messages: float
    bytes: float


Outgoing: TypeAlias = Array | SentIf | None
"""What an arm says at a tick: numbers, numbers on a condition, or None for nothing."""


class ArmMeasurement(NamedTuple):
    """Measurement of one arm at one tick, in drive coordinates and task rows; the arrays are read-only.

    The arm has k drives, the cell k_0 task rows.

    Attributes:
        time: t_k, s.
        q: drive coordinates T @ joint angles, rad, shape (k,).
        v: drive velocities T @ joint velocities, rad/s, shape (k,).
        payload_pose: X_WP by this arm's own forward kinematics, shape (4, 4).
        payload_twist: V_WP likewise, in world axes, shape (k_0,).
        payload_jacobian: J_phi with V_WP = J_phi v, plus ``carried_twist``, shape (k_0, k).
        internal_wrench: measured internal wrench on this arm about P in world axes, shape (k_0,); None
            when the scenario's force path provides none.
        saturated: mask of the drive torques that were cut at their limits over the last tick, shape (k,); all
            false at the first. Of a servo, at the beginning of that tick.
        internal_wrench_age: ticks since ``internal_wrench`` was sampled; inf before the first sample.
        interaction_wrench: this arm's own wrist wrench F_i, on the arm by the payload, about P in world axes
            as its own kinematics see them, shape (k_0,); None without a wrist sensor.
        interaction_wrench_age: ticks since it was sampled; inf before the first sample.
        holding_torque: torque that each drive reports at rest before the controller takes over, N m, shape
            (k,), without the robot's own gravity compensation: as commands they hold the cell; in the first
            measurement only.
        reported_torque: the part of the law's last command that acted, N m, shape (k,), as drives report it:
            the command itself where nothing cut it, without the robot's own gravity compensation and before
            lag. A lost drive reports 0; a missed tick is no cut. Zero in the first measurement; None where
            drives report nothing.
        slip: largest distance that a patch of an arm that holds has slid since then, m; None at the first
            tick and without patches.
        messages: latest message of each arm that this one hears, by name in the order of the cell's arms, its
            own among them as it was sent; None where the scenario has no network, or the law sends nothing.
        sent: messages that this arm has sent since the start, those of this tick among them; None before
            they are counted.
        shared_position: positions of the shared joints under the arm as it is told, m or rad, shape (n,);
            None without any. Pose, twist and Jacobian are those with the joints there.
        shared_velocity: their rates likewise, m/s or rad/s, shape (n,).
        carried_twist: J_s v_s, the part of ``payload_twist`` that these rates make, shape (k_0,).
    """

    time: float
    q: Array
    v: Array
    payload_pose: Array
    payload_twist: Array
    payload_jacobian: Array
    internal_wrench: Array | None
    saturated: Mask
    internal_wrench_age: float = np.inf
    interaction_wrench: Array | None = None
    interaction_wrench_age: float = np.inf
    holding_torque: Array | None = None
    reported_torque: Array | None = None
    slip: float | None = None
    messages: Mapping[str, Message] | None = None
    sent: Sent | None = None
    shared_position: Array | None = None
    shared_velocity: Array | None = None
    carried_twist: Array | None = None

    def by_arm(self, twist: Array) -> Array:
        """Return V - J_s v_s: what the arm's own joints give of a twist of P, shape (k_0,)."""
        return twist if self.carried_twist is None else twist - self.carried_twist


class ArmReference(NamedTuple):
    """Desired motion and internal wrench of one arm at one tick; the arrays are read-only.

    Attributes:
        pose: X_WP_d, shape (4, 4).
        twist: V_WP_d in world axes, task rows, shape (k_0,).
        acceleration: A_WP_d in world axes, task rows, shape (k_0,).
        internal_wrench: f_d of this arm about P in *payload* axes, task rows, N and N m, shape (k_0,).
        load_share: c_i of the agreed plan where grasps open and close; None where it stays that of the arm.
    """

    pose: Array
    twist: Array
    acceleration: Array
    internal_wrench: Array
    load_share: float | None = None

    def share(self, arm: ControlledArm) -> float:
        """Return c_i of an arm: that of the plan, or else the arm's own."""
        return arm.load_share if self.load_share is None else self.load_share


class ControlledArm(NamedTuple):
    """Numbers of its arm and cell that a law may know in addition to measurements.

    Attributes:
        name: Name of the arm.
        leads: Whether it is the first of the cell's arms.
        rows: The k_0 task rows.
        period: T, s.
        load_share: c.
        drives: Number k of drives.
        posture: Drive angles to which spare joints return, rad, shape (k,): measured angles of continuous
            joints start within half a turn of it, and count turns from there.
        gravity: Gravity, m/s^2, shape (3,).
        start_pose: X_WP at t_0, shape (4, 4).
        oldest_wrench: Age that measured wrenches reach without being lost, ticks.
        base_drives: Number of its first drives that move a mobile base.
        way_out: Normal of the face on which it holds the payload by friction, out of it in payload axes,
            shape (3,). None with another grasp.
        grasp: Rows of its grasp, where that is a joint.
        pressed: Whether it starts with the squeeze on: with a patch, or at an end of a rope that arms pull.
    """

    name: str
    leads: bool
    rows: TaskRows
    period: float
    load_share: float
    drives: int
    posture: Array
    gravity: Array
    start_pose: Array
    oldest_wrench: int
    base_drives: int = 0
    way_out: Array | None = None
    grasp: GraspRows | None = None
    pressed: bool = False


MEASURED = {
    "time": "t_k, s",
    "q": "drive coordinates, rad",
    "v": "drive velocities, rad/s",
    "saturated": "1.0 where the torque was cut at its limit over the last tick, else 0.0",
    "internal_wrench": "internal wrench on this arm about P in world axes, task rows, N and N m",
    "internal_wrench_age": "ticks since it was sampled; INFINITY before the first sample",
    "interaction_wrench": "wrench on this arm by the payload about P in world axes, task rows, N and N m",
    "interaction_wrench_age": "ticks since it was sampled; INFINITY before the first sample",
    "holding_torque": "torques that hold the arm at rest, N m; read at the start only",
    "reported_torque": "part of the last command that acted, N m: the command where nothing cut it",
}
DESIRED = {
    "pose": "desired pose of P in the world, row by row",
    "twist": "desired twist of P in world axes, task rows, m/s and rad/s",
    "acceleration": "desired acceleration of P in world axes, task rows",
    "internal_wrench": "desired internal wrench on this arm about P in payload axes, task rows",
}
"""Fields that exported laws are given, and their meaning; pose, twist and Jacobian follow from q and v."""
