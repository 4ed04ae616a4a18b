"""Torques by a quadratic program: torque limits and friction cones at the grasps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count

import numpy as np

from coop_pin.base.arrays import Array
from coop_pin.base.errors import InvalidStateError, needs_extra
from coop_pin.control import ArmMeasurement, ArmReference, CellCommand, CellController, ControlledArm
from coop_pin.control.terms import InternalForceIntegral
from coop_pin.description.model_laws import TorqueQp
from coop_pin.description.scenario import Scenario
from coop_pin.model.joint_limits import JointLimits
from coop_pin.model_based.arm_dynamics import ArmDynamics
from coop_pin.model_based.computed_torque import ComputedTorqueState, acceleration_torque

_NO_LIMIT = 1e20


class TorqueQpController(CellController):
    """Computed torque whose acceleration and wrenches are the solution of a quadratic program in each tick.

    After Bouyarmane, Chappellet, Vaillant and Kheddar (2019), "Quadratic programming for multirobot and
    task-space force control". Unknown are the payload's acceleration a and the wrench F_i on each arm, about
    P in world axes, on task rows; a_d and F_d,i are those of computed torque::

        min   w |a - a_d|^2 + sum_i |F_i - F_d,i|^2
        with  sum_i F_i = -(M_0 a + Q_0 V + W_0)                                        (5)
              |M a_q(a) + h - J^T F_i| <= torque limits                                 (4)
              |F_i . t| <= mu n . (-F_i)     for two tangents t, with ``friction_coefficient``

    n points from the tip of arm i to the middle of the other tips: the direction of the squeeze. A pyramid
    stands for the cone. Where no constraint is active the torques are those of computed torque.
    """

    def __init__(self, law: TorqueQp, scenario: Scenario, arms: Sequence[ControlledArm]) -> None:
        """Build the models of the arms.

        Args:
            law: The law, its gains with k_0 entries.
            scenario: Scenario to run.
            arms: The arms.

        Raises:
            MissingExtraError: proxsuite is not installed.
            CoopPinError: the model cannot be built.
        """
        with needs_extra("proxsuite", "compare", "to solve quadratic programs"):
            from proxsuite import proxqp
        self._solve, self._solved = proxqp.dense.solve, proxqp.PROXQP_SOLVED
        cell = scenario.cell
        self._law, self._rows, self._shares = law, arms[0].rows, [arm.load_share for arm in arms]
        self._dynamics = [ArmDynamics(scenario, arm.name, law.model) for arm in arms]
        self._limits = [JointLimits(arm, name).torque for name, arm in cell.arms.items()]
        self._tips = [cell.grasps[arm.name].matrix[:3, 3] for arm in arms]
        self._force = InternalForceIntegral(self._rows, law.gains.anchor_gain)

    def init(
        self, measurements: Sequence[ArmMeasurement], references: Sequence[ArmReference]
    ) -> tuple[ComputedTorqueState, ...]:
        """Return the state of each arm at t_0, as of computed torque."""
        return tuple(ComputedTorqueState(self._force.start(), measured.q) for measured in measurements)

    def step(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: tuple[ComputedTorqueState, ...],
    ) -> CellCommand:
        """Return the drive torques of this tick and the state of the next.

        Raises:
            SingularJacobianError: a payload Jacobian loses rank.
            InvalidStateError: no torques within the limits hold the cell.
        """
        first = measurements[0]
        M_0 = self._dynamics[0].payload_inertia(first.payload_pose)
        bias = self._dynamics[0].payload_bias(first)
        a_d, desired, arms = self._desired(measurements, references, state, M_0, bias)
        rows = [self._torque_rows(*each) for each in zip(count(), measurements, state, strict=False)]
        limits = [np.minimum(limit, _NO_LIMIT) for limit in self._limits]
        C = [block for block, _ in rows]
        lower = [-limit - rest for limit, (_, rest) in zip(limits, rows, strict=True)]
        upper = [limit - rest for limit, (_, rest) in zip(limits, rows, strict=True)]
        if (mu := self._law.friction_coefficient) is not None:
            C.append(self._cones(first.payload_pose[:3, :3], mu))
            lower.append(np.full(len(C[-1]), -_NO_LIMIT))
            upper.append(np.zeros(len(C[-1])))
        x_d = np.concatenate((a_d, *desired))
        weights = np.where(np.arange(x_d.size) < a_d.size, self._law.tracking_weight, 1.0)
        A = np.hstack((M_0, *[np.eye(a_d.size)] * len(measurements)))
        solution = self._solve(
            np.diag(weights),
            -weights * x_d,
            A,
            -bias,
            np.vstack(C),
            np.concatenate(lower),
            np.concatenate(upper),
            eps_abs=1e-9,
        )
        if solution.info.status != self._solved:
            raise InvalidStateError(
                f"at t = {first.time:g} s no torques within the limits: {solution.info.status}"
            )
        return CellCommand([block @ solution.x + rest for block, rest in rows], tuple(arms))

    def _desired(
        self,
        measurements: Sequence[ArmMeasurement],
        references: Sequence[ArmReference],
        state: Sequence[ComputedTorqueState],
        M_0: Array,
        bias: Array,
    ) -> tuple[Array, list[Array], list[ComputedTorqueState]]:
        """Return a_d, F_d of each arm, shape (k_0,) each, and the next states."""
        first, reference, gains = measurements[0], references[0], self._law.gains
        xtilde = self._rows.pose_error(first.payload_pose, reference.pose)
        a_d = reference.acceleration - gains.position_gain * xtilde
        a_d = a_d - gains.velocity_gain * (first.payload_twist - reference.twist)
        wrenches, arms = [], []
        for share, m, desired, last in zip(self._shares, measurements, references, state, strict=True):
            f_r, force = self._force.step(m, desired, last.force)
            wrenches.append(f_r - share * (M_0 @ a_d + bias))
            arms.append(last._replace(force=force))
        return a_d, wrenches, arms

    def _torque_rows(self, index: int, m: ArmMeasurement, state: ComputedTorqueState) -> tuple[Array, Array]:
        """Return C and r with tau = C [a, F_1, ...] + r, shapes (k, k_0 (1 + m)) and (k,)."""
        k_0 = self._rows.size
        spare_gains = self._law.gains.spare_gains
        along, rest = acceleration_torque(self._dynamics[index], m, state.start, spare_gains)
        C = np.zeros((len(rest), k_0 * (1 + len(self._dynamics))))
        C[:, :k_0] = along
        C[:, k_0 * (1 + index) : k_0 * (2 + index)] = -m.payload_jacobian.T
        return C, rest

    def _cones(self, R_WP: Array, mu: float) -> Array:
        """Return the rows C with C [a, F_1, ...] <= 0 of all friction pyramids, shape (n, k_0 (1 + m)).

        On the payload the arm presses along n: mu n . F + t . F <= 0 for four tangents t.
        """
        k_0, tips = self._rows.size, np.array(self._tips)
        C = np.zeros((4 * len(tips), k_0 * (1 + len(tips))))
        for index, tip in enumerate(tips):
            n = R_WP @ (np.delete(tips, index, axis=0).mean(axis=0) - tip)
            _, _, axes = np.linalg.svd(n[None])  # the direction and two tangents
            n, edges = n / np.linalg.norm(n), np.vstack((axes[1:], -axes[1:]))
            forces = np.hstack((edges + mu * n, np.zeros((4, 3))))
            C[4 * index : 4 * index + 4, k_0 * (1 + index) : k_0 * (2 + index)] = self._rows.select(
                forces.T
            ).T
        return C
