"""Terms of the paper's convergence proof for one arm at one instant of a recorded run of law (23).

Gueaieb et al. (2007), eqs. (13)-(21), with (13)-(15) as they must read; in drive coordinates. See
coop_pin.proof.sliding_mode_monitor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import spatial_inertia, weight_wrench
from coop_pin.control.laws.sliding_mode import SlidingModeController
from coop_pin.description.events import Surroundings
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.transmission import friction
from coop_pin.proof.recorded_run import ArmTick, RecordedTick

_STEP = 1e-5
_SPAN = 2.0 * _STEP
"""Span of the central differences along the motion, s."""


class LawTerms(NamedTuple):
    """Quantities of law (23) for one arm at one state.

    Attributes:
        position: Position of P as this arm sees it, m, shape (3,).
        J: Payload Jacobian as this arm sees it, shape (k, k).
        surface: Pose surface xtildedot + gamma xtilde, shape (k,).
        s: Sliding surface of eq. (19), shape (k,).
        s_d: Transient of eq. (20), shape (k,).
        qdot_r: Reference velocity, shape (k,).
        s_r: Residual qdot - qdot_r, shape (k,).
    """

    position: Array
    J: Array
    surface: Array
    s: Array
    s_d: Array
    qdot_r: Array
    s_r: Array


class DynamicsTerms(NamedTuple):
    """Terms of eq. (13) for one arm at one state, in drive coordinates.

    Attributes:
        J: true payload Jacobian, shape (k, k).
        D: M_i + c_i J^T M_0 J, shape (k, k).
        coriolis: Q_i without friction, shape (k, k).
        M_0: payload's inertia in task rows, shape (k, k).
        Q_0: matrix of eq. (5), shape (k, k).
    """

    J: Array
    D: Array
    coriolis: Array
    M_0: Array
    Q_0: Array


class ProofArm:
    """One arm of the run: its true dynamics, its law as it sees the payload, and the law's integral.

    Attributes:
        sigma: Integral of sgn(s_q) at the next tick, shape (k,).
        held: Drives whose integral the last tick held, shape (k,).
        start_surface: Surface s(t_0), shape (k,); None before the first tick.
    """

    def __init__(self, scenario: Scenario, name: str, law: SlidingModeController) -> None:
        cell = scenario.cell
        self.law, self.rows = law, cell.task_rows
        self.model = CellArm(cell, name)
        self.motion = scenario.payload_motion
        self.start_surface: Array | None = None
        self.sigma, self.held = np.zeros(self.model.nv), np.zeros(self.model.nv, dtype=bool)
        resistance, back = friction(cell.arms[name], name), self.model.from_drive
        self.viscous = back.T @ resistance.axes.T @ np.diag(resistance.viscous) @ resistance.axes @ back
        K_d = law.gains.damping_gain
        self.least_damping = float(np.linalg.eigvalsh((K_d + K_d.T) / 2)[0])
        self.data = self.model.model.createData()

    def law_at(self, t: float, q: Array, v: Array, sigma: Array) -> LawTerms:
        """Return the quantities of the law at a state and sigma."""
        gains, target, view = self.law.gains, self.motion.at(t), self.model.kinematics.view(q)
        x_d, v_d = target.X_WP_d, self.rows.select(target.V_WP_d)
        qdot, J_inverse = self.model.drive @ v, np.linalg.inv(view.jacobian)
        gamma_xtilde = gains.pose_gain @ self.rows.pose_error(view.pose, x_d)
        surface = view.jacobian @ qdot - v_d + gamma_xtilde
        s = J_inverse @ surface
        self.start_surface = s if self.start_surface is None else self.start_surface
        s_d = self.start_surface * np.exp(-gains.transient_rate * t)
        qdot_r = J_inverse @ (v_d - gamma_xtilde) + s_d - gains.sign_gain @ sigma
        return LawTerms(view.pose[:3, 3], view.jacobian, surface, s, s_d, qdot_r, qdot - qdot_r)

    def dynamics_at(self, q: Array, v: Array, surroundings: Surroundings) -> DynamicsTerms:
        """Return the terms of eq. (13) at a state."""
        to_rates, rows = self.model.from_drive, list(self.rows.indices)
        J6 = self.model.payload_jacobian(q)
        J = J6[rows] @ to_rates
        R, omega = self.model.payload_pose(q)[:3, :3], (J6 @ v)[3:]
        M_0, Q_0 = spatial_inertia(surroundings.mass, surroundings.inertia, R), np.zeros((6, 6))
        Q_0[3:, 3:] = pin.skew(omega) @ M_0[3:, 3:]
        M_0, Q_0 = M_0[np.ix_(rows, rows)], Q_0[np.ix_(rows, rows)]
        M = to_rates.T @ self.model.mass_matrix(q) @ to_rates
        Q = to_rates.T @ pin.computeCoriolisMatrix(self.model.model, self.data, q, v) @ to_rates
        return DynamicsTerms(J, M + self.model.share * J.T @ M_0 @ J, Q, M_0, Q_0)


class ProofTerms(NamedTuple):
    """Law and dynamics of one arm at one tick, with their rates, central differences, along the motion.

    Attributes:
        law: quantities of the law.
        dynamics: terms of eq. (13).
        sigma: integral of sgn(s_q), shape (k,).
        sigma_rate: rate sgn(s_q), shape (k,).
        C: C_i of eq. (13), shape (k, k).
        Y_mu: D qddot_r + C qdot_r + G, eq. (16), shape (k,).
        beyond: held torque less the law's with the true force, shape (k,).
        law_rate: rates of the quantities of the law.
        dynamics_rate: rates of the terms of eq. (13).
        V_rate: rate of V_i.
    """

    law: LawTerms
    dynamics: DynamicsTerms
    sigma: Array
    sigma_rate: Array
    C: Array
    Y_mu: Array
    beyond: Array
    law_rate: LawTerms
    dynamics_rate: DynamicsTerms
    V_rate: float


def proof_terms(arm: ProofArm, tick: RecordedTick, x: ArmTick) -> ProofTerms:
    """Return law, dynamics and rates of one arm at one tick."""
    sigma = arm.sigma
    arm.model.model.gravity.linear = tick.surroundings.gravity
    law, gains, dynamics = (
        arm.law_at(tick.t, x.q, x.v, sigma),
        arm.law.gains,
        arm.dynamics_at(x.q, x.v, tick.surroundings),
    )
    sigma_rate = arm.law.switching(law.s - law.s_d)
    torque = arm.model.drive.T @ x.tau + x.friction
    acceleration = arm.model.forward_dynamics(x.q, x.v, torque, x.F)

    def ahead(dt: float) -> tuple[LawTerms, DynamicsTerms]:
        q = pin.integrate(arm.model.model, x.q, dt * x.v + dt**2 / 2 * acceleration)
        v = x.v + dt * acceleration
        law = arm.law_at(tick.t + dt, q, v, sigma + dt * sigma_rate)
        return law, arm.dynamics_at(q, v, tick.surroundings)

    (law_0, dynamics_0), (law_1, dynamics_1) = ahead(-_STEP), ahead(_STEP)
    V_0, V_1 = law_0.s_r @ dynamics_0.D @ law_0.s_r / 2, law_1.s_r @ dynamics_1.D @ law_1.s_r / 2
    law_rate = LawTerms(*((b - a) / _SPAN for a, b in zip(law_0, law_1, strict=True)))
    dynamics_rate = DynamicsTerms(*((b - a) / _SPAN for a, b in zip(dynamics_0, dynamics_1, strict=True)))
    J = dynamics.J
    C = dynamics.coriolis + arm.model.share * J.T @ (dynamics.M_0 @ dynamics_rate.J + dynamics.Q_0 @ J)
    f_r = x.f_d - gains.force_gain * (x.f - x.f_d)
    return ProofTerms(
        law=law,
        dynamics=dynamics,
        sigma=sigma,
        sigma_rate=sigma_rate,
        C=C,
        Y_mu=dynamics.D @ law_rate.qdot_r + C @ law.qdot_r + _load(arm, tick, x, J),
        beyond=x.tau + gains.damping_gain @ law.s_r + J.T @ f_r,
        law_rate=law_rate,
        dynamics_rate=dynamics_rate,
        V_rate=float(V_1 - V_0) / _SPAN,
    )


def _load(arm: ProofArm, tick: RecordedTick, x: ArmTick, J: Array) -> Array:
    """Return G_i of eq. (13): the arm's weight and friction, and its share of the payload's, shape (k,)."""
    at_rest = arm.model.nonlinear_effects(x.q, np.zeros_like(x.v)) - x.friction
    acting, rows = tick.surroundings, list(arm.rows.indices)
    load = acting.push + weight_wrench(acting.mass, acting.gravity)
    return arm.model.from_drive.T @ at_rest - arm.model.share * J.T @ load[rows]
