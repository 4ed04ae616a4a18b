"""Adaptive control of closed chains with Slotine-Li regressors of arms and payload."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.control import ArmCommand, ArmController, ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.terms import InternalForceIntegral, right_inverse
from coop_pin.description.model_laws import Adaptive
from coop_pin.description.scenario import Scenario
from coop_pin.model_based.arm_dynamics import ArmDynamics


class AdaptiveState(NamedTuple):
    """Memory of the law.

    Attributes:
        parameters: thetahat of the arm: ten for each link as Pinocchio's ``toDynamicParameters``, then
            viscous and Coulomb friction of each drive, then the rotors if there are any, shape (p,).
        payload: phihat, ten of the arm's share of the payload, shape (10,).
        disturbance: dhat, N m, shape (k,).
        force: state of the internal force integral, as of computed torque.
        start: drive angles at t_0, to which spare joints return, rad, shape (k,).
    """

    parameters: Array
    payload: Array
    disturbance: Array
    force: tuple[Array, float]
    start: Array


class AdaptiveController(ArmController):
    """Slotine-Li adaptation of the arm's and of its share of the payload's parameters; decentralised.

    Slotine and Li (1987), "On the adaptive control of robot manipulators". With ``disturbance_rate`` > 0 it
    is the adaptive law of Verginis, Mastellaro and Dimarogonas (2018), "Robust cooperative manipulation
    without force/torque measurements", with friction in the regressor and damping at the joints. Joint
    quantities are at the drives, twists and wrenches about P in world axes, on task rows::

        V_r   = V_d - gamma xtilde,              s  = qdot - qdot_r
        qdot_r = J^+ V_r - N k_p (q - q(t_0)),   a_r = J^+ (A_d - gamma xtildedot - Jdot qdot_r)
        tau   = Y thetahat + J^T Y_0 phihat + dhat - K_d s - J^T f_r
        thetahat <- thetahat - T G Y^T s,        phihat <- phihat - T G_0 Y_0^T J s,   dhat <- dhat - T G_d s

    Y theta = M a_r + C(q, qdot) qdot_r + g + friction with Christoffel's C, by polarisation of Pinocchio's
    regressor: Y(q, 0, a_r) + [Y(q, v + v_r, 0) - Y(q, v - v_r, 0)] / 4. Y_0 is that of the payload with
    Q_0(V) V_r = V_r x* (M_0 V). With rigid grasps and the same xtilde in all arms

        V = sum_i s_i^T M_i s_i / 2 + s_0^T M_0 s_0 / 2 + parameter errors weighted by G^-1

    falls by sum_i s_i^T K_d s_i; internal parts of f_r do no work on it. J^+'s derivative in the null space
    is left out. The estimates start at 0, or at those of the ``model``.
    """

    def __init__(self, law: Adaptive, scenario: Scenario, arm: ControlledArm) -> None:
        """Build the regressors of the arm.

        Args:
            law: The law, its gains with an entry for each task row and drive.
            scenario: Scenario to run.
            arm: The arm.

        Raises:
            CoopPinError: the model cannot be built.
        """
        self._gains, self._rows, self._period = law.gains, arm.rows, arm.period
        self._dynamics = ArmDynamics(scenario, arm.name, law.model)
        self._force = InternalForceIntegral(arm.rows, law.gains.anchor_gain)
        theta, phi = self._dynamics.parameters()
        known = float(law.model is not None)
        self._first = known * theta, known * arm.load_share * phi

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> AdaptiveState:
        """Return the state at t_0: the first estimates, no disturbance, Z = 0."""
        return AdaptiveState(*self._first, np.zeros_like(measurement.q), self._force.start(), measurement.q)

    def step(self, measurement: ArmMeasurement, reference: ArmReference, state: AdaptiveState) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank.
        """
        J, v, T, gains = measurement.payload_jacobian, measurement.v, self._period, self._gains
        J_plus, J_dot = right_inverse(J, measurement.time), self._dynamics.jacobian_rate(measurement)
        xtilde = self._rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        gamma = gains.pose_gain
        V_r, A_r = reference.twist - gamma * xtilde, reference.acceleration - gamma * xtildedot
        spare = -gains.spare_gain * (measurement.q - state.start)
        qdot_r = J_plus @ (V_r - J @ spare) + spare
        s = v - qdot_r

        Y = self._dynamics.regressor(measurement, qdot_r, J_plus @ (A_r - J_dot @ qdot_r))
        Y_0 = self._dynamics.payload_regressor(measurement, V_r, A_r)
        f_r, force = self._force.step(measurement, reference, state.force)
        tau = Y @ state.parameters + state.disturbance - gains.damping_gain * s
        tau = tau + J.T @ (Y_0 @ state.payload - f_r)
        rate = T * (1.0 - measurement.saturated.any())
        return ArmCommand(
            tau,
            AdaptiveState(
                state.parameters - rate * gains.adaptation * (Y.T @ s),
                state.payload - rate * gains.payload_adaptation * (Y_0.T @ (J @ s)),
                state.disturbance - rate * gains.disturbance_rate * s,
                force,
                state.start,
            ),
        )
