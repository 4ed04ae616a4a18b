"""Admittance control: velocities or positions are commanded, and yield to a measured wrench."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import FieldError
from coop_pin.base.schema.base import NotNegative, Positive
from coop_pin.base.spatial.generic_numbers import exp
from coop_pin.control.bounds import CellTiming
from coop_pin.control.controller import ArmCommand, ArmController, CellController
from coop_pin.control.gains import Gains, OptionalRow, PositiveRow, RowGain
from coop_pin.control.law import DecentralisedLaw, LawController
from coop_pin.control.law_wrapper import CellLawWrapper, Parts, packed, unpacked
from coop_pin.control.measurement import ArmMeasurement, ArmReference, ControlledArm, Messages, Outgoing
from coop_pin.control.terms import right_inverse, with_payload_weight


class AdmittanceState(NamedTuple):
    """Memory of the law.

    Attributes:
        offset: d, m and rad in world axes, shape (k_0,).
        velocity: V_a, m/s and rad/s, shape (k_0,).
        start: drive positions at t_0, to which spare joints return, rad, shape (k,).
        command: q_c, rad, shape (k,).
    """

    offset: Array
    velocity: Array
    start: Array
    command: Array


class AdmittanceGains(Gains):
    """Gains of admittance control; one number for all task rows, or one for each.

    Attributes:
        pose_gain: gamma of commanded velocities, 1/s.
        admittance_damping: D, N s/m and N m s/rad.
        admittance_stiffness: S, N/m and N m/rad; 0 to yield until the wrench is the desired one.
        admittance_rate: l, 1/s.
        payload_weight: Weight What on the task rows where an arm measures its own wrench alone, the payload's
            weight m g as a wrench on an arm, world axes, N and N m: with gravity along -z, -9.81 N per kg on
            the row z. That of the scenario's payload and gravity when omitted.
        spare_rate: k_n by which spare joints return to their start, 1/s.
    """

    on_rows: ClassVar[tuple[str, ...]] = (
        "pose_gain",
        "admittance_damping",
        "admittance_stiffness",
        "payload_weight",
    )

    pose_gain: PositiveRow = 2.0
    admittance_damping: PositiveRow = 5000.0
    admittance_stiffness: RowGain = 0.0
    admittance_rate: Positive = 50.0
    payload_weight: OptionalRow = None
    spare_rate: NotNegative = 1.0


@dataclass(frozen=True, eq=False)
class AdmittanceController(LawController[AdmittanceGains]):
    """Commanded motion of an arm that yields to a wrench, by velocities or positions of its drives.

    Hogan (1985), "Impedance control"; on commanded joint velocities of arms that hold one object, as in Liu
    et al. (2024), arXiv:2406.05613 (same information, other equations). About P in world axes on task rows,
    with the error w of the wrench on the arm, x the pose and x_d, V_d, A_d the desired motion::

        w     = f_m - f_d, the internal wrench; or of the messages sum_j (c_j u_i - c_i u_j), u = F - f_d;
                or F - f_d - c What, the arm's own; or 0 where none is measured
        V_a  <- p V_a + (1 - p) D^-1 (w - S d),   d <- d + T V_a,   p = exp(-l T)
        velocity   V_c = V_d + V_a - gamma (x - x_d - d),   qdot_c = J^+ V_c + k_n N (q_0 - q)
        position   q_c <- q_c + J^+ [x_d(t + T) + d - x - J (q_c - q)] + T k_n N (q_0 - q_c)

    With S = 0 the arm comes to rest where w = 0, wherever its kinematics see the payload; internal wrenches
    sum to zero, and so do the offsets d, so that the payload stays. Without a wrench d = 0: stiff following.

    Where the scenario has a network and no force path measures, every arm sends u_i and c_i, k_0 + 1 numbers.
    If all hear all, w is the internal wrench. Over a connected graph heard both ways the w still sum to zero,
    and vanish together only where every u_i is its share of their sum: without internal wrench.

    Attributes:
        command_kind: "velocity" or "position".
    """

    command_kind: str = "velocity"

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> AdmittanceState:
        """Return the state at t_0: d = 0, V_a = 0, q_c = q."""
        rest, q = np.zeros(self.arm.rows.size), measurement.q
        return AdmittanceState(rest, rest, q, q)

    def message(self, measurement: ArmMeasurement, reference: ArmReference, state: Any) -> Outgoing:
        """Return u and c, shape (k_0 + 1,); nothing where the internal wrench is measured, or F is not."""
        return packed(self._sent(measurement, reference), np.zeros(0))

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: AdmittanceState
    ) -> ArmCommand:
        """Return the velocities or positions of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank.
        """
        gains, T, p = self.gains, self.arm.period, exp(-self.gains.admittance_rate * self.arm.period)
        w = self._wrench_error(measurement, reference) - gains.admittance_stiffness * state.offset
        V_a = p * state.velocity + (1.0 - p) * w / gains.admittance_damping
        d = state.offset + T * V_a
        J, q = measurement.payload_jacobian, measurement.q
        J_plus = right_inverse(J, measurement.time)
        error = self.arm.rows.pose_error(measurement.payload_pose, reference.pose) - d
        if self.command_kind == "velocity":
            V_c = measurement.by_arm(reference.twist) + V_a - gains.pose_gain * error
            velocity = J_plus.dot(V_c) + self._spare(J, J_plus, state.start - q)
            return ArmCommand(velocity=velocity, state=state._replace(offset=d, velocity=V_a))
        ahead = T * measurement.by_arm(reference.twist) + 0.5 * T**2 * reference.acceleration
        step = J_plus.dot(ahead - error - J.dot(state.command - q))
        q_c = state.command + step + T * self._spare(J, J_plus, state.start - state.command)
        return ArmCommand(position=q_c, state=AdmittanceState(d, V_a, state.start, q_c))

    def _sent(self, measurement: ArmMeasurement, reference: ArmReference) -> Parts:
        """Return the parts of the message."""
        F = measurement.interaction_wrench
        if measurement.internal_wrench is not None or F is None:
            return {}
        f_d = self.arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
        return {"error": F - f_d, "share": np.atleast_1d(reference.share(self.arm))}

    def _wrench_error(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return w, shape (k_0,)."""
        arm = self.arm
        f_d = arm.rows.turn(measurement.payload_pose, reference.internal_wrench)
        if measurement.internal_wrench is not None:
            return measurement.internal_wrench - f_d
        if measurement.messages is not None:
            received, _ = unpacked(measurement.messages, self._sent(measurement, reference))
            return _disagreement(received["error"], received["share"], arm.name)
        if measurement.interaction_wrench is not None:
            return measurement.interaction_wrench - f_d - arm.load_share * self.gains.payload_weight
        return np.zeros(arm.rows.size)

    def _spare(self, J: Array, J_plus: Array, way: Array) -> Array:
        """Return k_n N way: velocities of the drives that do not move the payload, rad/s, shape (k,)."""
        if J.shape[0] == J.shape[1]:
            return np.zeros(len(way))
        return self.gains.spare_rate * (way - J_plus.dot(J.dot(way)))


def _disagreement(errors: Messages, shares: Messages, name: str) -> Array:
    """Return the sum of c_j u_i - c_i u_j over the neighbours j of an arm i, its own as sent, shape (k_0,).

    Args:
        errors: u of each arm.
        shares: c of each arm.
        name: name of the arm i.
    """
    u, c, largest = errors[name].numbers, shares[name].numbers, np.finfo(float).max
    total = 0.0 * u
    for other, (u_j, age) in errors.items():
        if other != name:  # silent so far: nothing to agree with
            total = total + np.where(age <= largest, shares[other].numbers * u - c * u_j, 0.0)
    return total


@dataclass(frozen=True, eq=False)
class FollowingController(CellLawWrapper):
    """Law whose followers take the motion of the first arm, as that sees it, for the desired one.

    Leader and follower by position: Luh and Zheng (1987), "Constrained relations between two coordinated
    industrial robots for motion control"::

        x_d,i = x_1,   V_d,i = V_1   for every arm but the first, which leads

    One pose and one twist cross to every follower at each tick. A follower is late by what its servo is.
    """

    def transformed(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[Sequence[ArmMeasurement], Sequence[ArmReference]]:
        """Return the measurements, and the references, those of followers with the leader's motion."""
        leader, (first, *others) = measurements[0], references
        pose, twist = leader.payload_pose, leader.payload_twist
        return measurements, [first, *(other._replace(pose=pose, twist=twist) for other in others)]


class Admittance(DecentralisedLaw[AdmittanceGains]):
    """Commanded velocities or positions that yield to a wrench: AdmittanceController.

    Attributes:
        command: Kind of the commands: "velocity" or "position".
        follows: Source of the followers' desired motion: the "reference", as of every arm, or the "leader".
    """

    equal_gains: ClassVar[dict[str, str]] = {
        "admittance_damping": "else the offsets move the payload: it needs one D"
    }

    kind: Literal["admittance"] = "admittance"
    gains: AdmittanceGains = AdmittanceGains()
    command: Literal["velocity", "position"] = "velocity"
    follows: Literal["reference", "leader"] = "reference"

    @property
    def command_kind(self) -> str:
        """What it commands."""
        return self.command

    @property
    def needs(self) -> tuple[str, ...]:
        """Needs of the law: the internal wrench or else the arm's own, and the leader."""
        leader = ("poses of all arms", "role") if self.follows == "leader" else ()
        return (*leader, "internal wrench" if self.force_path.measures else "own wrench")

    def controller_of(self, arm: ControlledArm, gains: AdmittanceGains, scenario: Any) -> ArmController:
        """Return the law of one arm."""
        return AdmittanceController(arm, with_payload_weight(gains, arm, scenario), self.command)

    def build(self, scenario: Any, arms: Iterable[ControlledArm]) -> CellController:
        """Return the controller of the cell; see Law."""
        laws = super().build(scenario, arms)
        return FollowingController(laws) if self.follows == "leader" else laws

    def feedback_problems(self, cell: CellTiming) -> list[FieldError]:
        """Return none: the loop closes over the robots' servos, which the law does not know."""
        return []
