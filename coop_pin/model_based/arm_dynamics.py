"""Dynamics of an arm and of the payload as a controller knows them, exact or off by stated factors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from coop_pin.base.arrays import Array
from coop_pin.base.spatial import spatial_inertia
from coop_pin.control import ArmMeasurement
from coop_pin.description.model_laws import ModelFactors
from coop_pin.description.scenario import Scenario
from coop_pin.model.cell_arm import CellArm
from coop_pin.model.pinocchio_model import frame_id
from coop_pin.model.transmission import friction


class ArmTerms(NamedTuple):
    """Dynamics of an arm at one measurement, ``M qddot + h - J^T F = tau``, eq. (4), in drive coordinates.

    Attributes:
        M: mass matrix, shape (k, k).
        h: Coriolis, centrifugal, gravity and friction torques, N m, shape (k,).
        J_dot: derivative of the payload Jacobian, task rows, shape (k_0, k).
    """

    M: Array
    h: Array
    J_dot: Array


class ArmDynamics:
    """Model of one arm and of the payload, in drive coordinates and task rows.

    Where the robot compensates its own weight, the model has no gravity on the arm; what its compensation is
    off by is not known to it.

    Attributes:
        model: Pinocchio model of the arm with its factors, about the payload frame.
        from_drive: T^-1, shape (k, k).
    """

    def __init__(
        self, scenario: Scenario, arm: str, factors: ModelFactors | Mapping[str, Any] | None = None
    ) -> None:
        """Build the model.

        Args:
            scenario: Scenario with the cell, its payload and its friction.
            arm: Name of the arm.
            factors: Factors by which the model is off, or their fields; exact when None.

        Raises:
            ScenarioError: a factor is wrong or unknown.
            UrdfError, NameNotFoundError: the arm cannot be built.
        """
        cell, factor = scenario.cell, ModelFactors(**dict(factors or {}))
        self._arm = CellArm(cell, arm)
        self.model, self._rows = self._arm.model, cell.task_rows
        for joint in range(1, self.model.njoints):
            body = self.model.inertias[joint]
            self.model.inertias[joint] = pin.Inertia(
                factor.mass * body.mass, body.lever, factor.inertia * body.inertia
            )
        self.model.armature = factor.inertia * self.model.armature
        if scenario.actuators_of(arm).gravity_compensation is not None:
            self.model.gravity.linear = np.zeros(3)
        self._friction, self._friction_factor = friction(cell.arms[arm], arm), factor.friction
        self._data, self._payload_frame = self.model.createData(), frame_id(self.model, "payload")
        self.from_drive = self._arm.from_drive
        self._gravity = np.array(cell.gravity, dtype=float)
        self._payload = cell.payload.replace(
            mass=factor.mass * cell.payload.mass,
            inertia=factor.inertia * np.array(cell.payload.inertia),
        )

    def joints(self, measurement: ArmMeasurement) -> tuple[Array, Array]:
        """Return configuration and joint velocities, shapes (nq,) and (k,)."""
        return self._arm.configuration(self.from_drive @ measurement.q), self.from_drive @ measurement.v

    def terms(self, measurement: ArmMeasurement) -> ArmTerms:
        """Return the dynamics of the arm: CRBA, RNEA, friction, and the derivative of its Jacobian."""
        q, v = self.joints(measurement)
        M, h = self._arm.mass_matrix(q), self._arm.nonlinear_effects(q, v)
        h = h - self._friction_factor * self._friction.force(v)
        back = self.from_drive
        return ArmTerms(back.T @ M @ back, back.T @ h, self.jacobian_rate(measurement))

    def jacobian_rate(self, measurement: ArmMeasurement) -> Array:
        """Return Jdot of the payload on the task rows, shape (k_0, k)."""
        pin.computeJointJacobiansTimeVariation(self.model, self._data, *self.joints(measurement))
        J_dot = pin.getFrameJacobianTimeVariation(
            self.model, self._data, self._payload_frame, pin.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(self._rows.select(J_dot) @ self.from_drive)

    def payload_inertia(self, X_WP: Array) -> Array:
        """Return M_0 in world axes on the task rows, shape (k_0, k_0)."""
        rows = list(self._rows.indices)
        M_0 = spatial_inertia(self._payload.mass, self._payload.inertia_matrix, X_WP[:3, :3])
        return M_0[np.ix_(rows, rows)]

    def payload_bias(self, measurement: ArmMeasurement) -> Array:
        """Return Q_0 V + W_0 = [-m g, w x I w] in world axes on the task rows, eq. (5), shape (k_0,)."""
        R = measurement.payload_pose[:3, :3]
        w = self._rows.expand(measurement.payload_twist)[3:]
        moment = np.cross(w, R @ self._payload.inertia_matrix @ R.T @ w)
        return self._rows.select(np.concatenate((-self._payload.mass * self._gravity, moment)))

    # ------------------------------------------------------------ linear in the parameters

    def parameters(self) -> tuple[Array, Array]:
        """Return theta of the arm and phi of the payload by this model, shapes (p,) and (10,).

        Ten for each link (mass, first moments, inertia about the joint), then viscous and Coulomb friction of
        each drive; stiction is no part of them, and with a drive matrix friction must act at the drives. Last
        the inertia of each joint's rotor, if any has one.
        """
        links = [self.model.inertias[joint].toDynamicParameters() for joint in range(1, self.model.njoints)]
        rubbing = self._friction_factor * np.concatenate((self._friction.viscous, self._friction.coulomb))
        payload = pin.Inertia(self._payload.mass, np.zeros(3), self._payload.inertia_matrix)
        rotors = self.model.armature if self.model.armature.any() else ()
        return np.concatenate((*links, rubbing, rotors)), np.array(payload.toDynamicParameters())

    def regressor(self, measurement: ArmMeasurement, v_r: Array, a_r: Array) -> Array:
        """Return Y with Y theta = M a_r + C(q, qdot) v_r + g + friction at v_r, shape (k, p).

        C is Christoffel's: the quadratic C(q, v) v is polarised, which is bilinear and symmetric.

        Args:
            measurement: measurement of the arm.
            v_r: drive velocities, shape (k,).
            a_r: drive accelerations, shape (k,).
        """
        (q, v), back = self.joints(measurement), self.from_drive
        still, w = np.zeros(len(v)), back @ v_r

        def Y(velocity: Array, acceleration: Array) -> Array:
            return np.array(
                pin.computeJointTorqueRegressor(self.model, self._data, q, velocity, acceleration)
            )

        links = Y(still, back @ a_r) + (Y(v + w, still) - Y(v - w, still)) / 4.0
        sliding = np.tanh(measurement.v / self._friction.coulomb_velocity)
        rotors = back.T @ np.diag(back @ a_r) if self.model.armature.any() else np.zeros((len(v), 0))
        return np.hstack((back.T @ links, np.diag(v_r), np.diag(sliding), rotors))

    def payload_regressor(self, measurement: ArmMeasurement, V_r: Array, A_r: Array) -> Array:
        """Return Y_0 with Y_0 phi = M_0 A_r + V_r x* (M_0 V) + W_0 about P in world axes, shape (k_0, 10).

        V_r x* (M_0 V) is Q_0 V at V_r = V and does no work on V_r, so that Mdot_0 - 2 Q_0 is skew.

        Args:
            measurement: measurement of the arm, with V.
            V_r: twist on the task rows, shape (k_0,).
            A_r: derivative of V_r, shape (k_0,).
        """
        R = measurement.payload_pose[:3, :3]
        turn = np.kron(np.eye(2), R.T)
        V, W, A = (turn @ self._rows.expand(x) for x in (measurement.payload_twist, V_r, A_r))
        A[:3] -= R.T @ self._gravity
        A -= np.concatenate((np.cross(V[3:], W[:3]), np.cross(V[3:], W[3:])))  # of components in payload axes
        still = pin.Motion.Zero()
        inertial = pin.bodyRegressor(still, pin.Motion(A))
        momentum = pin.bodyRegressor(still, pin.Motion(V))
        cross = -pin.Motion(W).action.T  # the matrix of W x*
        return np.asarray(self._rows.select(turn.T @ (inertial + cross @ momentum)))
