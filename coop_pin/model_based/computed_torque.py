"""Computed torque of closed chains with an integral of the internal force."""

from __future__ import annotations

from typing import NamedTuple

from coop_pin.base.arrays import Array
from coop_pin.control import ArmCommand, ArmController, ArmMeasurement, ArmReference, ControlledArm
from coop_pin.control.terms import InternalForceIntegral, right_inverse
from coop_pin.description.model_laws import ComputedTorque
from coop_pin.description.scenario import Scenario
from coop_pin.model_based.arm_dynamics import ArmDynamics


class ComputedTorqueState(NamedTuple):
    """Memory of the law.

    Attributes:
        force: Z and the age of the last measurement, see InternalForceIntegral.
        start: drive angles at t_0, to which spare joints return, rad, shape (k,).
    """

    force: tuple[Array, float]
    start: Array


class ComputedTorqueController(ArmController):
    """Computed torque for an arm of a closed chain, with its payload share and an internal force integral.

    Tarn, Bejczy and Yun (1987), "Design of dynamic control of two cooperating robot arms: closed chain
    formulation"; internal force integral as Li, Hsu and Sastry (1989), "Grasping and coordinated
    manipulation by a multifingered robot hand". Wrenches and twists are about P in world axes, on task rows::

        a    = A_d - K_v xtildedot - K_p xtilde
        F_0  = M_0 a + Q_0 V + W_0                                       (5)
        Z   <- Z - g (f_m - f_d)                                         once for each new measurement
        F    = f_d + Z - c F_0                                           (7)-(12)
        a_q  = J^+ (a - Jdot qdot) + N [-k_p (q - q(t_0)) - k_v qdot]
        tau  = M a_q + h - J^T F                                         (4)

    With the exact model, xtilde'' + K_v xtilde' + K_p xtilde = 0 up to the hold over a tick, and f = f_d + Z.
    Stable for g below ``anchor_gain_bound``.
    """

    def __init__(self, law: ComputedTorque, scenario: Scenario, arm: ControlledArm) -> None:
        """Build the model of the arm.

        Args:
            law: The law, its gains with k_0 entries.
            scenario: Scenario to run.
            arm: The arm.

        Raises:
            CoopPinError: the model cannot be built.
        """
        self._gains, self._rows, self._load_share = law.gains, arm.rows, arm.load_share
        self._dynamics = ArmDynamics(scenario, arm.name, law.model)
        self._force = InternalForceIntegral(arm.rows, law.gains.anchor_gain)

    def init(self, measurement: ArmMeasurement, reference: ArmReference) -> ComputedTorqueState:
        """Return the state at t_0: Z = 0."""
        return ComputedTorqueState(self._force.start(), measurement.q)

    def step(
        self, measurement: ArmMeasurement, reference: ArmReference, state: ComputedTorqueState
    ) -> ArmCommand:
        """Return the drive torque of this tick and the state of the next.

        Raises:
            SingularJacobianError: the payload Jacobian loses rank.
        """
        gains, xtilde = self._gains, self._rows.pose_error(measurement.payload_pose, reference.pose)
        xtildedot = measurement.payload_twist - reference.twist
        a = reference.acceleration - gains.velocity_gain * xtildedot - gains.position_gain * xtilde
        M_0 = self._dynamics.payload_inertia(measurement.payload_pose)
        F_0 = M_0 @ a + self._dynamics.payload_bias(measurement)
        f_r, force = self._force.step(measurement, reference, state.force)
        along, rest = acceleration_torque(self._dynamics, measurement, state.start, gains.spare_gains)
        F = f_r - self._load_share * F_0
        tau = along @ a + rest - measurement.payload_jacobian.T @ F
        return ArmCommand(tau, state._replace(force=force))


def acceleration_torque(
    dynamics: ArmDynamics, measurement: ArmMeasurement, start: Array, spare_gains: tuple[float, float]
) -> tuple[Array, Array]:
    """Return L and r: the torque ``L a + r - J^T F`` accelerates the payload by a under the wrench F.

    L = M J^+ has the shape (k, k_0), r = M [b - J^+ (Jdot qdot + J b)] + h the shape (k,), with the spare
    joints' b = -k_p (q - q(t_0)) - k_v qdot.

    Args:
        dynamics: Model of the arm.
        measurement: Measurement of the arm.
        start: Drive angles to which the spare joints return, rad, shape (k,).
        spare_gains: k_p, 1/s^2, and k_v, 1/s, of the spare joints.

    Raises:
        SingularJacobianError: the payload Jacobian loses rank.
    """
    J, v = measurement.payload_jacobian, measurement.v
    J_plus, (M, h, J_dot) = right_inverse(J, measurement.time), dynamics.terms(measurement)
    b = -spare_gains[0] * (measurement.q - start) - spare_gains[1] * v
    return M @ J_plus, M @ (b - J_plus @ (J_dot @ v + J @ b)) + h
