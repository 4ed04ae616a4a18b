"""Payload-space law: sliding and integral terms act on the payload's motion and are shared like its load."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coop_pin.arrays import Array
from coop_pin.control.interface import ArmCommand, ArmController, ArmMeasurement, ArmReference
from coop_pin.control.switching import Switching
from coop_pin.control.terms import Posture, force_term, right_inverse
from coop_pin.spatial.task_rows import TaskRows


class PayloadSpaceState(NamedTuple):
    """Memory of the law.

    Attributes:
        start_time: t_0, s.
        start_surface: s_x(t_0), m/s and rad/s, shape (k_0,).
        sign_integral: sigma_x, s, shape (k_0,).
    """

    start_time: float
    start_surface: Array
    sign_integral: Array


@dataclass(frozen=True, eq=False)
class PayloadSpaceController(ArmController):
    """A repair of law (23) whose motion terms leave no internal wrench; decentralised, without a model.

    For any number of joints k >= k_0.

    ::

        s_x  = xtildedot + gamma xtilde
        s_xd = s_x(t_0) exp(-kappa (t - t_0))
        tau  = -J^T [c (K_x (s_x - s_xd) + K_x alpha sigma_x) + f_d - K_f ftilde] + posture
        sigma_x[k+1] = sigma_x[k] + T sgn(s_x - s_xd),  sigma_x[0] = 0

    When all arms see the same payload pose, the bracketed motion terms differ between arms only by their
    shares c: their internal part is zero by construction, and the three-parameter family of rest states of
    law (23) is gone. What is left in the internal wrench comes from the arms' own friction and weight, and
    from a kinematic bias, which the integral winds up.

    The integral is held while a torque of the arm is saturated.

    Attributes:
        rows: the k_0 task rows.
        period: T, s.
        load_share: c of this arm.
        pose_gain: gamma, 1/s, shape (k_0, k_0).
        sliding_gain: K_x, N s/m and N m s/rad, shape (k_0, k_0).
        sign_gain: alpha, m/s^2 and rad/s^2, shape (k_0, k_0), diagonal.
        force_gain: K_f.
        transient_rate: kappa, 1/s.
        switching: sgn, or a smooth function in its place.
        posture: what spare joints do; None for an arm without spare joints.
    """

    rows: TaskRows
    period: float
    load_share: float
    pose_gain: Array
    sliding_gain: Array
    sign_gain: Array
    force_gain: float
    transient_rate: float
    switching: Switching
    posture: Posture | None = None

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> PayloadSpaceState:
        """Return the state at t_0: the surface there, and sigma_x = 0."""
        s_x = self._surface(measurement, reference)
        return PayloadSpaceState(measurement.time, s_x, np.zeros_like(s_x))

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: PayloadSpaceState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next."""
        J = measurement.payload_jacobian
        s_xd = state.start_surface * math.exp(-self.transient_rate * (measurement.time - state.start_time))
        s = self._surface(measurement, reference) - s_xd
        motion = self.sliding_gain.dot(s + self.sign_gain.dot(state.sign_integral))
        tau = -J.T.dot(
            self.load_share * motion + force_term(self.rows, self.force_gain, measurement, reference)
        )
        if self.posture is not None:
            tau = tau + self.posture.torque(
                measurement.q, measurement.v, J, right_inverse(J, measurement.time)
            )
        held = measurement.saturated.any()
        sigma = state.sign_integral if held else state.sign_integral + self.period * self.switching(s)
        return ArmCommand(tau, PayloadSpaceState(state.start_time, state.start_surface, sigma))

    def _surface(self, measurement: ArmMeasurement, reference: ArmReference) -> Array:
        """Return s_x = xtildedot + gamma xtilde, shape (k_0,)."""
        xtilde = self.rows.pose_error(measurement.payload_pose, reference.pose)
        return measurement.payload_twist - reference.twist + self.pose_gain.dot(xtilde)
