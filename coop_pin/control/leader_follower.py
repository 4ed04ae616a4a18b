"""Leader-follower control: one arm tracks, the others yield to their own wrist wrench."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from coop_pin.arrays import Array
from coop_pin.control.interface import ArmCommand, ArmController, ArmMeasurement, ArmReference
from coop_pin.control.terms import gain_vector, spare_torque
from coop_pin.spatial.generic_numbers import exp


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


class LeaderFollowerController(ArmController):
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

    needs = ("own wrench", "role")

    def __init__(
        self,
        scenario: Any,
        arm: str,
        *,
        pose_gain: ArrayLike = 2.0,
        sliding_gain: ArrayLike = 400.0,
        integral_rate: float = 5.0,
        follower_damping: ArrayLike = 100.0,
        follower_stiffness: ArrayLike = 500.0,
        admittance_damping: ArrayLike = 50.0,
        admittance_rate: float = 50.0,
        payload_weight: ArrayLike = 0.0,
        spare_gains: tuple[float, float] = (40.0, 8.0),
    ) -> None:
        """Take rows, load share, period and the arm's place from the scenario; nothing else of it is used.

        Each gain is one number for all task rows or one for each.

        Args:
            scenario: what is run.
            arm: name.
            pose_gain: gamma, 1/s.
            sliding_gain: K, N s/m and N m s/rad.
            integral_rate: k_I, 1/s.
            follower_damping: B, N s/m and N m s/rad.
            follower_stiffness: B_p, N/m and N m/rad.
            admittance_damping: D, N s/m and N m s/rad.
            admittance_rate: l, 1/s.
            payload_weight: What on the task rows, N and N m.
            spare_gains: stiffness, N m/rad, and damping, N m s/rad, of spare joints.

        Raises:
            ShapeError: a gain has a wrong number of entries.
        """
        cell = scenario.cell
        self._rows, self._period, k_0 = cell.task_rows, scenario.clock.period, cell.task_rows.size
        self._leads = arm == next(iter(cell.arms))
        self._gamma, self._K = (
            gain_vector("pose_gain", pose_gain, k_0),
            gain_vector("sliding_gain", sliding_gain, k_0),
        )
        self._k_I, self._B = integral_rate, gain_vector("follower_damping", follower_damping, k_0)
        self._B_p = gain_vector("follower_stiffness", follower_stiffness, k_0)
        self._D = gain_vector("admittance_damping", admittance_damping, k_0)
        self._pole = exp(-float(admittance_rate) * self._period)
        self._spare_gains = spare_gains
        self._load = cell.share(arm) * gain_vector("payload_weight", payload_weight, k_0)

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> LeaderFollowerState:
        """Return the state at t_0: z = 0, V_c = 0."""
        return LeaderFollowerState(np.zeros(self._rows.size), np.zeros(self._rows.size), measurement.q)

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: LeaderFollowerState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian of a redundant arm loses rank.
        """
        T, z, V_c = self._period, state.integral, state.velocity
        F_d = self._rows.turn(measurement.payload_pose, reference.internal_wrench) + self._load
        if self._leads:
            xtilde = self._rows.pose_error(measurement.payload_pose, reference.pose)
            push = self._K * (measurement.payload_twist - reference.twist + self._gamma * xtilde)
            rate = self._k_I * push
        else:
            if measurement.interaction_wrench is not None:
                V_c = self._pole * V_c + (1.0 - self._pole) * (measurement.interaction_wrench - F_d) / self._D
            slip = measurement.payload_twist - V_c
            push, rate = self._B * slip, self._B_p * slip
        tau = spare_torque(measurement, state.start, self._spare_gains)
        tau = tau - measurement.payload_jacobian.T.dot(F_d + push + z)
        held = 1.0 - measurement.saturated.any()
        return ArmCommand(tau, LeaderFollowerState(z + held * T * rate, V_c, state.start))
