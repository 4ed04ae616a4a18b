"""Leader-follower control: one arm tracks, the others yield to their own wrist wrench."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import Interval, NotNegative, Positive
from coop_pin.base.spatial.generic_numbers import exp
from coop_pin.control.bounds import CellTiming, SampledLoop
from coop_pin.control.controller import ArmCommand, ArmController
from coop_pin.control.gains import Gains, OptionalRow, PositiveRow
from coop_pin.control.law import DecentralisedLaw, LawController
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.steady_state import NearRest
from coop_pin.control.terms import spare_torque, with_payload_weight


class LeaderFollowerState(NamedTuple):
    """Memory of the law.

    Attributes:
        integral: z, N and N m, shape (k_0,).
        velocity: V_c, to which a follower yields, m/s and rad/s, shape (k_0,).
        start: drive angles at t_0, to which spare joints return, rad, shape (k,).
    """

    integral: Array
    velocity: Array
    start: Array


class LeaderFollowerGains(Gains):
    """Gains of leader-follower control; one number for all task rows, or one for each.

    Attributes:
        pose_gain: gamma, 1/s.
        sliding_gain: K, N s/m and N m s/rad.
        integral_rate: k_I, 1/s.
        follower_damping: B, N s/m and N m s/rad.
        follower_stiffness: B_p, N/m and N m/rad.
        admittance_damping: D, N s/m and N m s/rad.
        admittance_rate: l, 1/s.
        payload_weight: Weight What on the task rows, the payload's weight m g as a wrench on an arm, world
            axes, N and N m: with gravity along -z, -9.81 N per kg on the row z. That of the scenario's
            payload and gravity when omitted.
        spare_gains: Stiffness, N m/rad, and damping, N m s/rad, of spare joints.
    """

    on_rows: ClassVar[tuple[str, ...]] = (
        "pose_gain",
        "sliding_gain",
        "follower_damping",
        "follower_stiffness",
        "admittance_damping",
        "payload_weight",
    )

    pose_gain: PositiveRow = 2.0
    sliding_gain: PositiveRow = 400.0
    integral_rate: NotNegative = 5.0
    follower_damping: PositiveRow = 100.0
    follower_stiffness: PositiveRow = 500.0
    admittance_damping: PositiveRow = 50.0
    admittance_rate: Positive = 50.0
    payload_weight: OptionalRow = None
    spare_gains: Interval = (40.0, 8.0)


@dataclass(frozen=True, eq=False)
class LeaderFollowerController(LawController[LeaderFollowerGains]):
    """Leader with a PI law on the payload, followers with an impedance; the first arm of the cell leads.

    Luh and Zheng (1987), "Constrained relations between two coordinated industrial robots for motion
    control"; followers by their own wrist wrench as in Kosuge and Oosumi (1996), "Decentralized control of
    multiple robots handling an object". Wrenches and twists are about P in world axes, on task rows, F is the
    arm's own wrench and What an approximate weight of the payload::

        F_d      = f_d + c What
        leader   s = xtildedot + gamma xtilde,   tau = -J^T [F_d + K s + z],   z <- z + T k_I K s
        follower V_c <- p V_c + (1 - p) D^-1 (F - F_d),   p = exp(-l T)
                 tau = -J^T [F_d + B (V - V_c) + z],   z <- z + T B_p (V - V_c)

    A follower does not know the motion: it moves with the payload and yields until its wrench is F_d. At rest
    V_c = 0, so that F = F_d whatever its kinematics are off by. Its force loop has the gain B / D over a
    filter of pole p and is stable below ``force_gain_bound(p)``; T B_p / D is its anchor gain.
    """

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> LeaderFollowerState:
        """Return the state at t_0: z = 0, V_c = 0."""
        nothing = np.zeros(self.arm.rows.size)
        return LeaderFollowerState(nothing, nothing, measurement.q)

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: LeaderFollowerState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian of a redundant arm loses rank.
        """
        arm, gains, z, V_c = self.arm, self.gains, state.integral, state.velocity
        rows, T, load = arm.rows, arm.period, arm.load_share * gains.payload_weight
        F_d = rows.turn(measurement.payload_pose, reference.internal_wrench) + load
        if arm.leads:
            xtilde = rows.pose_error(measurement.payload_pose, reference.pose)
            s = measurement.payload_twist - reference.twist + gains.pose_gain * xtilde
            push = gains.sliding_gain * s
            rate = gains.integral_rate * push
        else:
            F, p = measurement.interaction_wrench, exp(-gains.admittance_rate * T)
            if F is not None:
                V_c = p * V_c + (1.0 - p) * (F - F_d) / gains.admittance_damping
            slip = measurement.payload_twist - V_c
            push, rate = gains.follower_damping * slip, gains.follower_stiffness * slip
        tau = spare_torque(measurement, state.start, gains.spare_gains)
        tau = tau - measurement.payload_jacobian.T.dot(F_d + push + z)
        held = 1.0 - measurement.saturated.any()
        return ArmCommand(tau, LeaderFollowerState(z + held * T * rate, V_c, state.start))


class LeaderFollower(DecentralisedLaw[LeaderFollowerGains]):
    """Leader-follower control, the first arm leads: LeaderFollowerController."""

    uses: ClassVar[tuple[str, ...]] = ("own wrench", "role")

    spare_spring: ClassVar[str] = "controller.gains.spare_gains"

    kind: Literal["leader-follower"] = "leader-follower"
    gains: LeaderFollowerGains = LeaderFollowerGains()

    @property
    def near_rest(self) -> NearRest:
        """Model near rest: leader and followers integrate linearly."""
        return super().near_rest._replace(integral="linear")

    def controller_of(self, arm: ControlledArm, gains: LeaderFollowerGains, scenario: Any) -> ArmController:
        """Return the law of one arm."""
        return LeaderFollowerController(arm, with_payload_weight(gains, arm, scenario))

    def loop(self, cell: CellTiming) -> SampledLoop:
        """Return a follower's force loop in the task row with the largest B / D."""
        gains = self.gains.sized(cell.rows, 0)
        B, B_p = gains.follower_damping, gains.follower_stiffness
        D, p = gains.admittance_damping, float(np.exp(-gains.admittance_rate * cell.period))
        row = int(np.argmax(B / D))
        loop = super().loop(cell)._replace(pole=p)
        return loop._replace(force_gain=float((B / D)[row]), anchor_gain=cell.period * float((B_p / D)[row]))

    def feedback_problems(self, cell: CellTiming) -> list[FieldError]:
        """Return the problem of an admittance with which a follower's force loop is unstable."""
        if not cell.wrists or (loop := self.loop(cell)).is_stable():
            return []
        detail = (
            f"is {self.gains.admittance_damping}, but with B / D = {loop.force_gain:g}, T B_p / D ="
            f" {loop.anchor_gain:g} and a delay of {loop.delay} a follower's force loop is unstable; raise it"
        )
        return [FieldError(detail, "gains.admittance_damping")]
